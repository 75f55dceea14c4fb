"""Transitions for the fit of a critic, and their recorder."""

from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file, save_file

from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.roll import Recorder, Step

ROLLOUT = -1
"""Value of `branch` in rows that are not the first action of a branch."""
INFERENCE_ROWS = 4096
"""Rows of one forward pass of the expert."""


@dataclass(frozen=True)
class Transitions:
    """N rows in E consecutive episodes. An episode is a rollout or a branch."""

    state: np.ndarray
    """(N, S) float32"""
    action: np.ndarray
    """(N, A) float32, as executed, in [-1, 1]"""
    reward: np.ndarray
    """(N,) float32, the reward that the expert was trained on"""
    next_state: np.ndarray
    """(N, S) float32"""
    next_action: np.ndarray
    """(N, A) float32, pi_E(next_state) of the frozen expert"""
    terminated: np.ndarray
    """(N,) bool, terminated by the simulator; a time limit is no termination"""
    on_policy: np.ndarray
    """(N,) bool, the action is the expert's mean"""
    branch: np.ndarray
    """(N,) int64, number of the branched state in the row of a branch's first action, else ROLLOUT"""
    ends: np.ndarray
    """(E,) int64, exclusive end of each episode"""

    def __len__(self) -> int:
        return len(self.reward)

    @property
    def starts(self) -> np.ndarray:
        """(E,) first row of each episode."""
        return np.concatenate([[0], self.ends[:-1]])

    def save(self, path: Path) -> None:
        save_file({name: np.ascontiguousarray(value) for name, value in asdict(self).items()}, path)

    @classmethod
    def load(cls, path: Path) -> "Transitions":
        return cls(**load_file(path))


def concatenate(parts: list[Transitions]) -> Transitions:
    """The rows of all parts, in order. At most one part may hold branches."""
    offsets = np.cumsum([0] + [len(part) for part in parts[:-1]])
    rows = {
        f.name: np.concatenate([getattr(part, f.name) for part in parts])
        for f in fields(Transitions)
        if f.name != "ends"
    }
    return Transitions(**rows, ends=np.concatenate([part.ends + offset for part, offset in zip(parts, offsets)]))


class TransitionLog:
    """Collects batches of episodes step by step, and joins them into transitions."""

    def __init__(self) -> None:
        self.steps = 0
        self._episodes: list[list[tuple]] = []

    def batch(self, on_policy: np.ndarray, branch: np.ndarray | None = None) -> "BatchRecorder":
        """A recorder for the next batch of n episodes.

        on_policy: (n, T) bool, steps whose action is the expert's mean. branch: (n,) numbers of the states that the
        episodes branch from; None for rollouts.
        """
        rows: list[list[tuple]] = [[] for _ in on_policy]
        self._episodes += rows
        return BatchRecorder(self, rows, on_policy, branch)

    def transitions(self, expert: Expert) -> Transitions:
        """All recorded steps, with the expert's action in each next state."""
        state, action, reward, next_state, terminated, on_policy, branch = zip(
            *(row for episode in self._episodes for row in episode)
        )
        next_states = np.stack(next_state)
        means = [
            expert.mean(next_states[at : at + INFERENCE_ROWS]) for at in range(0, len(next_states), INFERENCE_ROWS)
        ]
        return Transitions(
            state=np.stack(state),
            action=np.stack(action).astype(np.float32),
            reward=np.asarray(reward, np.float32),
            next_state=next_states,
            next_action=np.concatenate(means),
            terminated=np.asarray(terminated, bool),
            on_policy=np.asarray(on_policy, bool),
            branch=np.asarray(branch, np.int64),
            ends=np.cumsum([len(episode) for episode in self._episodes]).astype(np.int64),
        )


class BatchRecorder(Recorder):
    """Records the steps of one batch into a log."""

    def __init__(
        self, log: TransitionLog, rows: list[list[tuple]], on_policy: np.ndarray, branch: np.ndarray | None
    ) -> None:
        self.log, self.rows, self.on_policy, self.branch = log, rows, on_policy, branch

    def after(self, lock: Lockstep, step: Step) -> None:
        state, next_state = step.observations["state"], step.next_observations["state"]
        for i in step.running:
            branch = self.branch[i] if self.branch is not None and step.number == 0 else ROLLOUT
            on_policy = self.on_policy[i, step.number]
            row = (state[i], step.actions[i], step.reward[i], next_state[i], lock.terminated[i], on_policy, branch)
            self.rows[i].append(row)
        self.log.steps += len(step.running)
