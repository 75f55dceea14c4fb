"""Demonstrations as tensors, and balanced batches of windows from them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from acgd.rollouts.dataset import Demonstrations
from acgd.rollouts.store import read_group
from acgd.rollouts.windows import Windows
from acgd.students.observer import Observation
from acgd.students.settings import CodebookConfig

LABELS = {"mean": "mean_action", "executed": "action"}


@dataclass(frozen=True)
class Batch:
    """Windows that begin at the steps t (B,)."""

    t: Tensor
    observation: Observation
    chunk: Tensor
    """(B, k, A) labels a_{t:t+k}; past the episode's end its last label repeats."""
    mask: Tensor
    """(B, k) true on steps inside the episode."""


@dataclass(frozen=True)
class Data:
    """Windows over the demonstrations of every task, with vision as features, or as images where the student owns its CNN."""

    windows: Windows
    by_task: list[Tensor]
    """Training steps of each task."""
    goals: list[Tensor]
    """Training episodes of each task."""
    goal_image: str
    k: int
    h: int

    @classmethod
    def load(
        cls,
        rollouts: Sequence[Path],
        features: Sequence[Path] | None,
        config: CodebookConfig,
        states: bool,
        device: torch.device,
    ) -> "Data":
        """`features` None: read the images. `states`: also read the privileged states, for the critic."""
        label = LABELS[config.label]
        names = (
            ["proprio", label] + (["state"] if states else []) + (["image", "final_image"] if features is None else [])
        )
        demonstrations = [Demonstrations.load(directory, names) for directory in rollouts]
        steps, episodes = [], []
        for index, demo in enumerate(demonstrations):
            seen = (
                demo.arrays
                if features is None
                else read_group(Path(features[index]) / "features.zarr", ["image", "final_image"])
            )
            step = {"vision": seen["image"], "proprio": demo.arrays["proprio"], "label": demo.arrays[label]}
            steps.append(step | ({"state": demo.arrays["state"]} if states else {}))
            episodes.append({"goal": seen["final_image"]})
        return cls.of(Windows.join(demonstrations, steps, episodes, device), config)

    @classmethod
    def of(cls, windows: Windows, config: CodebookConfig) -> "Data":
        """Over windows with the steps `vision`, `proprio`, `label` and, for the critic, `state`, and the episodes' `goal`."""
        tasks = int(windows.episode_task.max()) + 1
        by_task = [windows.training[windows.task[windows.training] == task] for task in range(tasks)]
        goals = [windows.episode[steps].unique() for steps in by_task]
        return cls(windows, by_task, goals, config.goal_image, config.chunk, config.history)

    def sample(self, n: int, generator: torch.Generator) -> Tensor:
        """n training steps, task by task in turn, so that any first rows of a batch are balanced too -> (n,)."""
        tasks, device = len(self.by_task), self.windows.task.device
        rows = -(-n // tasks)
        drawn = [
            steps[torch.randint(len(steps), (rows,), generator=generator, device=device)] for steps in self.by_task
        ]
        return torch.stack(drawn, dim=1).flatten()[:n]

    def batch(self, t: Tensor, generator: torch.Generator) -> Batch:
        """The windows at t (B,); the generator draws goals where any training goal of the task will do."""
        windows = self.windows
        task = windows.task[t]
        chunk, mask = windows.chunk_of("label", t, self.k)
        proprio = windows.history_of("proprio", t, self.h - 1)
        return Batch(
            t, Observation(windows.steps["vision"][t], self._goal(t, task, generator), proprio, task), chunk, mask
        )

    def states(self, t: Tensor) -> Tensor:
        """Privileged states s_{t+j} under each step of the chunk, for the critic alone, (B, k, S)."""
        return self.windows.chunk_of("state", t, self.k)[0]

    def _goal(self, t: Tensor, task: Tensor, generator: torch.Generator) -> Tensor | None:
        if self.goal_image == "off":
            return None
        episode = self.windows.episode[t]
        if self.goal_image == "any":
            share = torch.rand(len(t), generator=generator, device=t.device)
            counts = torch.tensor([len(goals) for goals in self.goals], device=t.device)
            offsets = counts.cumsum(0) - counts
            episode = torch.cat(self.goals)[offsets[task] + (share * counts[task]).long()]
        return self.windows.episodes["goal"][episode]
