"""A vision model of `transformers`, loaded from a local folder that `save_pretrained` wrote. Downloads nothing."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Self

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from acgd.store.stage import Context, Inputs
from acgd.vision.huggingface.settings import HuggingFaceConfig
from acgd.vision.pretrained import IMAGENET_MEAN, IMAGENET_STD, Preprocess
from acgd.vision.weights import statistics


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

        Weights of any precision become float32. A model whose folder has no weights of the pooler loses its pooler.
        Raises ValueError where the folder has no model with safetensors weights, or lacks other weights.
        """
        from transformers import AutoModel

        path = settings.path
        try:
            whole, loaded = AutoModel.from_pretrained(
                path, local_files_only=True, use_safetensors=True, dtype=torch.float32, output_loading_info=True
            )
        except (OSError, ValueError, RuntimeError, SafetensorError) as error:
            raise ValueError(
                f"{path} is no folder of a transformers model with safetensors weights ({error}). "
                "Write it with save_pretrained."
            ) from error
        model = _vision_part(whole).float()
        pooled = _complete(model, _missing(whole, loaded["missing_keys"]), path)
        mean, std = (
            list(default) if stored is None else stored
            for stored, default in zip(statistics(path), (IMAGENET_MEAN, IMAGENET_STD))
        )
        meta = {
            "kind": "huggingface",
            "size": settings.size,
            "mean": mean,
            "std": std,
            "model": {**model.config.to_diff_dict(), "model_type": model.config.model_type},
        } | ({} if pooled else {"pooler": False})
        try:
            cls(model, settings.size, mean, std)
        except (ValueError, RuntimeError) as error:
            raise ValueError(
                f"the model in {path} does not read images of {settings.size} pixels ({error}): "
                "set backbone.size to the image_size of its config.json"
            ) from error
        save_file({k: v.contiguous().clone() for k, v in model.state_dict().items()}, ctx.out / "backbone.safetensors")
        (ctx.out / "backbone.json").write_text(json.dumps(meta, indent=1, sort_keys=True) + "\n")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Loads the files of `make`."""
        from transformers import AutoConfig, AutoModel

        meta = json.loads((folder / "backbone.json").read_text())
        config = dict(meta["model"])
        model = _vision_part(AutoModel.from_config(AutoConfig.for_model(config.pop("model_type"), **config))).float()
        if not meta.get("pooler", True):
            model.pooler = None
        model.load_state_dict(load_file(folder / "backbone.safetensors"))
        return cls(model, meta["size"], meta["mean"], meta["std"])


def _vision_part(model: nn.Module) -> nn.Module:
    """The vision tower of a model with vision and language, else the model."""
    return getattr(model, "vision_model", model)


def _missing(whole: nn.Module, names: Iterable[str]) -> set[str]:
    """Names of the weights that the folder lacks, as the vision part names them."""
    prefix = "vision_model." if hasattr(whole, "vision_model") else ""
    counters = "num_batches_tracked"  # of batch normalisation in training
    return {name.removeprefix(prefix) for name in names if name.startswith(prefix) and not name.endswith(counters)}


def _complete(model: nn.Module, missing: set[str], path: Path) -> bool:
    """Whether the model keeps its pooler. transformers draws absent weights at random: a pooler without weights is
    removed, and ValueError is raised for other weights."""
    others = sorted(name for name in missing if not name.startswith("pooler."))
    if others:
        raise ValueError(
            f"the weights in {path} lack {len(others)} tensors of the model in its config.json "
            f"({', '.join(others[:3])}). "
            "Download weights and config.json of one model."
        )
    if missing:
        model.pooler = None
    return not missing
