"""One wave of episodes: several seeds in lockstep, recorded step by step."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from safetensors import safe_open
from safetensors.numpy import save_file

from acgd.collection.settings import RolloutsConfig
from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.store.atomic import replace_file

Episode = dict[str, np.ndarray]
"""Name -> array: with a time axis (T, ...), or what the episode has once (names in ONCE, `final_*`, `model_fields/*`)."""

ONCE = ("seed", "terminated", "success_final", "success_held", "success_once")
FINAL = "final_"
FIELDS = "model_fields/"
TERMS = "reward_terms/"
"""Terms of the reward before weighting, each (T,), as the environment reports them."""


def run_wave(expert: Expert, lock: Lockstep, seeds: Sequence[int], config: RolloutsConfig) -> list[Episode]:
    """The episodes of `seeds`, in their order, successful or not.

    Depends on nothing but its arguments: all noise comes from one generator seeded with `seeds`.
    """
    rng = np.random.default_rng(seeds)
    obs = lock.reset(list(seeds))
    recordings = [_Recording() for _ in seeds]
    for env, seed, recording in zip(lock.envs, seeds, recordings):
        recording.once["seed"] = np.int64(seed)
        recording.once |= {FIELDS + name: value for name, value in env.snapshot().model_fields.items()}
    while lock.active.any():
        running = np.flatnonzero(lock.active)
        mean = expert.mean(obs["state"])
        action = _act(expert, obs["state"], mean, config, rng)
        for i in running:
            recordings[i].add(**{name: rows[i] for name, rows in obs.items()}, **_physics(lock.envs[i]))
            recordings[i].add(action=action[i], mean_action=mean[i])
        obs, reward, done, infos = lock.step(action)
        for i in running:
            terms = {TERMS + name: np.float32(value) for name, value in infos[i]["reward_terms"].items()}
            recordings[i].add(reward=np.float32(reward[i]), solved=np.bool_(infos[i]["solved"]), **terms)
        for i in np.flatnonzero(done):
            last = {name: rows[i] for name, rows in obs.items()} | {
                "integration": _physics(lock.envs[i])["integration"]
            }
            recordings[i].once |= {FINAL + name: value for name, value in last.items()}
            recordings[i].once |= {f"success_{rule}": np.bool_(met) for rule, met in infos[i]["success"].items()}
            recordings[i].once["terminated"] = np.bool_(lock.terminated[i])
    return [recording.episode() for recording in recordings]


def _act(
    expert: Expert, state: np.ndarray, mean: np.ndarray, config: RolloutsConfig, rng: np.random.Generator
) -> np.ndarray:
    """The executed action (B, A), clipped."""
    action = mean if config.acting == "mean" else expert.sample(state, rng)
    if config.noise:
        action = action + config.noise * rng.standard_normal(action.shape)
    return np.clip(action, -1.0, 1.0).astype(np.float32)


def _physics(env) -> Episode:
    """The full simulation state (N,) float64, and the part of it that people read."""
    integration = np.empty(mujoco.mj_stateSize(env.model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(env.model, env.data, integration, mujoco.mjtState.mjSTATE_INTEGRATION)
    return {"integration": integration, "qpos": env.data.qpos.copy(), "qvel": env.data.qvel.copy()}


@dataclass
class _Recording:
    """What has been seen of a running episode."""

    steps: dict[str, list] = field(default_factory=dict)
    once: Episode = field(default_factory=dict)

    def add(self, **values: np.ndarray) -> None:
        for name, value in values.items():
            self.steps.setdefault(name, []).append(value)

    def episode(self) -> Episode:
        return {name: np.stack(rows) for name, rows in self.steps.items()} | self.once


@dataclass(frozen=True)
class StoredEpisode:
    """An episode of a wave that lies on disk; read array by array, since all images together may not fit."""

    file: Path
    index: int

    def names(self) -> list[str]:
        with safe_open(self.file, "numpy") as arrays:
            return [name.partition("/")[2] for name in arrays.keys() if name.startswith(f"{self.index}/")]

    def __getitem__(self, name: str) -> np.ndarray:
        with safe_open(self.file, "numpy") as arrays:
            return arrays.get_tensor(f"{self.index}/{name}")


def save_wave(file: Path, episodes: Sequence[Episode]) -> None:
    """Write a wave so that the file either holds all of it or does not exist."""
    arrays = {f"{i}/{name}": np.asarray(value) for i, episode in enumerate(episodes) for name, value in episode.items()}
    replace_file(file, lambda draft: save_file(arrays, draft))
