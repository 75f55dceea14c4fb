"""The policy interface, and policies that wrap or combine other policies.

A policy is stateless. Its memory carries information from step to step: `start` creates the memory, and `act` returns a
new one. A row is one of n episodes in lockstep. No row of a memory depends on another row.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

Observations = dict[str, np.ndarray]
"""Name -> (n, ...): `proprio`, `state` and, where rendered, `image`, stacked over n episodes."""


class Policy(Protocol):
    """An expert, a student, a replay, or a wrapper of other policies."""

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Any:
        """The memory of n new episodes.

        tasks: (n,) int64, task ids. goals: (n, H, W, 3) uint8 goal images, (n, G) float32 commanded goals, or None.
        seeds: n episode seeds.
        """

    def act(self, observations: Observations, memory: Any) -> tuple[np.ndarray, Any]:
        """Actions (n, A) float32 in [-1, 1], and the memory of the next step."""


class StatePolicy(Protocol):
    """The part of an expert that policies use. This folder lies below experts/ and cannot import Expert."""

    def mean(self, state: np.ndarray) -> np.ndarray:
        """(n, S) -> (n, A)."""

    def sample(self, state: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """(n, S) -> (n, A)."""


class Mean:
    """The mean action of an expert."""

    def __init__(self, expert: StatePolicy) -> None:
        self.expert = expert

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> None:
        return None

    def act(self, observations: Observations, memory: None) -> tuple[np.ndarray, None]:
        return self.expert.mean(observations["state"]), None


class Sampled:
    """Actions sampled from the distribution of an expert.

    rng: one stream for all episodes of a batch; the caller seeds it with the episode seeds.
    """

    def __init__(self, expert: StatePolicy, rng: np.random.Generator) -> None:
        self.expert, self.rng = expert, rng

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> None:
        return None

    def act(self, observations: Observations, memory: None) -> tuple[np.ndarray, None]:
        return self.expert.sample(observations["state"], self.rng), None


class Noisy:
    """Actions of `policy` with Gaussian noise of standard deviation `std`, clipped to [-1, 1].

    rng: as in `Sampled`. Both may share one generator.
    """

    def __init__(self, policy: Policy, std: float, rng: np.random.Generator) -> None:
        self.policy, self.std, self.rng = policy, std, rng

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Any:
        return self.policy.start(tasks, goals, seeds)

    def act(self, observations: Observations, memory: Any) -> tuple[np.ndarray, Any]:
        action, memory = self.policy.act(observations, memory)
        action = action + self.std * self.rng.standard_normal(action.shape)
        return np.clip(action, -1.0, 1.0).astype(np.float32), memory


@dataclass(frozen=True)
class Counted:
    """The memory of a policy that depends on the time step."""

    inner: Any
    step: int = 0

    def next(self, inner: Any) -> "Counted":
        return Counted(inner, self.step + 1)


class Offset:
    """Actions of `policy` plus `offsets` (n, T, A), clipped to [-1, 1]."""

    def __init__(self, policy: Policy, offsets: np.ndarray) -> None:
        self.policy, self.offsets = policy, offsets

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Counted:
        return Counted(self.policy.start(tasks, goals, seeds))

    def act(self, observations: Observations, memory: Counted) -> tuple[np.ndarray, Counted]:
        action, inner = self.policy.act(observations, memory.inner)
        return np.clip(action + self.offsets[:, memory.step], -1, 1), memory.next(inner)


class FirstThen:
    """Actions `first` (n, A) in the first step, then those of `policy`, which does not observe the first step."""

    def __init__(self, first: np.ndarray, policy: Policy) -> None:
        self.first, self.policy = first, policy

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Counted:
        return Counted(self.policy.start(tasks, goals, seeds))

    def act(self, observations: Observations, memory: Counted) -> tuple[np.ndarray, Counted]:
        if memory.step == 0:
            return self.first, memory.next(memory.inner)
        action, inner = self.policy.act(observations, memory.inner)
        return action, memory.next(inner)


@dataclass(frozen=True)
class Replaying:
    """The memory of a replay."""

    seeds: list[int]
    chosen: np.ndarray | None = None
    """(n,) index of each row's recording. None before the first step."""
    step: int = 0


class Replay:
    """Open-loop replay of recorded actions. The last action repeats after the end of the recording.

    choose: (first observations, episode seeds) -> n indices of recordings.
    """

    def __init__(
        self, actions: np.ndarray, ends: np.ndarray, choose: Callable[[Observations, list[int]], Sequence[int]]
    ) -> None:
        """actions: (T, A) float32, concatenated recordings. ends: (E,) int64, exclusive end of each recording."""
        self.actions, self.choose = actions, choose
        self.first, self.last = np.concatenate([[0], ends[:-1]]).astype(np.int64), ends - 1

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Replaying:
        return Replaying(seeds)

    def act(self, observations: Observations, memory: Replaying) -> tuple[np.ndarray, Replaying]:
        chosen = memory.chosen
        if chosen is None:
            chosen = np.asarray(self.choose(observations, memory.seeds))
        rows = np.minimum(self.first[chosen] + memory.step, self.last[chosen])
        return self.actions[rows], Replaying(memory.seeds, chosen, memory.step + 1)


@dataclass(frozen=True)
class Mixed:
    """The memory of a mixture."""

    first: Any
    second: Any
    rngs: list[np.random.Generator]
    by_first: np.ndarray
    """(n,) bool: rows whose last action came from the first policy."""


MIXTURE_STREAM = 3
"""Second entropy of the generators of mixtures, which separates them from other generators of the same seed."""


class Mixture:
    """The action of `first` with probability `chance`, else that of `second`, drawn for each row and step.

    Both policies act in every step, so that both memories are complete. With a chance of 0 `first` is not evaluated.
    Each row has its separate generator, seeded with the episode's seed.
    """

    def __init__(self, first: Policy, second: Policy, chance: float) -> None:
        self.first, self.second, self.chance = first, second, chance

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Mixed:
        rngs = [np.random.default_rng([seed, MIXTURE_STREAM]) for seed in seeds]
        first, second = (policy.start(tasks, goals, seeds) for policy in (self.first, self.second))
        return Mixed(first, second, rngs, np.zeros(len(seeds), bool))

    def act(self, observations: Observations, memory: Mixed) -> tuple[np.ndarray, Mixed]:
        action, second = self.second.act(observations, memory.second)
        first, by_first = memory.first, np.zeros(len(action), bool)
        if self.chance > 0:
            first_action, first = self.first.act(observations, memory.first)
            by_first = np.array([rng.random() < self.chance for rng in memory.rngs])
            action = np.where(by_first[:, None], first_action, action)
        return action, Mixed(first, second, memory.rngs, by_first)


class Padded:
    """`policy` evaluated with a fixed number of `rows` rows; the last row is repeated.

    The rounding of a matrix product depends on the number of rows. The padding makes an episode independent of the
    number of episodes in the batch.
    """

    def __init__(self, policy: Policy, rows: int) -> None:
        self.policy, self.rows = policy, rows

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Any:
        goals = None if goals is None else padded(goals, self.rows)
        padded_seeds = padded(np.asarray(seeds, np.int64), self.rows).tolist()
        return self.policy.start(padded(np.asarray(tasks), self.rows), goals, padded_seeds)

    def act(self, observations: Observations, memory: Any) -> tuple[np.ndarray, Any]:
        n = len(next(iter(observations.values())))
        full = {name: padded(value, self.rows) for name, value in observations.items()}
        actions, memory = self.policy.act(full, memory)
        return actions[:n], memory


class Restricted:
    """`policy` with only the named entries of the observations."""

    def __init__(self, policy: Policy, entries: Sequence[str]) -> None:
        self.policy, self.entries = policy, entries

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Any:
        return self.policy.start(tasks, goals, seeds)

    def act(self, observations: Observations, memory: Any) -> tuple[np.ndarray, Any]:
        return self.policy.act({name: observations[name] for name in self.entries}, memory)


class ShuffledImages:
    """`policy` with the image of the next episode of the batch, at the same time step."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Any:
        if len(seeds) < 2:
            raise ValueError(
                "image_features: shuffled has one episode alone in a batch: change evaluation.episodes or "
                "evaluation.lockstep, or leave out start: nominal, from which a Fixed task has one episode"
            )
        return self.policy.start(tasks, goals, seeds)

    def act(self, observations: Observations, memory: Any) -> tuple[np.ndarray, Any]:
        return self.policy.act(observations | {"image": np.roll(observations["image"], -1, axis=0)}, memory)


STUDENT_ENTRIES = ("image", "proprio")
"""Entries of an observation that a student receives. The privileged state is not among them."""


def padded(rows: np.ndarray, size: int) -> np.ndarray:
    """(m, ...) -> (size, ...) by repeating the last row. ValueError where m > size."""
    if len(rows) > size:
        raise ValueError(f"{len(rows)} episodes for a policy of {size} rows: raise its rows or run fewer side by side")
    return np.concatenate([rows, np.repeat(rows[-1:], size - len(rows), axis=0)]) if len(rows) < size else rows
