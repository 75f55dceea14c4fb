"""Critic guidance (Section III-B): L_distill from the aggregate critic, and the gate of each task."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional as F

from acgd.critics.aggregate import AggregateCritic
from acgd.guidance.critic.settings import CriticGuidanceConfig
from acgd.guidance.guidance import Reference
from acgd.nn.losses import over_valid_steps
from acgd.nn.q_ensemble import Critic
from acgd.store.stage import Inputs


@dataclass(frozen=True)
class CriticGuidance:
    """The frozen critics, with gates, step weights and alpha."""

    critic: AggregateCritic
    gates: Tensor
    """(m,) gate_i."""
    weights: Tensor
    """(k,) w_j."""
    alpha: float = 1.0
    fraction: float = 1.0
    """Share of a batch that the critics evaluate."""

    def rows(self, batch: int) -> int:
        """Number of guided windows in a batch of `batch` windows, at least one."""
        return max(1, round(batch * self.fraction))

    def loss(self, proposal: Tensor, reference: Reference) -> Tensor:
        """gate_i L_distill of each window, (n, k, A) -> (n,). Skips the steps after the last one with a weight."""
        steps = slice(int(self.weights.nonzero().max()) + 1)
        gain = self.step_gains(
            proposal[:, steps], reference.states[:, steps], reference.actions[:, steps], reference.task
        )
        return self.gates[reference.task] * distill(gain, reference.mask[:, steps], self.weights[steps])

    def gain(self, proposal: Tensor, reference: Reference) -> Tensor:
        """-L_distill of each window, without the gate, (n, k, A) -> (n,)."""
        gain = self.step_gains(proposal, reference.states, reference.actions, reference.task)
        return -distill(gain, reference.mask, self.weights)

    def step_gains(self, proposal: Tensor, states: Tensor, actions: Tensor, task: Tensor) -> Tensor:
        """(Q_i(s_{t+j}, a_hat_{t+j}) - Q_i(s_{t+j}, a_{t+j})) / spread_i, in float32.

        proposal (n, k, A), states (n, k, S), demonstrated actions (n, k, A), task (n,) -> (n, k).
        """
        n, k = proposal.shape[:2]
        rows = (states, proposal.float(), actions.float())
        with torch.autocast(proposal.device.type, enabled=False):
            return self.critic(*(value.flatten(0, 1) for value in rows), task.repeat_interleave(k)).view(n, k)


def load(settings: CriticGuidanceConfig, inputs: Inputs, *, chunk: int, device: torch.device) -> CriticGuidance:
    """Loads the frozen critics of all tasks, in the study's order. `chunk`: k, steps of a chunk."""
    critics = [Critic.load(folder) for folder in inputs["critic"]]
    return CriticGuidance(
        critic=AggregateCritic(critics, settings.pessimism).to(device),
        gates=gates(settings, inputs).to(device),
        weights=step_weights(settings.guided_steps, chunk, device),
        alpha=settings.alpha,
        fraction=settings.guided_fraction,
    )


def gates(settings: CriticGuidanceConfig, inputs: Inputs) -> Tensor:
    """gate_i -> (m,).

    The gate `reliable` is 0 where the low end of the critic's within-state rank correlation is below `reliable_rank` or
    unknown. All other gates are 1.
    """
    if settings.gate == "one":
        return torch.ones(len(inputs["critic"]))
    lows = rank_intervals(inputs["quality"])
    return torch.tensor([float(low is not None and low >= settings.reliable_rank) for low in lows])


def rank_intervals(qualities: Sequence[Path]) -> list[float | None]:
    """Low end of the interval of each critic's within-state rank correlation; None where no state had a ranking."""
    return [json.loads((Path(folder) / "quality.json").read_text())["within_state"]["low"] for folder in qualities]


def distill(gain: Tensor, mask: Tensor, weights: Tensor) -> Tensor:
    """L_distill = - sum_j m_j w_j (Q_i(s_{t+j}, a_hat_{t+j}) - Q_i(s_{t+j}, a_{t+j})) / spread_i.

    The sum is a weighted mean over valid steps. gain (n, k) in spreads of the row's task, mask (n, k), weights (k,)
    -> (n,). The paper's loss lacks the Q of the demonstrated action a, which is a constant.
    """
    return -over_valid_steps(gain, mask, weights)


def step_weights(guided_steps: str, k: int, device: torch.device) -> Tensor:
    """w_j of L_distill: 1 for every step of the chunk, or for the first step only -> (k,)."""
    if guided_steps == "chunk":
        return torch.ones(k, device=device)
    return F.one_hot(torch.tensor(0, device=device), k).float()
