"""The interface of a backbone, and its loader."""

import json
from pathlib import Path
from typing import Protocol, Self

import torch
from torch import Tensor

from acgd.settings import Section, imported
from acgd.store.stage import Context, Inputs
from acgd.vision.kinds import BACKBONES


class Backbone(Protocol):
    """A network of one kind: an nn.Module."""

    dim: int
    """F, number of features."""

    @classmethod
    def make(cls, settings: Section, inputs: Inputs, ctx: Context) -> None:
        """Trains or converts the network. Writes the weights, and backbone.json, whose field `kind` names the kind."""

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Loads the files of `make`. Raises ValueError for kind `scratch`, which has no network."""

    def __call__(self, images: Tensor) -> Tensor:
        """Images (B, H, W, 3) uint8 -> features (B, dim) float32."""


def load(folder: Path, device: torch.device) -> Backbone:
    """Loads the backbone of an artifact, frozen and in evaluation mode."""
    folder = Path(folder)
    kind = json.loads((folder / "backbone.json").read_text())["kind"]
    return imported(BACKBONES[kind].code).load(folder).to(device).eval().requires_grad_(False)
