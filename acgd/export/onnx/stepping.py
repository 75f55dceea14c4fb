"""A student's policy as a pure function of tensors, for one step: what ONNX can hold.

A kind of student whose policy plans chunks by `plan` and joins them as `ChunkPolicy` does needs nothing for it. A kind
that acts otherwise offers `stepping(acting) -> Stepping` of its own. A kind whose plan is not continuous, because it
chooses between codes, offers `margin(observation) -> (B,)`: by how much the choice leads, in the group where that is
least. Steps in which it hardly leads say nothing about rounding.
"""

from typing import Protocol

import torch
from torch import Tensor, nn

from acgd.students.data import Observation
from acgd.students.settings import ActingConfig
from acgd.students.student import Student

Memory = dict[str, Tensor]
"""Name -> (B, ...). Zeros before an episode's first step."""


class Stepping(Protocol):
    """An nn.Module that takes one step."""

    memory: dict[str, tuple[tuple[int, ...], torch.dtype]]
    """Name -> shape of a row, and type."""

    def __call__(
        self, vision: Tensor, goal: Tensor | None, proprio: Tensor, task: Tensor, memory: Memory
    ) -> tuple[Tensor, Memory]:
        """Vision and goal as in Observation, proprio (B, P), task (B,) -> actions (B, A), memory of the next step."""


class Chunks(nn.Module):
    """What ChunkPolicy does, for all of its modes; with chunks of one action and no history, what BCPolicy does."""

    def __init__(self, student: Student, acting: ActingConfig) -> None:
        super().__init__()
        self.student, self.acting = student, acting
        settings, sizes = student.settings, student.sizes
        self.chunk = settings.chunk
        chunks = {"first": (), "open-loop": (1,)}.get(acting.mode, (self.chunk,))
        self.memory = {"steps": ((), torch.int64), "proprio": ((settings.history, sizes.proprio), torch.float32)}
        if chunks:
            self.memory["chunks"] = ((*chunks, self.chunk, sizes.actions), torch.float32)

    def observation(
        self, vision: Tensor, goal: Tensor | None, proprio: Tensor, task: Tensor, memory: Memory
    ) -> Observation:
        """With the history of proprioception; on the first step that step's fills it."""
        newest = proprio[:, None]
        moved = torch.cat([memory["proprio"][:, 1:], newest], 1)
        history = torch.where((memory["steps"] == 0)[:, None, None], newest.expand_as(moved), moved)
        return Observation(vision, goal, history, task)

    def forward(
        self, vision: Tensor, goal: Tensor | None, proprio: Tensor, task: Tensor, memory: Memory
    ) -> tuple[Tensor, Memory]:
        """As Stepping says."""
        observation, steps = self.observation(vision, goal, proprio, task, memory), memory["steps"]
        plan = self.student.plan(observation)
        after = {"steps": steps + 1, "proprio": observation.proprio}
        if self.acting.mode == "first":
            return plan[:, 0], after
        if self.acting.mode == "open-loop":
            age = steps % self.chunk
            plan = torch.where((age == 0)[:, None, None], plan, memory["chunks"][:, 0])
            here = torch.arange(self.chunk) == age[:, None]
            return (plan * here[..., None]).sum(1), after | {"chunks": plan[:, None]}
        chunks = torch.cat([plan[:, None], memory["chunks"][:, :-1]], 1)
        predictions = torch.stack([chunks[:, i, i] for i in range(self.chunk)], 1)
        weights = self._weights(torch.clamp(steps, max=self.chunk - 1))
        return (weights[..., None] * predictions.double()).sum(1).float(), after | {"chunks": chunks}

    def margin(self, vision: Tensor, goal: Tensor | None, proprio: Tensor, task: Tensor, memory: Memory) -> Tensor:
        """(B,), infinite for a student whose plan is continuous."""
        if not hasattr(self.student, "margin"):
            return torch.full((len(task),), torch.inf)
        return self.student.margin(self.observation(vision, goal, proprio, task, memory))

    def _weights(self, oldest: Tensor) -> Tensor:
        """Of acgd.students.ensembling: (B,) age of each row's oldest prediction -> (B, k) float64."""
        ages = torch.arange(self.chunk)
        made = ages <= oldest[:, None]
        order = ages.expand_as(made) if self.acting.mode == "ensemble-paper" else oldest[:, None] - ages
        weights = torch.where(made, torch.exp(-self.acting.eta * order.double()), 0.0)
        return weights / weights.sum(-1, keepdim=True)


def stepping_of(student: Student, acting: ActingConfig) -> Stepping:
    """The kind's own, else that of chunks."""
    own = getattr(student, "stepping", None)
    return own(acting) if own else Chunks(student, acting)
