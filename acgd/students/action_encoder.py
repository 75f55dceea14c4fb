"""phi_act: a transformer over the action chunk (Figure 2a)."""

import torch
from torch import Tensor, nn

from acgd.nn.block import Block


class ActionEncoder(nn.Module):
    """a_{t:t+k} -> z_e: G groups of logits, or of coordinates where distances to the codes are the logits."""

    def __init__(
        self, chunk: int, actions: int, width: int, heads: int, layers: int, expansion: int, groups: int, size: int
    ) -> None:
        super().__init__()
        self.embed = nn.Linear(actions, width)
        self.past_the_end = nn.Parameter(torch.randn(width) * 0.02)
        self.position = nn.Parameter(torch.randn(chunk, width) * 0.02)
        self.blocks = nn.ModuleList(Block(width, heads, expansion) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.head = nn.Linear(chunk * width, groups * size)
        self.groups = groups

    def forward(self, chunk: Tensor, mask: Tensor) -> Tensor:
        """chunk (B, k, A), mask (B, k) true on steps inside the episode -> z_e (B, G, size)."""
        tokens = torch.where(mask[..., None], self.embed(chunk), self.past_the_end) + self.position
        for block in self.blocks:
            tokens = block(tokens)
        return self.head(self.norm(tokens).flatten(1)).unflatten(-1, (self.groups, -1))
