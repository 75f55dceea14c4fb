"""Targets of fitted Q evaluation: summed rewards of the steps that follow the expert, then a bootstrap."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor


@dataclass(frozen=True)
class Targets:
    """y_t = reward_sum_t + discount_t Q_target(s', pi_E(s')). s' is the state after row `bootstrap_t`."""

    reward_sum: Tensor
    """(N,) sum over j < m_t of gamma^j r_{t+j}, in reward units."""
    discount: Tensor
    """(N,) gamma^{m_t}; 0 where the simulator terminated within the m_t steps."""
    bootstrap: Tensor
    """(N,) long: row t + m_t - 1. The target bootstraps from its next state."""

    def __call__(self, next_value: Tensor) -> Tensor:
        """next_value (M, N), Q_target(s', pi_E(s')) of every row's next state -> y (M, N)."""
        return self.reward_sum + self.discount * next_value[:, self.bootstrap]


def targets(
    reward: np.ndarray, terminated: np.ndarray, on_policy: np.ndarray, ends: np.ndarray, gamma: float, horizon: int
) -> Targets:
    """Sums rewards over m_t steps: row t, and the rows directly after it that follow the expert, at most `horizon`.

    reward, terminated, on_policy: (N,). on_policy rows executed the expert's mean action. ends: (E,) exclusive ends of
    the episodes. A time limit is no termination. Derivation: docs/method.md, "Targets".
    """
    steps = _steps_followed(on_policy, ends, horizon)
    rows = np.arange(len(reward))
    reward_sum = np.zeros(len(reward), np.float64)
    for j in range(int(steps.max(initial=0))):
        within = rows[steps > j]
        reward_sum[within] += gamma**j * reward[within + j]
    bootstrap = rows + steps - 1
    discount = gamma ** steps.astype(np.float64) * ~terminated[bootstrap]
    return Targets(
        torch.from_numpy(reward_sum.astype(np.float32)),
        torch.from_numpy(discount.astype(np.float32)),
        torch.from_numpy(bootstrap),
    )


def _steps_followed(on_policy: np.ndarray, ends: np.ndarray, horizon: int) -> np.ndarray:
    """m_t (N,) int64: 1 plus the number of on-policy rows directly after row t in its episode, at most `horizon`."""
    steps = np.ones(len(on_policy), np.int64)
    last = np.zeros(len(on_policy), bool)
    last[np.asarray(ends) - 1] = True
    for t in range(len(steps) - 2, -1, -1):
        if not last[t] and on_policy[t + 1]:
            steps[t] = min(steps[t + 1] + 1, horizon)
    return steps
