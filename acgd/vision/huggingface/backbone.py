"""A vision model of `transformers`, loaded from a local folder that `save_pretrained` wrote. Downloads nothing."""

import json
from pathlib import Path
from typing import Self

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from acgd.store.stage import Context, Inputs
from acgd.vision.huggingface.settings import HuggingFaceConfig
from acgd.vision.pretrained import IMAGENET_MEAN, IMAGENET_STD, Preprocess


class HuggingFace(nn.Module):
    """Images (B, H, W, 3) uint8 -> (B, dim): the model's pooled output, or the mean of its tokens or feature map."""

    def __init__(self, model: nn.Module, size: int, mean: list[float], std: list[float]) -> None:
        super().__init__()
        self.preprocess = Preprocess(size, tuple(mean), tuple(std))
        self.model = model.eval()
        with torch.no_grad():
            self.dim = self(torch.zeros(1, size, size, 3, dtype=torch.uint8)).shape[1]

    def forward(self, images: Tensor) -> Tensor:
        out = self.model(pixel_values=self.preprocess(images))
        if getattr(out, "pooler_output", None) is not None:
            return out.pooler_output.flatten(1).float()
        last = out.last_hidden_state
        return (last.mean(1) if last.ndim == 3 else last.mean((2, 3))).float()

    @classmethod
    def make(cls, settings: HuggingFaceConfig, inputs: Inputs, ctx: Context) -> None:
        """Copies the vision part: writes backbone.safetensors, and backbone.json with the model's configuration.

        Raises ValueError where the folder has no model with safetensors weights.
        """
        from transformers import AutoModel

        path = settings.path
        try:
            model = AutoModel.from_pretrained(path, local_files_only=True, use_safetensors=True)
        except (OSError, ValueError) as error:
            raise ValueError(
                f"{path} is no folder of a transformers model with safetensors weights ({error}). "
                "Write it with save_pretrained."
            ) from error
        model = _vision_part(model)
        mean, std = _statistics(path)
        meta = {
            "kind": "huggingface",
            "size": settings.size,
            "mean": mean,
            "std": std,
            "model": {**model.config.to_diff_dict(), "model_type": model.config.model_type},
        }
        cls(model, settings.size, mean, std)  # raises an error where the model cannot read images of this size
        save_file({k: v.contiguous().clone() for k, v in model.state_dict().items()}, ctx.out / "backbone.safetensors")
        (ctx.out / "backbone.json").write_text(json.dumps(meta, indent=1, sort_keys=True) + "\n")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Loads the files of `make`."""
        from transformers import AutoConfig, AutoModel

        meta = json.loads((folder / "backbone.json").read_text())
        config = dict(meta["model"])
        model = _vision_part(AutoModel.from_config(AutoConfig.for_model(config.pop("model_type"), **config)))
        model.load_state_dict(load_file(folder / "backbone.safetensors"))
        return cls(model, meta["size"], meta["mean"], meta["std"])


def _vision_part(model: nn.Module) -> nn.Module:
    """The vision tower of a model with vision and language, else the model."""
    return getattr(model, "vision_model", model)


def _statistics(path: Path) -> tuple[list[float], list[float]]:
    """Channel means and standard deviations of preprocessor_config.json; by default those of ImageNet."""
    file = path / "preprocessor_config.json"
    stored = json.loads(file.read_text()) if file.is_file() else {}
    return stored.get("image_mean", list(IMAGENET_MEAN)), stored.get("image_std", list(IMAGENET_STD))
