"""Soft actor-critic on the privileged state: one task, one core, checkpoints and a learning curve.

SAC serves tasks on which PPO needs tens of millions of steps. It has LayerNorm critics, n-step returns, few updates per
step, and exploration noise that is held for a random number of steps, because muscles respond slowly. The run consists
of segments. Each segment restarts all episodes with seeds that depend on the step alone, so that a resumed run equals
an uninterrupted one.

This file does not use simulate/roll.py: a segment counts steps, its episodes restart at once, and updates run between
steps.
"""

from pathlib import Path

import numpy as np
import torch

from acgd.experts import zoo
from acgd.experts.curve import Curve
from acgd.experts.muscle.control import MuscleControl
from acgd.experts.policy import WARM_START_STATES, Expert
from acgd.experts.sac.replay import Replay
from acgd.experts.sac.settings import SACSettings
from acgd.experts.sac.update import SACUpdate
from acgd.experts.settings import ExpertRequest
from acgd.experts.training_env import StateOnly
from acgd.nn.q_ensemble import Critic
from acgd.store import checkpoint

SEGMENT = 10_000
"""Environment steps between restarts of all episodes."""
TEACHER_NOISE = 0.3
"""Standard deviation of the noise on the muscle controller's actions."""
LONGEST_HOLD = 16
"""Largest number of steps that exploration noise is held."""


def train_sac(
    request: ExpertRequest, state: Path, metrics, progress, device: torch.device = torch.device("cpu")
) -> tuple[Path, list[dict]]:
    """Trains on `device`, or resumes from the checkpoint in `state`.

    Returns the folder of the best expert and its critics, and the learning curve. The best expert is chosen by (final
    success, return) on validation seeds.
    """
    sac: SACSettings = request.expert
    envs = [StateOnly(request, i) for i in range(sac.envs)]
    teachers = [MuscleControl(env.unwrapped, sac.muscle) for env in envs] if sac.muscle else []
    state_dim, action_dim = envs[0].observation_space.shape[0], envs[0].action_space.shape[0]
    learner = SACUpdate(state_dim, action_dim, sac, torch.Generator().manual_seed(sac.seed), device)
    replay = Replay(state / "replay", sac.steps, state_dim, action_dim, sac.n_step, sac.gamma, sac.envs)
    statistics = _Statistics(state_dim)
    curve = Curve(request, state, metrics, [])
    done = _load(state, learner, replay, statistics, curve)
    if sac.warm_start_task and not done:
        first = zoo.folder(sac.warm_start_task)
        learner.start_from(Expert.load(first), Critic.load(first))
        statistics.start_from(learner.critic)
    metrics.rewind(done)
    meta = {"task": request.task.name, "gamma": sac.gamma, "reward_weights": sac.reward_weights, "algorithm": sac.kind}
    learner.critic.meta = {key: meta[key] for key in ("task", "gamma", "reward_weights")}
    due = sac.checkpoint_every
    with progress(sac.steps, f"expert {request.task.name}", done=done) as bar:
        while done < sac.steps:
            before = done
            done = min(before - before % SEGMENT + SEGMENT, sac.steps)
            _segment(envs, teachers, learner, replay, statistics, sac, before, done)
            values = {}
            if done // sac.evaluate_every > before // sac.evaluate_every or done >= sac.steps:
                temperature = float(learner.log_temperature.detach().exp())
                point = curve.add(_export(learner, meta), done, learner.critic, temperature=temperature)
                values = {"final": point["final"], "ret": point["return"]}
            bar.update(done - before, **values)
            due -= done - before
            if due <= 0 or done >= sac.steps:
                due = sac.checkpoint_every
                metrics.flush()
                replay.flush()
                _save(state, learner, replay, statistics, curve, done)
    return state / "best", curve.points


def _segment(
    envs: list[StateOnly],
    teachers: list[MuscleControl],
    learner: SACUpdate,
    replay: Replay,
    statistics: "_Statistics",
    sac: SACSettings,
    first: int,
    last: int,
) -> None:
    """Acts and learns from environment step `first` to `last`.

    Until step `random_steps` nothing is learned, and actions are those of the teachers, of the warm-start expert, or
    random.
    """
    learner.generator.manual_seed(sac.seed * 1_000_003 + first)
    rng = np.random.default_rng([sac.seed, first])
    for i, env in enumerate(envs):
        env.reseed([sac.seed, first, i])
    replay.abandon()
    statistics.restart(len(envs))
    states = np.stack([env.reset()[0] for env in envs])
    noise = _HeldNoise(len(envs), envs[0].action_space.shape[0], sac.hold, rng)
    for step in range(first, last, len(envs)):
        if step < sac.random_steps and teachers:
            actions = np.stack([teacher.action() for teacher in teachers])
            actions = np.clip(actions + TEACHER_NOISE * noise.next(), -1, 1)
        elif step < sac.random_steps and not sac.warm_start_task:
            actions = np.clip(noise.next(), -1, 1)
        else:
            actions = learner.actor.act(states, noise.next())
        statistics.add_states(states)
        for i, env in enumerate(envs[: last - step]):
            after, reward, terminated, truncated, _ = env.step(actions[i])
            replay.add(i, states[i], actions[i], reward, after, terminated, terminated or truncated)
            statistics.reward(i, reward, sac.gamma, terminated or truncated)
            states[i] = env.reset()[0] if terminated or truncated else after
        if step < sac.random_steps:
            continue
        learner.normalise(*statistics.current())
        learner.learning_rate(sac.learning_rate + (sac.learning_rate_end - sac.learning_rate) * step / sac.steps)
        due = int((step + len(envs) - sac.random_steps) * sac.updates_per_step)
        while learner.step < due and replay.count:  # the replay has no row before n_step steps
            learner.update(replay.sample(sac.batch, sac.replay, rng))


class _HeldNoise:
    """Standard normal exploration noise (E, A). Each row is held for a number of steps that follows a Zipf law."""

    def __init__(self, envs: int, action_dim: int, exponent: float, rng: np.random.Generator) -> None:
        self._noise = np.zeros((envs, action_dim), np.float32)
        self._left = np.zeros(envs, int)
        self._exponent, self._rng = exponent, rng

    def next(self) -> np.ndarray:
        new = self._left == 0
        self._noise[new] = self._rng.standard_normal((new.sum(), self._noise.shape[1]))
        self._left[new] = np.minimum(self._rng.zipf(self._exponent, new.sum()), LONGEST_HOLD)
        self._left -= 1
        return self._noise


class _Statistics:
    """Running mean and standard deviation of states, and standard deviation of discounted returns."""

    def __init__(self, state_dim: int) -> None:
        self.count = 0
        self.mean, self.square = np.zeros(state_dim), np.zeros(state_dim)
        self.returns = np.zeros(3)
        """(3,) count, sum and sum of squares of discounted returns."""
        self._running = np.zeros(0)

    def start_from(self, critic: Critic) -> None:
        """Takes the statistics of `critic`'s training, with a weight of WARM_START_STATES states and returns."""
        std, scale = critic.state_std.double().cpu().numpy(), float(critic.scale)
        self.count, self.mean, self.square = (
            WARM_START_STATES,
            critic.state_mean.double().cpu().numpy(),
            WARM_START_STATES * std**2,
        )
        self.returns[:] = WARM_START_STATES, 0.0, WARM_START_STATES * scale**2

    def restart(self, envs: int) -> None:
        self._running = np.zeros(envs)

    def add_states(self, states: np.ndarray) -> None:
        """Adds states (E, S). All states have the same weight."""
        self.count += len(states)
        delta = states - self.mean
        self.mean += delta.sum(0) / self.count
        self.square += (delta * (states - self.mean)).sum(0)

    def reward(self, env: int, reward: float, gamma: float, ended: bool) -> None:
        self._running[env] = gamma * self._running[env] + reward
        self.returns += (1, self._running[env], self._running[env] ** 2)
        if ended:
            self._running[env] = 0.0

    def current(self) -> tuple[torch.Tensor, torch.Tensor, float]:
        """Mean and standard deviation of states (S,), float32, and the standard deviation of returns."""
        std = np.sqrt(self.square / max(self.count, 1) + 1e-8)
        count, total, squares = self.returns
        spread = np.sqrt(max(squares / count - (total / count) ** 2, 1e-8))
        return torch.from_numpy(self.mean.astype(np.float32)), torch.from_numpy(std.astype(np.float32)), float(spread)


def _export(learner: SACUpdate, meta: dict) -> Expert:
    actor = learner.actor
    expert = Expert(actor.hidden1.in_features, actor.action.out_features, learner.sac.width, meta, squashed=True)
    expert.load_state_dict(actor.state_dict())
    return expert


def _save(state: Path, learner: SACUpdate, replay: Replay, statistics: _Statistics, curve: Curve, done: int) -> None:
    tensors = learner.tensors()
    for name in ("mean", "square", "returns"):
        tensors[f"statistics.{name}"] = torch.from_numpy(getattr(statistics, name))
    notes = {
        "done": done,
        "updates": learner.step,
        "rows": replay.count,
        "seen": statistics.count,
        "curve": curve.points,
    }
    checkpoint.save(state, tensors, notes)


def _load(state: Path, learner: SACUpdate, replay: Replay, statistics: _Statistics, curve: Curve) -> int:
    """Loads the checkpoint in `state`, if any. Returns the number of environment steps done."""
    saved = checkpoint.load(state)
    if saved is None:
        return 0
    tensors, notes = saved
    learner.load(tensors, notes["updates"])
    for name in ("mean", "square", "returns"):
        setattr(statistics, name, tensors[f"statistics.{name}"].numpy().copy())
    statistics.count, replay.count = notes["seen"], notes["rows"]
    curve.points.extend(notes["curve"])
    return notes["done"]
