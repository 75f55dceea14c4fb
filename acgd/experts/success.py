"""Success of an expert over many seeds."""

import numpy as np

from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.tasks.settings import TaskConfig

ENVIRONMENTS = 8
"""Episodes side by side; results do not depend on it beyond the last bit of batched inference."""


def episodes(expert: Expert, task: TaskConfig, seeds: list[int], lock: Lockstep | None = None) -> list[dict]:
    """Run the deterministic expert once per seed; a row (seed, steps, return, final, held, once) for each."""
    lock = lock or Lockstep(task, min(ENVIRONMENTS, len(seeds)), image=False,
                            reward_weights=expert.meta.get("reward_weights"))  # fmt: skip
    rows = []
    for at in range(0, len(seeds), len(lock.envs)):
        chunk = seeds[at : at + len(lock.envs)]
        obs = lock.reset(chunk)
        total, steps = np.zeros(len(chunk)), np.zeros(len(chunk), int)
        infos: list[dict] = []
        while lock.active.any():
            steps += lock.active
            obs, reward, _, infos = lock.step(expert.mean(obs["state"]))
            total += reward
        for i, seed in enumerate(chunk):
            rows.append({"seed": seed, "steps": int(steps[i]), "return": float(total[i]), **infos[i]["success"]})
    return rows
