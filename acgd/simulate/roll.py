"""The function that runs a policy in the simulator, and the interface of recorders."""

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
    """One step of a batch of n episodes. Rows of episodes that have ended repeat their last values."""

    number: int
    """Number of the step, from 0."""
    running: np.ndarray
    """(k,) rows of the episodes that execute this step."""
    observations: Observations
    """Observations before the action."""
    actions: np.ndarray
    """(n, A) float32"""
    memory: Any
    """Memory of the policy after `act`."""
    next_observations: Observations = field(default_factory=dict)
    """Observations after the action. This field and the next ones are set after the step is executed."""
    reward: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(n,) float64"""
    done: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))
    """(n,) bool, episodes that end with this step, by the simulator or by their limit."""
    infos: list[dict] = field(default_factory=list)
    """n last infos of the environments."""


class Recorder:
    """Records one batch of episodes. A recorder overrides the methods that it needs."""

    def start(self, lock: Lockstep, seeds: Sequence[int]) -> None:
        """Called at the first observation of the episodes."""

    def before(self, lock: Lockstep, step: Step) -> None:
        """Called when the policy has chosen its actions, before the step is executed."""

    def after(self, lock: Lockstep, step: Step) -> None:
        """Called after the step is executed."""


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
    """Runs one episode per seed in lockstep, until the last episode has ended.

    snapshots: states that the episodes start from; the seeds then serve the policy alone. task: the policy's task id.
    limits: (n,) steps, at least 1, after which an episode ends.
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
        step.next_observations = observations
        number += 1
        if limits is not None:
            step.done |= lock.active & (number >= limits)
            lock.active = lock.active & (number < limits)
        for recorder in recorders:
            recorder.after(lock, step)
