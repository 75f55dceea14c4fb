"""A small CNN that is trained to regress object and goal from frames, and is then frozen.

The privileged state supervises the training. The trained network reads the image only. The held-out validation episodes
take no part in the training.
"""

import json
import math
from pathlib import Path
from typing import Self

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from torch.nn import functional as F

from acgd.store import checkpoint
from acgd.store.precision import in_bfloat16
from acgd.store.stage import Context, Inputs
from acgd.vision.cnn import SmallCNN
from acgd.vision.privileged.augmentation import brighten, shift
from acgd.vision.privileged.frames import Frames
from acgd.vision.privileged.settings import PrivilegedConfig

WARM_UP = 50
"""Steps of linear warm-up."""
LOG_EVERY = 50
VALIDATE_EVERY = 500


class Privileged(nn.Module):
    """SmallCNN and one linear head per task. The features are the outputs of the CNN and of all heads."""

    def __init__(self, dim: int, targets: list[int]) -> None:
        super().__init__()
        self.cnn = SmallCNN(dim)
        self.heads = nn.ModuleList([nn.Linear(dim, n) for n in targets])
        self.dim = dim + sum(targets)

    def forward(self, images: Tensor) -> Tensor:
        """Images (B, H, W, 3) uint8 -> (B, dim)."""
        trunk = self.cnn(images)
        return torch.cat([trunk, *(head(trunk) for head in self.heads)], 1)

    def loss(self, images: Tensor, moved: Tensor | None, targets: list[Tensor]) -> Tensor:
        """Mean over tasks of the smooth L1 loss. Images (K * n, H, W, 3), task by task; K targets, each (n, D_k)."""
        parts = self.cnn(images, moved).float().chunk(len(targets))
        return torch.stack([F.smooth_l1_loss(h(x), y, beta=0.5) for h, x, y in zip(self.heads, parts, targets)]).mean()

    @classmethod
    def make(cls, settings: PrivilegedConfig, inputs: Inputs, ctx: Context) -> None:
        """Trains the network, or resumes from the checkpoint. Writes backbone.safetensors and backbone.json."""
        frames = [Frames.load(path, settings.frames, ctx.device) for path in inputs["rollouts"]]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(settings.seed)
            backbone = cls(settings.dim, [len(each.names) for each in frames]).to(ctx.device)
        train(backbone, frames, settings, ctx)
        save_file({k: v.cpu().contiguous() for k, v in backbone.state_dict().items()}, ctx.out / "backbone.safetensors")
        meta = {"kind": "privileged", "dim": settings.dim, "tasks": validate(backbone, frames)}
        (ctx.out / "backbone.json").write_text(json.dumps(meta, indent=1, sort_keys=True) + "\n")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Loads the files of `make`."""
        meta = json.loads((folder / "backbone.json").read_text())
        weights = load_file(folder / "backbone.safetensors")
        backbone = cls(meta["dim"], [weights[f"heads.{k}.bias"].shape[0] for k in range(len(meta["tasks"]))])
        backbone.load_state_dict(weights)
        return backbone


def train(backbone: Privileged, frames: list[Frames], settings: PrivilegedConfig, ctx: Context) -> None:
    """The optimisation loop. A resumed run equals an uninterrupted one bit for bit."""
    generators = {"frames": torch.Generator().manual_seed(settings.seed)}
    optimiser = torch.optim.AdamW(backbone.parameters(), settings.learning_rate, weight_decay=settings.weight_decay)
    notes = {"step": 0}
    if (saved := checkpoint.load(ctx.state)) is not None:
        tensors, notes = saved
        checkpoint.restore(tensors, backbone, optimiser, generators)
    ctx.metrics.rewind(notes["step"])
    with ctx.progress(settings.steps, "training the backbone", done=notes["step"]) as bar:
        for step in range(notes["step"] + 1, settings.steps + 1):
            loss = _step(backbone, optimiser, frames, settings, step, generators["frames"])
            if step % LOG_EVERY == 0:
                ctx.metrics.log(step, loss=loss.item())
                bar.update(LOG_EVERY, loss=loss.item())
            if step % VALIDATE_EVERY == 0 or step == settings.steps:
                ctx.metrics.log(step, **_curves(validate(backbone, frames)))
            if step % settings.checkpoint_every == 0:
                ctx.metrics.flush()
                checkpoint.save(ctx.state, checkpoint.training_state(backbone, optimiser, generators), {"step": step})


def _step(
    backbone: Privileged,
    optimiser: torch.optim.Optimizer,
    frames: list[Frames],
    settings: PrivilegedConfig,
    step: int,
    generator: torch.Generator,
) -> Tensor:
    """One update -> loss (). `step` counts from 1."""
    backbone.train()
    rate = (
        settings.learning_rate * min(1.0, step / WARM_UP) * 0.5 * (1 + math.cos(math.pi * (step - 1) / settings.steps))
    )
    for group in optimiser.param_groups:
        group["lr"] = rate
    n = max(2, settings.batch // len(frames))
    drawn = [
        each.training[torch.randint(len(each.training), (n,), generator=generator).to(each.training.device)]
        for each in frames
    ]
    images = torch.cat([each.images[rows] for each, rows in zip(frames, drawn)])
    moved = None
    if settings.shift:
        images, moved = shift(images, settings.shift, generator)
    if settings.brightness:
        images = brighten(images, settings.brightness, generator)
    with torch.autocast(images.device.type, torch.bfloat16, enabled=in_bfloat16(settings.precision, images.device)):
        loss = backbone.loss(images, moved, [each.targets[rows] for each, rows in zip(frames, drawn)])
    optimiser.zero_grad(set_to_none=True)
    loss.backward()
    optimiser.step()
    return loss.detach()


@torch.no_grad()
def validate(backbone: Privileged, frames: list[Frames]) -> dict[str, dict]:
    """Task -> target -> R^2 and root mean square error (m or rad) on the held-out episodes.

    R^2 is relative to the variance over the training frames. A goal is constant within an episode, so its variance over
    few held-out episodes is unreliable.
    """
    backbone.eval()
    scores = {}
    for head, each in zip(backbone.heads, frames):
        predicted = torch.cat([head(backbone.cnn(each.images[rows])) for rows in each.validation.split(256)])
        error = (predicted - each.targets[each.validation]).square().mean(0)
        rmse = error.sqrt() * each.std
        scores[each.task] = {
            name: {"r2": r, "rmse": e} for name, r, e in zip(each.names, (1 - error).tolist(), rmse.tolist())
        }
    return scores


def _curves(scores: dict[str, dict]) -> dict[str, float]:
    """`r2/<task>/<target>` -> R^2, for metrics.jsonl."""
    return {f"r2/{task}/{name}": score["r2"] for task, targets in scores.items() for name, score in targets.items()}
