"""psi_dec, the decoder of the students that plan a chunk with a transformer: acgd, act and chunk."""

import torch
from torch import Tensor, nn

from acgd.nn.block import Block
from acgd.students.student import Sizes
from acgd.students.transformer_settings import TransformerSettings


class ActionDecoder(nn.Module):
    """psi_dec, a transformer: k learned queries attend to a context -> a_hat_{t:t+k} in (-1, 1)^A.

    The context of acgd is [z_q, z_state, z_task]. The tanh keeps actions inside the box. No later step has to clamp
    them, which would stop the gradient of Q.
    """

    def __init__(self, settings: TransformerSettings, sizes: Sizes) -> None:
        super().__init__()
        s = settings
        self.queries = nn.Parameter(torch.randn(s.chunk, s.width) * 0.5)
        self.norm_context = nn.LayerNorm(s.width)
        self.blocks = nn.ModuleList(Block(s.width, s.heads, s.expansion) for _ in range(s.decoder_layers))
        self.norm = nn.LayerNorm(s.width)
        self.head = nn.Linear(s.width, sizes.actions)

    def forward(self, *context: Tensor) -> Tensor:
        """Embeddings, each (B, d) -> action chunk (B, k, A)."""
        context = self.norm_context(torch.stack(context, dim=1))
        tokens = self.queries[None]
        for block in self.blocks:
            tokens = block(tokens, context)
        return self.head(self.norm(tokens)).float().tanh()
