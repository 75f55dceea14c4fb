"""The policy of a student as a pure function of tensors for one step, which ONNX can hold.

A kind of student whose policy is ChunkPolicy, or executes the one action of `plan`, needs no code for it. Another kind
has a method `stepping(acting) -> Stepping`. A kind that chooses, for example between codes, has a plan that is not
continuous. It has a method `margin(observation) -> (B,)`: the lead of the likeliest choice, in the group where the lead
is smallest. Rounding may change a choice with almost no lead, so such steps say nothing about a model's error.
"""

from typing import Protocol

import torch
from torch import Tensor, nn

from acgd.store.store import ArtifactError
from acgd.students.data import Observation
from acgd.students.settings import ActingConfig
from acgd.students.student import Student

Memory = dict[str, Tensor]
"""Name -> (B, ...). Zeros before an episode's first step."""


class Stepping(Protocol):
    """An nn.Module that takes one step. It may have `margin`, with the arguments of a call -> (B,)."""

    memory: dict[str, tuple[tuple[int, ...], torch.dtype]]
    """Name -> shape of a row, and type."""

    def __call__(
        self, vision: Tensor, goal: Tensor | None, proprio: Tensor, task: Tensor, memory: Memory
    ) -> tuple[Tensor, Memory]:
        """Vision and goal as in Observation, proprio (B, P), task (B,) -> actions (B, A), memory of the next step.

        `memory` has one more entry, which the caller updates: `steps` (B,) int64, actions taken so far.
        """


class Chunks(nn.Module):
    """The function of ChunkPolicy in all of its modes. With chunks of one action and no history that of BCPolicy."""

    def __init__(self, student: Student, acting: ActingConfig) -> None:
        super().__init__()
        self.student, self.acting = student, acting
        settings, sizes = student.settings, student.sizes
        self.chunk = settings.chunk
        chunks = {"first": (), "open-loop": (1,)}.get(acting.mode, (self.chunk,))
        self.memory = {"proprio": ((settings.history, sizes.proprio), torch.float32)}
        if chunks:
            self.memory["chunks"] = ((*chunks, self.chunk, sizes.actions), torch.float32)

    def observation(
        self, vision: Tensor, goal: Tensor | None, proprio: Tensor, task: Tensor, memory: Memory
    ) -> Observation:
        """The observation with the history of proprioception."""
        return Observation(vision, goal, appended(memory["proprio"], proprio, memory["steps"]), task)

    def forward(
        self, vision: Tensor, goal: Tensor | None, proprio: Tensor, task: Tensor, memory: Memory
    ) -> tuple[Tensor, Memory]:
        """See Stepping."""
        observation, steps = self.observation(vision, goal, proprio, task, memory), memory["steps"]
        plan = self.student.plan(observation)
        after = {"proprio": observation.proprio}
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
        """(B,) lead of the likeliest choice. Infinite for a student whose plan is continuous."""
        if not hasattr(self.student, "margin"):
            return torch.full((len(task),), torch.inf)
        return self.student.margin(self.observation(vision, goal, proprio, task, memory))

    def _weights(self, oldest: Tensor) -> Tensor:
        """As in acgd.students.ensembling: age of each row's oldest prediction (B,) -> (B, k) float64."""
        ages = torch.arange(self.chunk)
        made = ages <= oldest[:, None]
        order = ages.expand_as(made) if self.acting.mode == "ensemble-paper" else oldest[:, None] - ages
        weights = torch.where(made, torch.exp(-self.acting.eta * order.double()), 0.0)
        return weights / weights.sum(-1, keepdim=True)


def stepping_of(student: Student, acting: ActingConfig) -> Stepping:
    """The stepping of the kind, else Chunks. ArtifactError for a recurrent kind without one."""
    if hasattr(student, "stepping"):
        return student.stepping(acting)
    if student.settings.recurrent:
        raise ArtifactError(
            f"a student of kind {student.settings.kind} is recurrent and does not act by chunks: "
            "its kind must offer `stepping` (acgd/export/onnx/stepping.py)"
        )
    return Chunks(student, acting)


def appended(kept: Tensor, newest: Tensor, steps: Tensor) -> Tensor:
    """Appends `newest` (B, D) to `kept` (B, n, D), oldest first. On a row's first step it fills all n places."""
    newest = newest[:, None]
    moved = torch.cat([kept[:, 1:], newest], 1)
    return torch.where((steps == 0)[:, None, None], newest.expand_as(moved), moved)
