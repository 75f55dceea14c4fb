"""R3M (Nair et al. 2022), the paper's backbone: a ResNet whose weights are in a file that the user names.

The published checkpoint is a pickle, {"r3m": {"module.convnet.<name>": tensor, ...}}. The stage reads it once, with
weights_only, and writes its ResNet as safetensors. The language part is left out.
"""

import json
import pickle
from pathlib import Path
from typing import Self

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from acgd.store.key import file_digest
from acgd.store.stage import Context, Inputs
from acgd.vision.pretrained import Preprocess
from acgd.vision.r3m.resnet import DEPTHS, ResNet
from acgd.vision.r3m.settings import R3MConfig

PREFIX = "module.convnet."


class R3M(nn.Module):
    """Images (B, H, W, 3) uint8 -> (B, dim): 512, or 2048 for ResNet-50."""

    def __init__(self, depth: int, size: int) -> None:
        super().__init__()
        self.preprocess = Preprocess(size)
        self.convnet = ResNet(depth)
        self.dim = self.convnet.dim

    def forward(self, images: Tensor) -> Tensor:
        return self.convnet(self.preprocess(images))

    @classmethod
    def make(cls, settings: R3MConfig, inputs: Inputs, ctx: Context) -> None:
        """Converts the checkpoint: writes backbone.safetensors, and backbone.json with the checkpoint's SHA-256.

        Raises ValueError where the file is no R3M checkpoint.
        """
        path, size = settings.path, settings.size
        weights = read_checkpoint(path)
        backbone = cls(depth_of(weights, path), size)
        missing, unexpected = backbone.convnet.load_state_dict(weights, strict=False)
        if missing or unexpected:
            raise ValueError(
                f"{path} is no R3M checkpoint: missing {missing[:3]}, unexpected {unexpected[:3]}. "
                "Set backbone.path to the published model.pt."
            )
        save_file({k: v.contiguous() for k, v in backbone.state_dict().items()}, ctx.out / "backbone.safetensors")
        meta = {"kind": "r3m", "depth": depth_of(weights, path), "size": size, "source_sha256": file_digest(path)}
        (ctx.out / "backbone.json").write_text(json.dumps(meta, indent=1, sort_keys=True) + "\n")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Loads the files of `make`."""
        meta = json.loads((folder / "backbone.json").read_text())
        backbone = cls(meta["depth"], meta["size"])
        backbone.load_state_dict(load_file(folder / "backbone.safetensors"))
        return backbone


def read_checkpoint(path: Path) -> dict[str, Tensor]:
    """Name -> tensor of the ResNet. torch unpickles tensors and plain containers only.

    Raises ValueError where the file is no R3M checkpoint.
    """
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        tensors = content["r3m"]
    except (pickle.UnpicklingError, RuntimeError, KeyError, TypeError, EOFError) as error:
        raise ValueError(
            f"{path} is no R3M checkpoint ({type(error).__name__}: {error}). "
            "Set backbone.path to the published model.pt."
        ) from error
    return {name.removeprefix(PREFIX): value for name, value in tensors.items() if name.startswith(PREFIX)}


def depth_of(weights: dict[str, Tensor], path: Path) -> int:
    """Depth 18, 34 or 50, from the number of blocks. Raises ValueError for any other network."""
    blocks = tuple(len({name.split(".")[1] for name in weights if name.startswith(f"layer{i}.")}) for i in range(1, 5))
    bottleneck = "layer1.0.conv3.weight" in weights
    for depth, expected in DEPTHS.items():
        if blocks == expected and bottleneck == (depth >= 50):
            return depth
    raise ValueError(
        f"{path} holds no ResNet-18, -34 or -50 under {PREFIX}: its layers have {blocks} blocks. "
        "Set backbone.path to the published model.pt."
    )
