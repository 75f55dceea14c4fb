"""Rollouts of the frozen expert, clean and perturbed, with failures kept, and branches from the visited states."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acgd.critics.perturbations import Kind, kinds, offsets
from acgd.critics.settings import PerturbationConfig
from acgd.critics.transitions import TransitionLog, Transitions
from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.policy import FirstThen, Mean, Offset
from acgd.simulate.roll import Recorder, Step, roll
from acgd.simulate.seeds import SeedRange
from acgd.store.progress import Bar
from acgd.tasks.snapshot import Snapshot

CANDIDATES = (("sample", 0.0), ("gaussian", 0.1), ("gaussian", 0.2), ("gaussian", 0.4), ("uniform", 0.0))
"""Sources of candidate actions after the expert's mean, in turn, and their standard deviations."""


@dataclass(frozen=True)
class Visit:
    """A state of a rollout that branches can start from."""

    episode: int
    kind: Kind
    """How the episode was perturbed."""
    state: np.ndarray
    """(S,) float32"""
    snapshot: Snapshot


def rollouts(
    lock: Lockstep,
    expert: Expert,
    perturbation: PerturbationConfig,
    seeds: SeedRange,
    *,
    limit: int,
    extra_steps: int = 0,
    episodes: int | None = None,
    steps: int | None = None,
    visit_rate: float = 0.0,
    seed: int = 0,
    bar: Bar,
) -> tuple[Transitions, list[Visit], list[Kind]]:
    """Follows the expert's mean plus each episode's perturbation for `limit` steps, or until the simulator terminates.

    Clean episodes have `extra_steps` more steps, for the tails of their returns. The function runs `episodes` episodes,
    or as many as give `steps` simulator steps. A step before `limit` becomes a `Visit` with probability `visit_rate`;
    the first step of an episode always does. Random numbers depend on `seed` and the number of the episode alone.
    Returns transitions, visits, and the perturbation of each episode.
    """
    for env in lock.envs:
        env.ignore_time_limit = True  # `roll` ends an episode at its limit
    log, visits, episode_kinds, kind_iterator = TransitionLog(), [], [], kinds(perturbation)
    action_dim = lock.envs[0].action_space.shape[0]
    while len(episode_kinds) < episodes if episodes is not None else log.steps < steps:
        count = len(lock.envs) if episodes is None else min(len(lock.envs), episodes - len(episode_kinds))
        first, before = len(episode_kinds), log.steps
        batch_kinds = [next(kind_iterator) for _ in range(count)]
        episode_kinds += batch_kinds
        rngs = [np.random.default_rng([seed, episode]) for episode in range(first, first + count)]
        noise = np.stack(
            [offsets(k, limit + extra_steps, action_dim, perturbation, rng) for k, rng in zip(batch_kinds, rngs)]
        )
        visited = np.stack([(rng.random(limit) < visit_rate) | (np.arange(limit) == 0) for rng in rngs])
        visit_recorder = VisitRecorder(first, batch_kinds, visited)
        roll(
            lock,
            Offset(Mean(expert), noise),
            seeds.take(count, offset=first),
            limits=np.array([limit + extra_steps * (name == "clean") for name, _ in batch_kinds]),
            recorders=[visit_recorder, log.batch(on_policy=~noise.any(-1))],
        )
        visits += visit_recorder.visits
        bar.update(log.steps - before)
    return log.transitions(expert), visits, episode_kinds


class VisitRecorder(Recorder):
    """Keeps the chosen states of one batch of episodes."""

    def __init__(self, first: int, kinds: list[Kind], visited: np.ndarray) -> None:
        """first: number of the batch's first episode. visited: (n, T) bool, the steps whose states are kept."""
        self.first, self.kinds, self.visited = first, kinds, visited
        self.visits: list[Visit] = []

    def before(self, lock: Lockstep, step: Step) -> None:
        if step.number >= self.visited.shape[1]:
            return
        state = step.observations["state"]
        self.visits += [
            Visit(self.first + i, self.kinds[i], state[i], lock.envs[i].snapshot())
            for i in step.running
            if self.visited[i, step.number]
        ]


def branches(
    lock: Lockstep, expert: Expert, visits: Sequence[Visit], actions: np.ndarray, steps: int, bar: Bar
) -> Transitions:
    """V * K episodes of `steps` steps: each of K first actions from each of V states, then the expert's mean.

    actions: (V, K, A). Episodes are ordered by state, then by action. The first row of each episode holds the number of
    its state in `branch`. Episodes ignore the time limit, and end where the simulator terminates.
    """
    for env in lock.envs:
        env.ignore_time_limit = True
    log = TransitionLog()
    state_of = np.repeat(np.arange(actions.shape[0]), actions.shape[1])
    first = actions.reshape(-1, actions.shape[-1])
    for at in range(0, len(first), len(lock.envs)):
        batch, before = slice(at, at + len(lock.envs)), log.steps
        count = len(first[batch])
        on_policy = np.broadcast_to(np.arange(steps) > 0, (count, steps))
        roll(
            lock,
            FirstThen(first[batch], Mean(expert)),
            range(at, at + count),  # neither policy draws from the seeds
            snapshots=[visits[v].snapshot for v in state_of[batch]],
            limits=np.full(count, steps),
            recorders=[log.batch(on_policy, state_of[batch])],
        )
        bar.update(log.steps - before)
    return log.transitions(expert)


def candidates(expert: Expert, state: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, list[str]]:
    """Candidate actions (V, count, A) in [-1, 1] for states (V, S), and the `count` names of their sources.

    The first candidate is the expert's mean.
    """
    mean = expert.mean(state)
    actions, sources = [mean], ["mean"]
    for k in range(count - 1):
        name, scale = CANDIDATES[k % len(CANDIDATES)]
        if name == "sample":
            action = expert.sample(state, rng)
        elif name == "gaussian":
            action = np.clip(mean + scale * rng.standard_normal(mean.shape), -1, 1)
        else:
            action = rng.uniform(-1, 1, mean.shape)
        actions.append(action.astype(np.float32))
        sources.append(f"{name} {scale:g}" if scale else name)
    return np.stack(actions, 1), sources
