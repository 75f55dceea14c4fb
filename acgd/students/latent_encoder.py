"""phi_lat: the codes that the observation calls for (Figure 2b)."""

import torch
from torch import Tensor, nn


class LatentEncoder(nn.Module):
    """[z_state, z_task] -> logits of G groups of n_c codes."""

    def __init__(self, width: int, expansion: int, groups: int, codes: int) -> None:
        super().__init__()
        hidden = expansion * width
        self.net = nn.Sequential(
            nn.LayerNorm(2 * width), nn.Linear(2 * width, hidden), nn.ReLU(),
            nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, groups * codes),
        )  # fmt: skip
        self.groups = groups

    def forward(self, z_state: Tensor, z_task: Tensor) -> Tensor:
        """Each (B, d) -> logits (B, G, n_c)."""
        return self.net(torch.cat([z_state, z_task], dim=-1)).unflatten(-1, (self.groups, -1))
