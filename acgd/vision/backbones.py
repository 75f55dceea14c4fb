"""All backbones by kind. A kind is a module with `make(config, inputs, ctx)` and `load(folder) -> nn.Module`."""

import json
from pathlib import Path
from types import ModuleType
from typing import Protocol

import torch
from torch import Tensor

from acgd.vision import huggingface, privileged, r3m, scratch

BACKBONES: dict[str, ModuleType] = {
    "privileged": privileged,
    "scratch": scratch,
    "r3m": r3m,
    "huggingface": huggingface,
}


class Backbone(Protocol):
    """What `load` gives: a frozen module in evaluation mode."""

    dim: int

    def __call__(self, images: Tensor) -> Tensor:
        """Images (B, H, W, 3) uint8 -> (B, dim) float32."""


def load(folder: Path, device: torch.device) -> Backbone:
    """The backbone of an artifact, frozen. ValueError for kind `scratch`, which has none."""
    folder = Path(folder)
    kind = json.loads((folder / "backbone.json").read_text())["kind"]
    return BACKBONES[kind].load(folder).to(device).eval().requires_grad_(False)
