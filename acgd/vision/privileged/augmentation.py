"""Augmentations: small changes of an image that keep its content."""

import torch
from torch import Tensor
from torch.nn import functional as F


def shift(images: Tensor, pixels: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Shifts each image (B, H, W, 3) by up to `pixels` rows and columns and pads with black -> images, moves (B, 2)."""
    batch, height, width, _ = images.shape
    padded = F.pad(images, (0, 0, pixels, pixels, pixels, pixels))
    moved = torch.randint(-pixels, pixels + 1, (batch, 2), generator=generator).to(images.device)
    first = pixels - moved
    rows = first[:, :1] + torch.arange(height, device=images.device)
    columns = first[:, 1:] + torch.arange(width, device=images.device)
    index = torch.arange(batch, device=images.device)
    return padded[index[:, None, None], rows[:, :, None], columns[:, None, :]], moved


def brighten(images: Tensor, strength: float, generator: torch.Generator) -> Tensor:
    """Multiplies each channel of each image (B, H, W, 3) by a gain that is uniform in 1 +- strength."""
    gain = 1 + strength * (2 * torch.rand(len(images), 1, 1, 3, generator=generator) - 1).to(images.device)
    return (images * gain).clamp(0, 255)
