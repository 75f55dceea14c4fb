"""Critic guidance (Section III-B): the aggregate critic's judgement of the student's actions, its gates, and how much it weighs."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from acgd.critics.aggregate import AggregateCritic
from acgd.students import losses
from acgd.students.settings import StudentConfig

COUNTS = 0.01
"""Below this ratio of gradient norms, L_distill over L_BC, a task counts as not guided."""


@dataclass(frozen=True)
class Guidance:
    """The frozen critics with what scales them."""

    critic: AggregateCritic
    gates: Tensor
    """(m,) per task."""
    weights: Tensor
    """(k,) w_j."""

    def gain(self, states: Tensor, chunk: Tensor, demonstrated: Tensor, task: Tensor) -> Tensor:
        """(Q_i(s_{t+j}, a_hat_{t+j}) - Q_i(s_{t+j}, a_{t+j})) / spread_i, in full precision.

        states (B, k, S), chunks of actions (B, k, A), task (B,) -> (B, k).
        """
        b, k = chunk.shape[:2]
        rows = (states, chunk.float(), demonstrated.float())
        with torch.autocast(chunk.device.type, enabled=False):
            return self.critic(*(value.flatten(0, 1) for value in rows), task.repeat_interleave(k)).view(b, k)

    def loss(self, states: Tensor, chunk: Tensor, demonstrated: Tensor, mask: Tensor, task: Tensor) -> Tensor:
        """gate_i L_distill of each row -> (B,). Steps that weigh nothing are not judged."""
        judged = slice(int(self.weights.nonzero().max()) + 1)
        gain = self.gain(states[:, judged], chunk[:, judged], demonstrated[:, judged], task)
        return self.gates[task] * losses.distill(gain, mask[:, judged], self.weights[judged])


def gates(config: StudentConfig, critics: Sequence[Path], device: torch.device) -> Tensor:
    """gate_i: one for all, or zero where the interval of the critic's within-state rank correlation reaches too low -> (m,)."""
    if config.gate == "one":
        return torch.ones(len(critics), device=device)
    lows = [json.loads((Path(directory) / "quality.json").read_text())["within_state"]["low"] for directory in critics]
    return torch.tensor([float(low is not None and low >= config.reliable_rank) for low in lows], device=device)


def ratio_by_task(student: nn.Module, bc: Tensor, distill: Tensor, task: Tensor, tasks: int) -> list[float]:
    """|gradient of gate_i L_distill| / |gradient of alpha L_BC| over the student's parameters, for each task's rows.

    bc (B,), distill (n,) of the first n rows, task (B,). The graph is kept for the training step.
    """
    parameters = [p for p in student.parameters() if p.requires_grad]

    def norm(rows: Tensor) -> float:
        if len(rows) == 0:
            return 0.0
        found = torch.autograd.grad(rows.mean(), parameters, retain_graph=True, allow_unused=True)
        return torch.stack([g.norm() for g in found if g is not None]).norm().item()

    ratios = []
    for index in range(tasks):
        imitation = norm(bc[task == index])
        ratios.append(norm(distill[task[: len(distill)] == index]) / imitation if imitation > 0 else 0.0)
    return ratios


def verdict(names: Sequence[str], guidance: Guidance | None, tally: dict[str, float]) -> dict[str, Any]:
    """For student.json: per task, the gate used, the mean ratio of gradient norms, and whether that counts as guidance."""
    if guidance is None:
        return {}
    ratios = {name: tally.get(name, 0.0) / max(1, tally.get("rows", 0)) for name in names}
    return {
        name: {"gate": gate, "gradient_ratio": ratios[name], "counts_as_guidance": ratios[name] >= COUNTS}
        for name, gate in zip(names, guidance.gates.tolist())
    }
