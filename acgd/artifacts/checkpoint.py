"""The state of a training run as one safetensors file, replaced in one rename: a kill leaves the old or the new one."""

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import nn

from acgd.artifacts.atomic import replace_file

FILE = "checkpoint.safetensors"


def save_training(
    folder: Path, model: nn.Module, optimiser: torch.optim.Optimizer, generator: torch.Generator, notes: dict[str, Any]
) -> None:
    """Weights, the optimiser's moments and the generator; `notes` (JSON) hold the step and whatever else the loop counts."""
    tensors = {f"model.{name}": value for name, value in model.state_dict().items()}
    for index, moments in optimiser.state_dict()["state"].items():
        tensors |= {f"optimiser.{index}.{name}": value for name, value in moments.items()}
    tensors["generator"] = generator.get_state()
    tensors = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    replace_file(folder / FILE, lambda draft: save_file(tensors, draft, metadata={"notes": json.dumps(notes)}))


def restore_training(
    folder: Path, model: nn.Module, optimiser: torch.optim.Optimizer, generator: torch.Generator
) -> dict[str, Any] | None:
    """Puts back what `save_training` wrote and returns its notes; None where there is nothing to go on from."""
    if not (folder / FILE).exists():
        return None
    weights, moments = {}, {}
    with safe_open(folder / FILE, framework="pt") as file:
        notes = json.loads(file.metadata()["notes"])
        for name in file.keys():
            kind, _, rest = name.partition(".")
            if kind == "model":
                weights[rest] = file.get_tensor(name)
            elif kind == "optimiser":
                index, moment = rest.split(".")
                moments.setdefault(int(index), {})[moment] = file.get_tensor(name)
        generator.set_state(file.get_tensor("generator"))
    model.load_state_dict(weights)
    optimiser.load_state_dict({**optimiser.state_dict(), "state": moments})
    return notes
