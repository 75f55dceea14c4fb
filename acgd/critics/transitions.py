"""Steps of the simulator as a critic is fitted on them, and how they are gathered side by side."""

from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file, save_file

from acgd.experts.policy import Expert

ROLLOUT = -1
"""`branch` of a row that is not the first action of a branch."""
INFERENCE_ROWS = 4096


@dataclass(frozen=True)
class Transitions:
    """N rows in E episodes, one after the other. An episode is a rollout, or a branch off one."""

    state: np.ndarray
    """(N, S) float32"""
    action: np.ndarray
    """(N, A) float32, as executed, in [-1, 1]"""
    reward: np.ndarray
    """(N,) float32, the reward that the expert was trained on"""
    next_state: np.ndarray
    """(N, S) float32"""
    next_action: np.ndarray
    """(N, A) float32, pi_E(next_state): the expert is frozen, so it is asked once"""
    terminated: np.ndarray
    """(N,) bool, by the simulator; a time limit is no termination"""
    on_policy: np.ndarray
    """(N,) bool, the action is the expert's own mean"""
    branch: np.ndarray
    """(N,) int64, number of the branched state whose first action this is, or ROLLOUT"""
    ends: np.ndarray
    """(E,) int64, exclusive"""

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
    """The rows of the parts in their order. Only one part may hold branches."""
    offsets = np.cumsum([0] + [len(part) for part in parts[:-1]])
    rows = {
        f.name: np.concatenate([getattr(part, f.name) for part in parts])
        for f in fields(Transitions)
        if f.name != "ends"
    }
    return Transitions(**rows, ends=np.concatenate([part.ends + offset for part, offset in zip(parts, offsets)]))


class Recorder:
    """Takes down episodes that advance side by side, and lays them out one after the other."""

    def __init__(self) -> None:
        self.steps = 0
        self._episodes: list[list[tuple]] = []

    def open(self, count: int) -> int:
        """`count` new episodes; returns the number of the first."""
        self._episodes += [[] for _ in range(count)]
        return len(self._episodes) - count

    def add(
        self, episode: int, state, action, reward, next_state, terminated, on_policy, branch: int = ROLLOUT
    ) -> None:
        """One step of one episode."""
        self._episodes[episode].append((state, action, reward, next_state, terminated, on_policy, branch))
        self.steps += 1

    def transitions(self, expert: Expert) -> Transitions:
        """Every step so far."""
        state, action, reward, next_state, terminated, on_policy, branch = zip(
            *(row for episode in self._episodes for row in episode)
        )
        arrived = np.stack(next_state)
        asked = [expert.mean(arrived[at : at + INFERENCE_ROWS]) for at in range(0, len(arrived), INFERENCE_ROWS)]
        return Transitions(
            state=np.stack(state),
            action=np.stack(action).astype(np.float32),
            reward=np.asarray(reward, np.float32),
            next_state=arrived,
            next_action=np.concatenate(asked),
            terminated=np.asarray(terminated, bool),
            on_policy=np.asarray(on_policy, bool),
            branch=np.asarray(branch, np.int64),
            ends=np.cumsum([len(episode) for episode in self._episodes]).astype(np.int64),
        )
