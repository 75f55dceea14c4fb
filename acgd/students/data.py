"""Rollouts as tensors, and balanced batches of windows from them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from acgd.guidance.guidance import Reference
from acgd.rollouts.dataset import Demonstrations
from acgd.rollouts.store import read_group
from acgd.rollouts.windows import Windows
from acgd.store.stage import Inputs
from acgd.students.settings import ImitationConfig

LABELS = {"mean": "mean_action", "executed": "action"}
"""Setting `imitation.label` -> array of the store."""


@dataclass(frozen=True)
class Observation:
    """All that a student may read. The privileged state is no part of it."""

    vision: Tensor
    """(B, frames F) features of a frozen backbone, oldest frame first, or (B, H, W, 3) uint8 images where the student
    owns its CNN."""
    goal: Tensor | None
    """Of the goal image o_T (B, F) or (B, H, W, 3); or the commanded goal (B, G), zero-padded to the widest task's."""
    proprio: Tensor
    """(B, h, P), oldest first; the last row is the current one."""
    task: Tensor
    """(B,) long, index in the study's list of tasks."""


@dataclass(frozen=True)
class Batch:
    """Windows that begin at the steps t (B,)."""

    t: Tensor
    observation: Observation
    chunk: Tensor
    """(B, k, A) labels a_{t:t+k}; past the episode's end its last label repeats."""
    mask: Tensor
    """(B, k) true on steps inside the episode."""
    weight: Tensor
    """(B,) of the imitation loss: 0 where a window has no label, else 1."""
    targets: dict[str, Tensor]
    """Name -> (B, ...): what the kind of student has computed for each window."""


@dataclass(frozen=True)
class Data:
    """Windows over the rollouts of every task, with vision as features, or as images where the student owns its CNN.

    Steps: `vision`, `proprio`, `label`, `weight` and, for guidance, `state`. Episodes: `goal`.
    """

    windows: Windows
    by_task: list[Tensor]
    """Training steps of each task."""
    goals: list[Tensor]
    """Training episodes of each task whose last image may be a goal: demonstrations, which all succeeded."""
    demonstrated: Tensor
    """(K,) bool: episodes that are demonstrations, not on-policy episodes."""
    imitation: ImitationConfig
    k: int
    h: int
    targets: dict[str, Tensor] = field(default_factory=dict)
    """Name -> (N, ...), see Batch."""

    @classmethod
    def load(
        cls,
        inputs: Inputs,
        imitation: ImitationConfig,
        *,
        chunk: int,
        history: int,
        states: bool,
        device: torch.device,
        onpolicy_labels: str = "expert",
    ) -> "Data":
        """Reads the inputs `rollouts` and `onpolicy`, with `features` and `onpolicy_features`, or else the images.

        `states`: read the privileged states too, for guidance. `onpolicy_labels`: expert, or none; with none the action
        of an on-policy window is the executed one, and its weight is 0.
        """
        label, labelled = ("mean_action", 1.0) if onpolicy_labels == "expert" else ("action", 0.0)
        tasks = len(inputs["rollouts"])
        episodes = [
            _read(rollouts, features, LABELS[imitation.label], imitation, weight=1.0, states=states)
            for rollouts, features in _pairs(inputs, "rollouts", "features")
        ] + [
            _read(rollouts, features, label, imitation, weight=labelled, states=states)
            for rollouts, features in _pairs(inputs, "onpolicy", "onpolicy_features")
        ]
        demonstrations, per_step, per_episode = zip(*episodes)
        windows = Windows.join(demonstrations, per_step, per_episode, device)
        return cls.of(_by_task(windows, tasks), imitation, chunk, history, demonstrated=windows.episode_task < tasks)

    @classmethod
    def of(
        cls, windows: Windows, imitation: ImitationConfig, chunk: int, history: int, demonstrated: Tensor | None = None
    ) -> "Data":
        """Over windows; without `demonstrated` (K,) all their episodes are demonstrations."""
        if demonstrated is None:
            demonstrated = torch.ones_like(windows.episode_task, dtype=torch.bool)
        tasks = int(windows.episode_task.max()) + 1
        by_task = [windows.training[windows.task[windows.training] == task] for task in range(tasks)]
        episodes = [windows.episode[steps].unique() for steps in by_task]
        return cls(
            windows=windows,
            by_task=by_task,
            goals=[of_task[demonstrated[of_task]] for of_task in episodes],
            demonstrated=demonstrated,
            imitation=imitation,
            k=chunk,
            h=history,
        )

    def with_targets(self, targets: dict[str, Tensor]) -> "Data":
        """The same, whose batches hold the kind's targets."""
        return replace(self, targets=targets)

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
        observation = Observation(self._vision(t), self._goal(t, task, generator), proprio, task)
        targets = {name: value[t] for name, value in self.targets.items()}
        return Batch(t, observation, chunk, mask, windows.steps["weight"][t], targets)

    def reference(self, batch: Batch, n: int | None = None) -> Reference:
        """What guidance sees of the first n windows of a batch."""
        states, _ = self.windows.chunk_of("state", batch.t[:n], self.k)
        return Reference(states, batch.chunk[:n], batch.mask[:n], batch.observation.task[:n])

    def _vision(self, t: Tensor) -> Tensor:
        """Features (..., frames F) of the frames at t (...) and before, oldest first; images where frames is 1."""
        vision, frames = self.windows.steps["vision"], self.imitation.frames
        if frames == 1:
            return vision[t]
        return vision[self.windows.earlier(t, frames, self.imitation.frame_stride)].flatten(-2)

    def _goal(self, t: Tensor, task: Tensor, generator: torch.Generator) -> Tensor | None:
        """Any training goal image of the task, or the episode's own; or the commanded goal.

        On-policy episodes may have failed: they have no goal image.
        """
        goal = self.imitation.goal
        if goal == "off":
            return None
        episode = self.windows.episode[t]
        if goal == "vector":
            return self.windows.episodes["goal"][episode]
        own = self.demonstrated[episode]
        if goal == "any" or not own.all():
            share = torch.rand(len(t), generator=generator, device=t.device)
            counts = torch.tensor([len(goals) for goals in self.goals], device=t.device)
            offsets = counts.cumsum(0) - counts
            drawn = torch.cat(self.goals)[offsets[task] + (share * counts[task]).long()]
            episode = drawn if goal == "any" else torch.where(own, episode, drawn)
        return self.windows.episodes["goal"][episode]


def _pairs(inputs: Inputs, rollouts: str, features: str) -> list[tuple[Path, Path | None]]:
    """Rollouts with their features, None where there are no features; nothing where the role is absent."""
    paths = inputs.get(rollouts, [])
    return list(zip(paths, inputs.get(features) or [None] * len(paths), strict=True))


def _read(
    rollouts: Path,
    features: Path | None,
    label: str,
    imitation: ImitationConfig,
    *,
    weight: float,
    states: bool,
) -> tuple[Demonstrations, Mapping[str, np.ndarray], Mapping[str, np.ndarray]]:
    """One artifact: its episodes, and the arrays of its steps and of its episodes that Data joins."""
    names = ["proprio", label, *(["state"] if states else []), *(["goal"] if imitation.goal == "vector" else [])]
    episodes = Demonstrations.load(rollouts, names + (["image", "final_image"] if features is None else []))
    seen = (
        episodes.arrays if features is None else read_group(Path(features) / "features.zarr", ["image", "final_image"])
    )
    steps = {
        "vision": seen["image"],
        "proprio": episodes.arrays["proprio"],
        "label": episodes.arrays[label],
        "weight": np.full(len(episodes.arrays["proprio"]), weight, np.float32),
    }
    if states:
        steps["state"] = episodes.arrays["state"]
    goal = episodes.arrays["goal"] if imitation.goal == "vector" else seen["final_image"]
    return episodes, steps, {"goal": goal}


def _by_task(windows: Windows, tasks: int) -> Windows:
    """Windows joined from demonstrations of each task and then rollouts round by round, numbered by task.

    All on-policy steps are for training: validation stays that of the demonstrations.
    """
    onpolicy = windows.task[windows.validation] >= tasks
    return replace(
        windows,
        task=windows.task % tasks,
        episode_task=windows.episode_task % tasks,
        training=torch.cat([windows.training, windows.validation[onpolicy]]),
        validation=windows.validation[~onpolicy],
    )
