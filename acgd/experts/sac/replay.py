"""Replay buffer of an off-policy run, in memory-mapped files, so that a resumed run has all transitions."""

from collections import deque
from pathlib import Path

import numpy as np
import torch
from torch import Tensor


class Replay:
    """Transitions over up to n steps, appended to memory-mapped files.

    A row holds s_t (S,), a_t (A,), sum_{j<m} gamma^j r_{t+j}, s_{t+m} (S,) and the discount gamma^m. m is n, or less at
    the end of an episode. The discount is 0 where the task terminated; a time limit is no termination. The first
    `count` rows are valid. A resumed run overwrites the rows after the count of its checkpoint.
    """

    def __init__(
        self, folder: Path, capacity: int, state_dim: int, action_dim: int, n_step: int, gamma: float, envs: int
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._n, self._gamma, self.count = n_step, gamma, 0
        self._open = [deque() for _ in range(envs)]
        shapes = {
            "state": (state_dim,),
            "action": (action_dim,),
            "reward": (),
            "next_state": (state_dim,),
            "discount": (),
        }
        self._arrays = {
            name: self._mapped(folder / f"{name}.f32", (capacity, *shape)) for name, shape in shapes.items()
        }

    @staticmethod
    def _mapped(path: Path, shape: tuple[int, ...]) -> np.ndarray:
        return np.memmap(path, np.float32, "r+" if path.exists() else "w+", shape=shape)

    def add(
        self,
        env: int,
        state: np.ndarray,
        action: np.ndarray,
        reward: float,
        next_state: np.ndarray,
        terminated: bool,
        ended: bool,
    ) -> None:
        """Adds one step of environment number `env`. `ended` closes the episode."""
        steps = self._open[env]
        steps.append((state.copy(), action.copy(), float(reward)))  # callers reuse their arrays
        if ended:
            while steps:
                self._write(steps, next_state, terminated)
        elif len(steps) == self._n:
            self._write(steps, next_state, False)

    def abandon(self) -> None:
        """Drops the steps of unfinished rows. Their episodes are not continued."""
        for steps in self._open:
            steps.clear()

    def _write(self, steps: deque, next_state: np.ndarray, terminated: bool) -> None:
        rewards = sum(self._gamma**j * reward for j, (_, _, reward) in enumerate(steps))
        discount = 0.0 if terminated else self._gamma ** len(steps)
        state, action, _ = steps.popleft()
        for name, value in zip(self._arrays, (state, action, rewards, next_state, discount)):
            self._arrays[name][self.count] = value
        self.count += 1

    def sample(
        self, batch: int, newest: int, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Draws from the `newest` rows with replacement: s (B, S), a (B, A), r (B,), s' (B, S), discount (B,)."""
        rows = np.sort(rng.integers(max(0, self.count - newest), self.count, batch))
        return tuple(torch.from_numpy(array[rows]) for array in self._arrays.values())

    def flush(self) -> None:
        """Writes all rows to the disk."""
        for array in self._arrays.values():
            array.flush()
