"""The interface of guidance, its loader, and the ratio of its gradient to that of imitation."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from acgd.guidance.kinds import GUIDANCE
from acgd.settings import Section, imported
from acgd.store.stage import Inputs

COUNTS_FROM = 0.01
"""Least ratio of gradient norms, guidance over imitation, at which a task counts as guided."""


@dataclass(frozen=True)
class Reference:
    """Data of n windows that guidance reads besides the proposed chunks. Only critics may read the states."""

    states: Tensor
    """(n, k, S) privileged states s_{t+j}, zero-padded to the widest task."""
    actions: Tensor
    """(n, k, A) a_{t+j} of the demonstration."""
    mask: Tensor
    """(n, k) true on steps inside the episode."""
    task: Tensor
    """(n,) long."""


class Guidance(Protocol):
    """A second loss. Its gradient reaches the student through the proposed chunk."""

    alpha: float
    """Weight of the imitation loss relative to the guidance loss."""
    gates: Tensor
    """(m,) factor of each task. 0: the task is not guided."""

    def rows(self, batch: int) -> int:
        """Number of windows, from the first on, that are guided in a batch of `batch` windows; at least one."""

    def loss(self, proposal: Tensor, reference: Reference) -> Tensor:
        """Loss of each window with its gate. proposal (n, k, A), differentiable -> (n,)."""

    def gain(self, proposal: Tensor, reference: Reference) -> Tensor:
        """Advantage of the proposal (n, k, A) over the demonstration, without gates, for validation -> (n,)."""


def load_guidance(settings: Section, inputs: Inputs, *, chunk: int, device: torch.device) -> Guidance | None:
    """Loads the guidance of the settings' kind for chunks of `chunk` steps. Returns None for kind `none`."""
    return imported(GUIDANCE[settings.kind].code)(settings, inputs, chunk=chunk, device=device)


def gradient_ratios(student: nn.Module, imitation: Tensor, guidance: Tensor, task: Tensor, tasks: int) -> list[float]:
    """|gradient of the guidance loss| / |gradient of the imitation loss| in the student's parameters, per task.

    imitation (B,), guidance (n,) of the first n rows, task (B,). The graph is retained for the training step. The ratio
    is 0 for a task without an imitation gradient.
    """
    parameters = [p for p in student.parameters() if p.requires_grad]

    def norm(rows: Tensor) -> float:
        if len(rows) == 0:
            return 0.0
        gradients = torch.autograd.grad(rows.mean(), parameters, retain_graph=True, allow_unused=True)
        return torch.stack([g.norm() for g in gradients if g is not None]).norm().item()

    ratios = []
    for index in range(tasks):
        imitation_norm = norm(imitation[task == index])
        guidance_norm = norm(guidance[task[: len(guidance)] == index]) if imitation_norm > 0 else 0.0
        ratios.append(guidance_norm / imitation_norm if imitation_norm > 0 else 0.0)
    return ratios


def verdict(names: Sequence[str], guidance: Guidance | None, ratios: Sequence[float]) -> dict[str, Any]:
    """Entry of student.json: gate and mean gradient ratio of each task, and whether the ratio counts as guidance."""
    if guidance is None:
        return {}
    tasks = {
        name: {"gate": gate, "gradient_ratio": ratio, "counts_as_guidance": ratio >= COUNTS_FROM}
        for name, gate, ratio in zip(names, guidance.gates.tolist(), ratios, strict=True)
    }
    return {"counts_from": COUNTS_FROM, "tasks": tasks}
