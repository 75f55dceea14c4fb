"""What a guidance is, the one that settings name, and how much it weighs beside imitation."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from acgd.guidance.kinds import GUIDANCE
from acgd.settings import Section, imported
from acgd.store.stage import Inputs

COUNTS_FROM = 0.01
"""Below this ratio of gradient norms, guidance over imitation, a task counts as not guided."""


@dataclass(frozen=True)
class Reference:
    """What guidance sees of n windows besides the proposed chunks. The privileged states are for critics alone."""

    states: Tensor
    """(n, k, S) s_{t+j}, zero-padded to the widest task."""
    actions: Tensor
    """(n, k, A) a_{t+j} of the demonstration."""
    mask: Tensor
    """(n, k) true on steps inside the episode."""
    task: Tensor
    """(n,) long."""


class Guidance(Protocol):
    """A second teacher, whose gradient reaches the student through the chunk that it proposes."""

    alpha: float
    """Weight of the imitation loss against this one's."""
    gates: Tensor
    """(m,) factor of each task; 0 leaves the task out."""

    def rows(self, batch: int) -> int:
        """How many of the first windows of a batch it sees, at least one."""

    def loss(self, proposal: Tensor, reference: Reference) -> Tensor:
        """proposal (n, k, A), differentiable -> (n,), gates included."""

    def gain(self, proposal: Tensor, reference: Reference) -> Tensor:
        """How much better than the demonstration the proposal is, for validation, without gates -> (n,)."""


def load_guidance(settings: Section, inputs: Inputs, *, chunk: int, device: torch.device) -> Guidance | None:
    """The guidance of the kind that `settings` names, for chunks of `chunk` steps; None where there is none."""
    return imported(GUIDANCE[settings.kind].code)(settings, inputs, chunk=chunk, device=device)


def gradient_ratios(student: nn.Module, imitation: Tensor, guidance: Tensor, task: Tensor, tasks: int) -> list[float]:
    """|gradient of the guidance loss| / |gradient of the imitation loss| by the student's parameters, for each task.

    imitation (B,), guidance (n,) of the first n rows, task (B,). The graph is kept for the training step.
    """
    parameters = [p for p in student.parameters() if p.requires_grad]

    def norm(rows: Tensor) -> float:
        if len(rows) == 0:
            return 0.0
        gradients = torch.autograd.grad(rows.mean(), parameters, retain_graph=True, allow_unused=True)
        return torch.stack([g.norm() for g in gradients if g is not None]).norm().item()

    ratios = []
    for index in range(tasks):
        by_imitation = norm(imitation[task == index])
        by_guidance = norm(guidance[task[: len(guidance)] == index]) if by_imitation > 0 else 0.0
        ratios.append(by_guidance / by_imitation if by_imitation > 0 else 0.0)
    return ratios


def verdict(names: Sequence[str], guidance: Guidance | None, ratios: Sequence[float]) -> dict[str, Any]:
    """For student.json: per task its gate, the mean ratio of gradient norms, and whether that counts as guidance."""
    if guidance is None:
        return {}
    tasks = {
        name: {"gate": gate, "gradient_ratio": ratio, "counts_as_guidance": ratio >= COUNTS_FROM}
        for name, gate, ratio in zip(names, guidance.gates.tolist(), ratios, strict=True)
    }
    return {"counts_from": COUNTS_FROM, "tasks": tasks}
