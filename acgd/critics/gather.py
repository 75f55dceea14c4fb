"""What the frozen expert meets: rollouts, clean and perturbed, failures kept, and branches off the states they pass."""

from collections.abc import Sequence
from dataclasses import dataclass

import gymnasium
import numpy as np

from acgd.critics.perturbations import Kind, kinds, offsets
from acgd.critics.settings import PerturbationConfig
from acgd.critics.transitions import ROLLOUT, Recorder, Transitions
from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.seeds import SeedRange
from acgd.store.progress import Bar
from acgd.tasks.snapshot import Snapshot

CANDIDATES = (("sample", 0.0), ("gaussian", 0.1), ("gaussian", 0.2), ("gaussian", 0.4), ("uniform", 0.0))
"""Where an action to try comes from, in turn, after the expert's mean: its own sample, noise around the mean, anywhere."""


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
    recorder, visits, given, kind = Recorder(), [], [], kinds(perturbation)
    action_dim = lock.envs[0].action_space.shape[0]
    while len(given) < episodes if episodes is not None else recorder.steps < steps:
        count = len(lock.envs) if episodes is None else min(len(lock.envs), episodes - len(given))
        first, before = recorder.open(count), recorder.steps
        given += [next(kind) for _ in range(count)]
        rngs = [np.random.default_rng([seed, episode]) for episode in range(first, first + count)]
        noise = np.stack(
            [offsets(k, limit + beyond, action_dim, perturbation, rng) for k, rng in zip(given[first:], rngs)]
        )
        visited = np.stack([(rng.random(limit) < visit_rate) | (np.arange(limit) == 0) for rng in rngs])
        limits = np.array([limit + beyond * (name == "clean") for name, _ in given[first:]])
        state = lock.reset(seeds.take(count, offset=first))["state"]
        for t in range(limits.max()):
            lock.active &= t < limits
            active = np.flatnonzero(lock.active)
            if not len(active):
                break
            if t < limit:
                visits += [
                    Visit(first + i, given[first + i], state[i], lock.envs[i].snapshot())
                    for i in active
                    if visited[i, t]
                ]
            action = np.clip(expert.mean(state) + noise[:, t], -1, 1)
            obs, reward, _, _ = lock.step(action)
            for i in active:
                followed = not noise[i, t].any()
                recorder.add(first + i, state[i], action[i], reward[i], obs["state"][i], lock.terminated[i], followed)
            state = obs["state"]
        bar.update(recorder.steps - before)
    return recorder.transitions(expert), visits, given


def branches(
    envs: Sequence[gymnasium.Env],
    expert: Expert,
    visits: Sequence[Visit],
    actions: np.ndarray,
    steps: int,
    bar: Bar,
) -> Transitions:
    """From each of V visited states, each of K first actions (V, K, A), then the expert's mean: V * K episodes of `steps`.

    Episodes lie state by state, action by action; the first row of each carries the number of its state.
    Time limits are ignored; termination is not.
    """
    recorder = Recorder()
    jobs = [(v, k) for v in range(actions.shape[0]) for k in range(actions.shape[1])]
    recorder.open(len(jobs))
    for env in envs:
        env.ignore_time_limit = True
    for at in range(0, len(jobs), len(envs)):
        wave, before = jobs[at : at + len(envs)], recorder.steps
        for env, (v, _) in zip(envs, wave):
            env.restore(visits[v].snapshot)
        states = [visits[v].state for v, _ in wave]
        active = list(range(len(wave)))
        for t in range(steps):
            action = actions[tuple(np.transpose(wave))] if t == 0 else expert.mean(np.stack(states))
            for i in list(active):
                obs, reward, terminated, _, _ = envs[i].step(action[i])
                recorder.add(
                    at + i,
                    states[i],
                    action[i],
                    reward,
                    obs["state"],
                    terminated,
                    t > 0,
                    wave[i][0] if t == 0 else ROLLOUT,
                )
                states[i] = obs["state"]
                if terminated:
                    active.remove(i)
            if not active:
                break
        bar.update(recorder.steps - before)
    return recorder.transitions(expert)


def candidates(expert: Expert, state: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, list[str]]:
    """Actions to try in each of V states (V, S): (V, count, A) in [-1, 1], the expert's mean first; and what each is."""
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
