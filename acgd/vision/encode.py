"""The stage `features`: applies a frozen backbone once to every frame of one task's rollouts."""

import numpy as np
import torch
from torch import Tensor

from acgd.rollouts.dataset import Demonstrations
from acgd.rollouts.store import write_group
from acgd.store.precision import in_bfloat16
from acgd.store.stage import Context, Inputs
from acgd.vision.backbones import Backbone, load
from acgd.vision.settings import FeaturesConfig, FeaturesRequest


def encode(request: FeaturesRequest, inputs: Inputs, ctx: Context) -> None:
    """Writes features.zarr: `image` (T, F) and `final_image` (E, F), float32."""
    backbone = load(inputs["backbone"], ctx.device)
    demos = Demonstrations.load(inputs["rollouts"], ["image", "final_image"])
    total = sum(len(frames) for frames in demos.arrays.values())
    with ctx.progress(total, "encoding frames") as bar:
        features = {}
        for name, frames in demos.arrays.items():
            parts = []
            for batch in torch.from_numpy(frames).split(request.features.batch):
                parts.append(_encode(backbone, batch.to(ctx.device), request.features).cpu().numpy())
                bar.update(len(batch))
            features[name] = np.concatenate(parts)
    write_group(ctx.out / "features.zarr", features, {"dim": backbone.dim})


@torch.inference_mode()
def _encode(backbone: Backbone, images: Tensor, settings: FeaturesConfig) -> Tensor:
    """images (B, H, W, 3) uint8 -> (B, F) float32."""
    with torch.autocast(images.device.type, torch.bfloat16, enabled=in_bfloat16(settings.precision, images.device)):
        return backbone(images).float()
