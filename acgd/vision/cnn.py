"""A small network whose features are positions. It takes under 1 ms for 84 x 84 pixels on one core."""

import torch
from torch import Tensor, nn

MAPS = 32


class SmallCNN(nn.Module):
    """Images -> features (B, dim), from the centroids of feature maps.

    Two convolutions at half the resolution give 32 non-negative maps. Each map is reduced to its mass and its centre of
    mass, which is much finer than the grid. A marker of three pixels stays visible in the centre of mass; pooling would
    lose it. A frame of 84 x 84 pixels costs 19 MFLOP.
    """

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            nn.Conv2d(3, 16, 4, stride=2, padding=1),
            nn.ReLU(),
            nn.Conv2d(16, MAPS, 3, padding=1),
            nn.ReLU(),
        ).to(memory_format=torch.channels_last)
        for layer in self.convolutions:
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight)
                nn.init.zeros_(layer.bias)  # black pixels have no mass
        # scales a centroid that moves by a pixel like one that moves across the image
        self.standardise = nn.BatchNorm1d(3 * MAPS, affine=False, momentum=0.02)
        self.mix = nn.Sequential(nn.Linear(3 * MAPS, 128), nn.ReLU(), nn.Linear(128, dim))

    def forward(self, images: Tensor, moved: Tensor | None = None) -> Tensor:
        """Images (B, H, W, 3) uint8 -> (B, dim).

        moved (B, 2): shift of the content by an augmentation, in rows and columns of pixels. It is subtracted from the
        centroids, so that the features are those of the image before the shift.
        """
        rows, columns, mass = self.centroids(images)
        if moved is not None:
            shift = 2.0 * moved / torch.tensor(images.shape[1:3], device=images.device)
            share = mass / (mass + 1)
            rows, columns = rows - share * shift[:, :1], columns - share * shift[:, 1:]
        return self.mix(self.standardise(torch.cat([rows, columns, (mass + 1).log()], 1)))

    def centroids(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Row and column of each map's centroid in (-1, 1), near 0 without mass, and mass in cells; each (B, MAPS)."""
        # a permuted (B, H, W, 3) image has the memory format channels_last
        maps = self.convolutions(images.permute(0, 3, 1, 2).float().div(255.0)).float()
        row, column = ((2 * torch.arange(n, device=maps.device) + 1) / n - 1 for n in maps.shape[-2:])
        mass = maps.sum((2, 3))
        return (maps.sum(3) @ row) / (mass + 1), (maps.sum(2) @ column) / (mass + 1), mass
