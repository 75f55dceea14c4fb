"""Success of an expert over episode seeds."""

from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.policy import Mean
from acgd.simulate.record import Outcomes
from acgd.simulate.roll import roll
from acgd.tasks.settings import TaskConfig

ENVIRONMENTS = 8
"""Episodes in one batch. Results depend on this number only by the rounding of batched inference."""


def episodes(expert: Expert, task: TaskConfig, seeds: list[int], lock: Lockstep | None = None) -> list[dict]:
    """Runs the deterministic expert once per seed. A row per episode: seed, steps, return, final, held, once."""
    lock = lock or Lockstep(
        task, min(ENVIRONMENTS, len(seeds)), image_size=None, reward_weights=expert.meta.get("reward_weights")
    )
    rows = []
    for at in range(0, len(seeds), len(lock.envs)):
        batch, outcomes = seeds[at : at + len(lock.envs)], Outcomes()
        roll(lock, Mean(expert), batch, recorders=[outcomes])
        for i, seed in enumerate(batch):
            counts = {"seed": seed, "steps": int(outcomes.steps[i]), "return": float(outcomes.reward[i])}
            rows.append(counts | outcomes.success[i])
    return rows
