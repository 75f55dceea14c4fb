"""Normalisation of a network's inputs by the statistics of its training data, saved with its weights."""

import torch
from torch import Tensor, nn

CLIP = 5.0
"""Normalised inputs end here: a joint that never moved in the demonstrations must not dominate at test time."""


class Normaliser(nn.Module):
    """(x - mean) / std with the training frames' statistics, clipped."""

    mean: Tensor
    std: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))

    def fit(self, x: Tensor) -> None:
        """x (N, size). Spreads far below the typical one are raised to a twentieth of it, against rounding."""
        self.mean.copy_(x.mean(0))
        std = x.std(0) if len(x) > 1 else torch.ones_like(self.std)
        self.std.copy_(std.clamp(min=max(0.05 * std.median().item(), 1e-6)))

    def forward(self, x: Tensor) -> Tensor:
        """(..., size) -> (..., size)."""
        return ((x - self.mean) / self.std).clamp(-CLIP, CLIP)
