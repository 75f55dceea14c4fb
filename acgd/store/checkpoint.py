"""Checkpoints of a training run: one safetensors file, replaced as a whole. A kill leaves the old or the new one."""

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from acgd.store.atomic import replace_file

FILE = "checkpoint.safetensors"


def save(directory: Path, tensors: dict[str, Tensor], notes: dict[str, Any]) -> None:
    """Writes the tensors, with `notes` as JSON in the header of the same file."""
    ready = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    replace_file(directory / FILE, lambda draft: save_file(ready, draft, metadata={"notes": json.dumps(notes)}))


def load(directory: Path) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
    """Tensors and notes of the last `save`, or None without a checkpoint."""
    if not (directory / FILE).exists():
        return None
    with safe_open(directory / FILE, framework="pt") as file:
        return {name: file.get_tensor(name) for name in file.keys()}, json.loads(file.metadata()["notes"])


Generators = dict[str, torch.Generator]


def training_state(model: nn.Module, optimiser: torch.optim.Optimizer, generators: Generators) -> dict[str, Tensor]:
    """The state that a step depends on, flat: `model.*`, `optimiser.<parameter>.<moment>`, `generator.*`."""
    tensors = {f"model.{name}": value for name, value in model.state_dict().items()} | moments_of(
        optimiser, "optimiser."
    )
    return tensors | {f"generator.{name}": generator.get_state() for name, generator in generators.items()}


def restore(
    tensors: dict[str, Tensor], model: nn.Module, optimiser: torch.optim.Optimizer, generators: Generators
) -> None:
    """Loads model, optimiser and generators from the tensors of `training_state`."""
    model.load_state_dict(under(tensors, "model."))
    restore_moments(optimiser, tensors, "optimiser.")
    for name, generator in generators.items():
        generator.set_state(tensors[f"generator.{name}"])


def moments_of(optimiser: torch.optim.Optimizer, prefix: str) -> dict[str, Tensor]:
    """Moments of an optimiser, named `<prefix><parameter>.<moment>`."""
    state = optimiser.state_dict()["state"]
    return {f"{prefix}{index}.{name}": value for index, moments in state.items() for name, value in moments.items()}


def restore_moments(optimiser: torch.optim.Optimizer, tensors: dict[str, Tensor], prefix: str) -> None:
    """Loads an optimiser's moments from the tensors of `moments_of`. Ignores tensors without the prefix."""
    moments: dict[int, dict[str, Tensor]] = {}
    for name, value in under(tensors, prefix).items():
        index, moment = name.split(".")
        moments.setdefault(int(index), {})[moment] = value
    optimiser.load_state_dict({**optimiser.state_dict(), "state": moments})


def under(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """The tensors whose name begins with `prefix`, under their names without it."""
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}
