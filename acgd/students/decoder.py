"""psi_dec: k learned queries attending to [z_q, z_state, z_task] (Figure 2)."""

import torch
from torch import Tensor, nn

from acgd.nn.block import Block


class Decoder(nn.Module):
    """Code and context -> action chunk strictly inside the box.

    The tanh keeps actions in (-1, 1), so that nothing downstream clamps them and no gradient of Q is lost to a clamp.
    """

    def __init__(self, chunk: int, actions: int, width: int, heads: int, layers: int, expansion: int) -> None:
        super().__init__()
        self.queries = nn.Parameter(torch.randn(chunk, width) * 0.5)
        self.norm_context = nn.LayerNorm(width)
        self.blocks = nn.ModuleList(Block(width, heads, expansion) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.head = nn.Linear(width, actions)

    def forward(self, z_q: Tensor, z_state: Tensor, z_task: Tensor) -> Tensor:
        """Each (B, d) -> action chunk (B, k, A)."""
        context = self.norm_context(torch.stack([z_q, z_state, z_task], dim=1))
        tokens = self.queries[None]
        for block in self.blocks:
            tokens = block(tokens, context)
        return self.head(self.norm(tokens)).float().tanh()
