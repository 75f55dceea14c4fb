"""Normalisation of network inputs by the statistics of the training data, saved with the weights."""

import torch
from torch import Tensor, nn

CLIP = 5.0
"""Bound of normalised inputs. A joint that never moved in the demonstrations must not dominate at test time."""


class Normaliser(nn.Module):
    """(x - mean) / std, clipped to [-CLIP, CLIP]."""

    mean: Tensor
    std: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))

    def fit(self, x: Tensor) -> None:
        """Sets the statistics from x (N, size). Standard deviations are at least 0.05 of their median."""
        self.mean.copy_(x.mean(0))
        std = x.std(0) if len(x) > 1 else torch.ones_like(self.std)
        self.std.copy_(std.clamp(min=max(0.05 * std.median().item(), 1e-6)))

    def forward(self, x: Tensor) -> Tensor:
        """(..., size) -> (..., size)."""
        return ((x - self.mean) / self.std).clamp(-CLIP, CLIP)
