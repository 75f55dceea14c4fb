"""The one function that runs a policy in the simulator, and what listens to it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from acgd.simulate.lockstep import Lockstep
from acgd.simulate.policy import Observations, Policy
from acgd.tasks.snapshot import Snapshot

Goals = np.ndarray | Callable[[Lockstep], np.ndarray] | None
"""As `Policy.start` takes them; or how to read them from episodes that have begun, as `Lockstep.goal_vectors` does."""


@dataclass
class Step:
    """One step of a batch of n episodes. Rows of episodes that ended before hold nothing new."""

    number: int
    """0 for the first."""
    running: np.ndarray
    """(k,) the rows that take this step."""
    observations: Observations
    """Before the action."""
    actions: np.ndarray
    """(n, A) float32"""
    memory: Any
    """The policy's, after it has acted."""
    arrived: Observations = field(default_factory=dict)
    """Observations after the action. This and what follows is filled when the step has been taken."""
    reward: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(n,) float64"""
    done: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))
    """(n,) episodes that end with this step, by the simulator or by their limit."""
    infos: list[dict] = field(default_factory=list)
    """The last info of each episode."""


class Recorder:
    """Listens to one batch of episodes. A recorder overrides what it needs."""

    def start(self, lock: Lockstep, seeds: Sequence[int]) -> None:
        """The episodes are at their first observation."""

    def before(self, lock: Lockstep, step: Step) -> None:
        """The policy has chosen its actions; nothing has moved."""

    def after(self, lock: Lockstep, step: Step) -> None:
        """The step has been taken."""


def roll(
    lock: Lockstep,
    policy: Policy,
    seeds: Sequence[int],
    *,
    snapshots: Sequence[Snapshot] | None = None,
    task: int = 0,
    goals: Goals = None,
    limits: np.ndarray | None = None,
    recorders: Sequence[Recorder] = (),
) -> None:
    """Runs one episode per seed, side by side, until the last of them has ended.

    snapshots: where the episodes go on from; the seeds are then for the policy alone. task: the task's id, as the
    policy counts. limits: (n,) steps, 1 or more, after which an episode ends.
    """
    observations = lock.reset(seeds) if snapshots is None else lock.restore(snapshots)
    memory = policy.start(np.full(len(seeds), task), goals(lock) if callable(goals) else goals, list(seeds))
    for recorder in recorders:
        recorder.start(lock, seeds)
    number = 0
    while lock.active.any():
        running = np.flatnonzero(lock.active)
        actions, memory = policy.act(observations, memory)
        step = Step(number, running, observations, np.asarray(actions, np.float32), memory)
        for recorder in recorders:
            recorder.before(lock, step)
        observations, step.reward, step.done, step.infos = lock.step(step.actions)
        step.arrived = observations
        number += 1
        if limits is not None:
            step.done |= lock.active & (number >= limits)
            lock.active = lock.active & (number < limits)
        for recorder in recorders:
            recorder.after(lock, step)
