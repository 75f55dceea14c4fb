"""Rollouts of the frozen expert, clean and perturbed, failures kept, and branches off the states that they pass."""

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
"""Sources of candidate actions, in turn, after the expert's mean: its own sample, noise around the mean, anywhere."""


@dataclass(frozen=True)
class Visit:
    """A state that a rollout passed, to come back to."""

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
    beyond: int = 0,
    episodes: int | None = None,
    steps: int | None = None,
    visit_rate: float = 0.0,
    seed: int = 0,
    bar: Bar,
) -> tuple[Transitions, list[Visit], list[Kind]]:
    """Follows the expert's mean plus each episode's perturbation for `limit` steps, or until the simulator terminates.

    Clean episodes go on for `beyond` more steps, for the tails of their returns. Gathers `episodes`, or as many as make
    `steps` simulator steps. A step before `limit` becomes a `Visit` with probability `visit_rate`, the first one in any
    case. Chance depends on `seed` and the number of the episode alone. Returns the kinds by episode.
    """
    for env in lock.envs:
        env.ignore_time_limit = True  # `limit` ends an episode here
    log, visits, given, kind = TransitionLog(), [], [], kinds(perturbation)
    action_dim = lock.envs[0].action_space.shape[0]
    while len(given) < episodes if episodes is not None else log.steps < steps:
        count = len(lock.envs) if episodes is None else min(len(lock.envs), episodes - len(given))
        first, before = len(given), log.steps
        new = [next(kind) for _ in range(count)]
        given += new
        rngs = [np.random.default_rng([seed, episode]) for episode in range(first, first + count)]
        noise = np.stack([offsets(k, limit + beyond, action_dim, perturbation, rng) for k, rng in zip(new, rngs)])
        visited = np.stack([(rng.random(limit) < visit_rate) | (np.arange(limit) == 0) for rng in rngs])
        keeper = VisitRecorder(first, new, visited)
        roll(
            lock,
            Offset(Mean(expert), noise),
            seeds.take(count, offset=first),
            limits=np.array([limit + beyond * (name == "clean") for name, _ in new]),
            recorders=[keeper, log.batch(on_policy=~noise.any(-1))],
        )
        visits += keeper.visits
        bar.update(log.steps - before)
    return log.transitions(expert), visits, given


class VisitRecorder(Recorder):
    """Keeps the states of one batch that are to be visited again."""

    def __init__(self, first: int, kinds: list[Kind], visited: np.ndarray) -> None:
        """first: number of the batch's first episode. visited: (n, T) bool, which steps' states are kept."""
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
    """V * K episodes of `steps`: from each of V visited states each of K first actions, then the expert's mean.

    actions: (V, K, A). Episodes lie state by state, action by action; the first row of each carries the number of its
    state. Time limits are ignored; termination is not.
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
            range(at, at + count),  # nothing here draws from them
            snapshots=[visits[v].snapshot for v in state_of[batch]],
            limits=np.full(count, steps),
            recorders=[log.batch(on_policy, state_of[batch])],
        )
        bar.update(log.steps - before)
    return log.transitions(expert)


def candidates(expert: Expert, state: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, list[str]]:
    """Candidate actions in each of V states (V, S), and their sources.

    The actions are (V, count, A) in [-1, 1], the expert's mean first.
    """
    mean = expert.mean(state)
    tried, names = [mean], ["mean"]
    for k in range(count - 1):
        name, scale = CANDIDATES[k % len(CANDIDATES)]
        if name == "sample":
            action = expert.sample(state, rng)
        elif name == "gaussian":
            action = np.clip(mean + scale * rng.standard_normal(mean.shape), -1, 1)
        else:
            action = rng.uniform(-1, 1, mean.shape)
        tried.append(action.astype(np.float32))
        names.append(f"{name} {scale:g}" if scale else name)
    return np.stack(tried, 1), names
