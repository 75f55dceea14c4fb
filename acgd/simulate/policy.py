"""The interface between all that acts and all that runs it, and the policies that are made of others.

A policy keeps nothing between two calls: what it carries from step to step is its memory, which `start` makes and `act`
returns anew. Rows are episodes that run side by side; no row of a memory depends on another row.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

Observations = dict[str, np.ndarray]
"""Entry -> (n, ...): `proprio`, `state` and, where it is drawn, `image`, each stacked over n episodes."""


class Policy(Protocol):
    """What acts: an expert, a student, a recording, or a mixture of them."""

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Any:
        """The memory of n new episodes.

        tasks: (n,) int64, task ids. goals: (n, H, W, 3) uint8 goal images, (n, G) float32 commanded goals, or None.
        seeds: those of the episodes.
        """

    def act(self, observations: Observations, memory: Any) -> tuple[np.ndarray, Any]:
        """Actions (n, A) float32 in [-1, 1], and the memory of the next step."""


class StatePolicy(Protocol):
    """What an expert has to offer. Experts lie above this folder, so that it knows no more of them."""

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
    """Actions drawn from an expert's own distribution.

    `rng` is one stream for all episodes of a batch. Whoever makes the policy seeds it with their seeds.
    """

    def __init__(self, expert: StatePolicy, rng: np.random.Generator) -> None:
        self.expert, self.rng = expert, rng

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> None:
        return None

    def act(self, observations: Observations, memory: None) -> tuple[np.ndarray, None]:
        return self.expert.sample(observations["state"], self.rng), None


class Noisy:
    """Another policy's actions with Gaussian noise of standard deviation `std`, clipped to [-1, 1].

    `rng` as in `Sampled`. Both may share one generator.
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
    """Another policy's actions plus `offsets` (n, T, A), clipped to [-1, 1]."""

    def __init__(self, policy: Policy, offsets: np.ndarray) -> None:
        self.policy, self.offsets = policy, offsets

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Counted:
        return Counted(self.policy.start(tasks, goals, seeds))

    def act(self, observations: Observations, memory: Counted) -> tuple[np.ndarray, Counted]:
        action, inner = self.policy.act(observations, memory.inner)
        return np.clip(action + self.offsets[:, memory.step], -1, 1), memory.next(inner)


class FirstThen:
    """`first` (n, A) in the first step, then another policy, which does not see that step."""

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
    """(n,) the recording of each row. None before the first step."""
    step: int = 0


class Replay:
    """The actions of a recorded episode whatever is observed, and at its end the last of them again.

    `choose` picks a recording for each row from the first observation and the seeds of the episodes.
    """

    def __init__(
        self, actions: np.ndarray, ends: np.ndarray, choose: Callable[[Observations, list[int]], Sequence[int]]
    ) -> None:
        """actions: (T, A) float32 of all recordings, end to end. ends: (E,) int64, exclusive."""
        self.actions, self.choose = actions, choose
        self.first, self.last = np.concatenate([[0], ends[:-1]]).astype(np.int64), ends - 1

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Replaying:
        return Replaying(seeds)

    def act(self, observations: Observations, memory: Replaying) -> tuple[np.ndarray, Replaying]:
        chosen = memory.chosen
        if chosen is None:
            chosen = np.asarray(self.choose(observations, memory.seeds))
        at = np.minimum(self.first[chosen] + memory.step, self.last[chosen])
        return self.actions[at], Replaying(memory.seeds, chosen, memory.step + 1)


@dataclass(frozen=True)
class Mixed:
    """The memory of a mixture."""

    first: Any
    second: Any
    rngs: list[np.random.Generator]
    by_first: np.ndarray
    """(n,) bool: rows whose last action is that of the first policy."""


MIXTURE_STREAM = 3
"""Tells the generators of mixtures apart from others that the same episode seed makes."""


class Mixture:
    """In each row and step the action of `first` with probability `chance`, else that of `second`.

    Both are given every step, so that the memory of either is complete. With a chance of 0 `first` is not computed.
    Each row draws from a generator of its own, seeded with the episode's seed.
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
            wanted, first = self.first.act(observations, memory.first)
            by_first = np.array([rng.random() < self.chance for rng in memory.rngs])
            action = np.where(by_first[:, None], wanted, action)
        return action, Mixed(first, second, memory.rngs, by_first)


class Padded:
    """Another policy computed for always `rows` rows, the last one repeated.

    A matrix product may round differently for another number of rows. With this an episode does not depend on how many
    episodes run beside it.
    """

    def __init__(self, policy: Policy, rows: int) -> None:
        self.policy, self.rows = policy, rows

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Any:
        goals = None if goals is None else padded(goals, self.rows)
        every = padded(np.asarray(seeds, np.int64), self.rows).tolist()
        return self.policy.start(padded(np.asarray(tasks), self.rows), goals, every)

    def act(self, observations: Observations, memory: Any) -> tuple[np.ndarray, Any]:
        n = len(next(iter(observations.values())))
        full = {name: padded(value, self.rows) for name, value in observations.items()}
        actions, memory = self.policy.act(full, memory)
        return actions[:n], memory


class Restricted:
    """Another policy that is given only the named entries of an observation."""

    def __init__(self, policy: Policy, entries: Sequence[str]) -> None:
        self.policy, self.entries = policy, entries

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Any:
        return self.policy.start(tasks, goals, seeds)

    def act(self, observations: Observations, memory: Any) -> tuple[np.ndarray, Any]:
        return self.policy.act({name: observations[name] for name in self.entries}, memory)


class ShuffledImages:
    """Another policy that is given the image of the next episode of the batch, at the same time step."""

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
"""What a student is given of an observation: never the privileged state."""


def padded(rows: np.ndarray, size: int) -> np.ndarray:
    """(m, ...) -> (size, ...), the last row repeated. ValueError where there are more than `size`."""
    if len(rows) > size:
        raise ValueError(f"{len(rows)} episodes for a policy of {size} rows: raise its rows or run fewer side by side")
    return np.concatenate([rows, np.repeat(rows[-1:], size - len(rows), axis=0)]) if len(rows) < size else rows
