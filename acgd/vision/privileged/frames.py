"""Frames of one task, with the targets of a privileged backbone: object and goal."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from acgd.rollouts.dataset import Demonstrations
from acgd.rollouts.store import read_attributes
from acgd.tasks.spec import TASKS

STD_FLOOR = 1e-3
"""A target that varies less than this (m, rad) counts as constant."""


@dataclass(frozen=True)
class Frames:
    """N frames with their targets, split into training and validation."""

    task: str
    """Name of the task."""
    images: Tensor
    """(N, H, W, 3) uint8."""
    targets: Tensor
    """(N, D), standardised over the training frames."""
    names: list[str]
    """D names `<entry of the state>.<index>`."""
    std: Tensor
    """(D,) standard deviations of the targets (m or rad)."""
    training: Tensor
    """(n,) long, indices of training frames."""
    validation: Tensor
    """(m,) long, indices of validation frames."""

    @classmethod
    def load(cls, rollouts: Path, most: int, device: torch.device) -> "Frames":
        """Loads at most `most` training frames and `most` / 4 frames of held-out episodes, both evenly spaced.

        The targets are the entries of the state that the task declares as privileged.
        """
        demos = Demonstrations.load(rollouts, ["image", "state"])
        task = read_attributes(Path(rollouts) / "rollouts.zarr")["task"]
        columns = [
            (f"{entry}.{i}", column)
            for entry in TASKS[task].privileged
            for i, column in enumerate(_columns(demos, entry))
        ]
        train, held_out = (demos.steps_of(episodes) for episodes in demos.split())
        train, held_out = _thin(train, most), _thin(held_out, max(1, most // 4))
        rows = np.concatenate([train, held_out])
        values = demos.arrays["state"][np.ix_(rows, [column for _, column in columns])]
        mean, std = values[: len(train)].mean(0), values[: len(train)].std(0).clip(STD_FLOOR)
        return cls(
            task=task,
            images=torch.from_numpy(demos.arrays["image"][rows]).to(device),
            targets=torch.from_numpy((values - mean) / std).to(device),
            names=[name for name, _ in columns],
            std=torch.from_numpy(std).to(device),
            training=torch.arange(len(train), device=device),
            validation=torch.arange(len(train), len(rows), device=device),
        )


def _columns(demos: Demonstrations, entry: str) -> range:
    """Columns of an entry in the state."""
    place = demos.state_layout[entry]
    return range(place.start, place.stop)


def _thin(rows: np.ndarray, most: int) -> np.ndarray:
    """At most `most` of the rows (n,), evenly spaced."""
    return rows if len(rows) <= most else rows[np.linspace(0, len(rows) - 1, most).round().astype(np.int64)]
