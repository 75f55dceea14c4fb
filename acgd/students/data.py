"""Rollouts as tensors, and batches of windows that are balanced over tasks."""

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
    """The inputs of a student. They exclude the privileged state."""

    vision: Tensor
    """(B, frames F) features of a frozen backbone, oldest frame first, or (B, H, W, 3) uint8 images for a student with
    a CNN. For a recurrent kind (B, k, frames F) or (B, k, H, W, 3), oldest step first.
    """
    goal: Tensor | None
    """Goal image o_T as features (B, F) or an image (B, H, W, 3), or the commanded goal (B, G), zero-padded to the
    widest task's. None for a student without goals.
    """
    proprio: Tensor
    """(B, h, P), oldest first. The last row belongs to the current step. For a recurrent kind (B, k, P)."""
    task: Tensor
    """(B,) long, index in the study's list of tasks."""


@dataclass(frozen=True)
class Batch:
    """B windows."""

    t: Tensor
    """(B,) long, first steps of the windows."""
    observation: Observation
    chunk: Tensor
    """(B, k, A) labels a_{t:t+k}. The last label of an episode repeats past its end."""
    mask: Tensor
    """(B, k) true on steps inside the episode."""
    weight: Tensor
    """(B,) weight of the imitation loss: 0 for a window without a label, else 1."""
    targets: dict[str, Tensor]
    """Name -> (B, ...): targets from `Student.prepare`."""


@dataclass(frozen=True)
class Data:
    """Windows over the rollouts of all tasks.

    Arrays of `windows.steps`: `vision`, `proprio`, `label`, `weight` and, for guidance, `state`. Array of
    `windows.episodes`: `goal`. `vision` and `goal` are features, or images for a student with a CNN; with
    `imitation.goal: vector` the goal is the commanded one.
    """

    windows: Windows
    by_task: list[Tensor]
    """Training steps of each task, each (n_i,) long."""
    goals: list[Tensor]
    """Training episodes of each task whose last image may be a goal: the demonstrations, which all succeeded."""
    demonstrated: Tensor
    """(K,) bool: true for demonstrations, false for on-policy episodes."""
    imitation: ImitationConfig
    k: int
    """Actions in a window."""
    h: int
    """Proprioceptive states in a window."""
    recurrent: bool = False
    """Whether a window has an observation for each of its k actions. Past the episode's end the last one repeats."""
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
        recurrent: bool = False,
    ) -> "Data":
        """Reads the inputs `rollouts` and `onpolicy`, with their features, or their images if there are no features.

        states: also read the privileged states, for guidance. onpolicy_labels: `expert` or `none`. With `none` the
        label of an on-policy step is the executed action, and its weight is 0.
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
        demonstrated = windows.episode_task < tasks
        return cls.of(_by_task(windows, tasks), imitation, chunk, history, demonstrated, recurrent=recurrent)

    @classmethod
    def of(
        cls,
        windows: Windows,
        imitation: ImitationConfig,
        chunk: int,
        history: int,
        demonstrated: Tensor | None = None,
        *,
        recurrent: bool = False,
    ) -> "Data":
        """Data over `windows`. Without `demonstrated` (K,) bool all episodes are demonstrations."""
        if demonstrated is None:
            demonstrated = torch.ones_like(windows.episode_task, dtype=torch.bool)
        tasks = int(windows.episode_task.max()) + 1
        by_task = [windows.training[windows.task[windows.training] == task] for task in range(tasks)]
        episodes = [windows.episode[steps].unique() for steps in by_task]
        return cls(
            windows=windows,
            by_task=by_task,
            goals=[task_episodes[demonstrated[task_episodes]] for task_episodes in episodes],
            demonstrated=demonstrated,
            imitation=imitation,
            k=chunk,
            h=history,
            recurrent=recurrent,
        )

    def with_targets(self, targets: dict[str, Tensor]) -> "Data":
        """A copy whose batches hold these targets."""
        return replace(self, targets=targets)

    def sample(self, n: int, generator: torch.Generator) -> Tensor:
        """Draws n training steps, alternating over the tasks, so that every prefix of a batch is balanced -> (n,)."""
        tasks, device = len(self.by_task), self.windows.task.device
        rows = -(-n // tasks)
        drawn = [
            steps[torch.randint(len(steps), (rows,), generator=generator, device=device)] for steps in self.by_task
        ]
        return torch.stack(drawn, dim=1).flatten()[:n]

    def batch(self, t: Tensor, generator: torch.Generator) -> Batch:
        """The windows at the steps t (B,). The generator draws the goal images that are not fixed."""
        windows = self.windows
        task = windows.task[t]
        chunk, mask = windows.chunk_of("label", t, self.k)
        if self.recurrent:
            steps, _ = windows.chunk(t, self.k)
            vision, proprio = self._vision(steps), windows.steps["proprio"][steps]
        else:
            vision, proprio = self._vision(t), windows.history_of("proprio", t, self.h - 1)
        observation = Observation(vision, self._goal(t, task, generator), proprio, task)
        targets = {name: value[t] for name, value in self.targets.items()}
        return Batch(t, observation, chunk, mask, windows.steps["weight"][t], targets)

    def reference(self, batch: Batch, n: int | None = None) -> Reference:
        """The data of the first n windows of a batch that guidance reads."""
        states, _ = self.windows.chunk_of("state", batch.t[:n], self.k)
        return Reference(states, batch.chunk[:n], batch.mask[:n], batch.observation.task[:n])

    def _vision(self, t: Tensor) -> Tensor:
        """Features (..., frames F) of the frames at t (...) and before, oldest first; images if frames is 1."""
        vision, frames = self.windows.steps["vision"], self.imitation.frames
        if frames == 1:
            return vision[t]
        return vision[self.windows.earlier(t, frames, self.imitation.frame_stride)].flatten(-2)

    def _goal(self, t: Tensor, task: Tensor, generator: torch.Generator) -> Tensor | None:
        """Goals of the windows: any training goal of the task, or the goal of the window's episode.

        An on-policy episode may have failed. In place of its goal image its windows get any training goal of the task.
        """
        goal = self.imitation.goal
        if goal == "off":
            return None
        episode = self.windows.episode[t]
        if goal == "vector":
            return self.windows.episodes["goal"][episode]
        has_goal = self.demonstrated[episode]
        if goal == "any" or not has_goal.all():
            share = torch.rand(len(t), generator=generator, device=t.device)
            counts = torch.tensor([len(goals) for goals in self.goals], device=t.device)
            offsets = counts.cumsum(0) - counts
            drawn = torch.cat(self.goals)[offsets[task] + (share * counts[task]).long()]
            episode = drawn if goal == "any" else torch.where(has_goal, episode, drawn)
        return self.windows.episodes["goal"][episode]


def _pairs(inputs: Inputs, rollouts: str, features: str) -> list[tuple[Path, Path | None]]:
    """(rollouts, features) of each artifact. Features are None where absent. Empty if the role is absent."""
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
    """Episodes of one artifact, the arrays per step, and the arrays per episode."""
    names = ["proprio", label, *(["state"] if states else []), *(["goal"] if imitation.goal == "vector" else [])]
    episodes = Demonstrations.load(rollouts, names + (["image", "final_image"] if features is None else []))
    vision = (
        episodes.arrays if features is None else read_group(Path(features) / "features.zarr", ["image", "final_image"])
    )
    steps = {
        "vision": vision["image"],
        "proprio": episodes.arrays["proprio"],
        "label": episodes.arrays[label],
        "weight": np.full(len(episodes.arrays["proprio"]), weight, np.float32),
    }
    if states:
        steps["state"] = episodes.arrays["state"]
    return episodes, steps, {"goal": episodes.arrays["goal"] if imitation.goal == "vector" else vision["final_image"]}


def _by_task(windows: Windows, tasks: int) -> Windows:
    """Renumbers windows by task. They hold one set of demonstrations per task, then one set per round and task.

    All on-policy steps are for training. Validation uses the demonstrations only.
    """
    onpolicy = windows.task[windows.validation] >= tasks
    return replace(
        windows,
        task=windows.task % tasks,
        episode_task=windows.episode_task % tasks,
        training=torch.cat([windows.training, windows.validation[onpolicy]]),
        validation=windows.validation[~onpolicy],
    )
