"""Limits of the rank correlation over actions of one state: `python -m benchmarks.ranking [TASK ...]`.

The benchmark measures two limits with the simulator alone. Contacts make some tasks chaotic: the order of sixteen
actions differs in a state that is a milliradian or a millimetre away, and a critic that is smooth in the state cannot
follow. The differences between actions may also appear later than the branches that a critic is fitted to.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from acgd.critics.gather import Visit, branches, candidates, rollouts
from acgd.critics.quality import discounted, one_per_episode
from acgd.critics.ranks import rank_correlations
from acgd.critics.settings import FQESettings, QualityConfig
from acgd.experts import zoo
from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.seeds import SEEDS
from acgd.store.progress import Progress
from acgd.tasks import registry
from acgd.tasks.settings import TaskConfig
from acgd.tasks.snapshot import STATE
from benchmarks.row import Row

TASKS = tuple(name for name in registry.TASKS if zoo.has_expert(name))
STATES = 24
ENVIRONMENTS = 8
DISTANCE = 1e-3
"""Standard deviation of the offset of each position, in radians and metres."""


def run(tasks: Sequence[str] = TASKS) -> list[Row]:
    """Two rows per task."""
    return [row for task in tasks for row in _measure(task)]


def _measure(task: str) -> list[Row]:
    quality, branched, rng = QualityConfig(), FQESettings().branches.steps, np.random.default_rng(0)
    expert, tail = Expert.load(zoo.folder(task)), quality.tail
    gamma = expert.meta["gamma"]
    lock = Lockstep(TaskConfig(name=task), ENVIRONMENTS, image_size=None, reward_weights=expert.meta["reward_weights"])
    with Progress(open("/dev/null", "w"))(1, task) as bar:
        _, visits, _ = rollouts(
            lock,
            expert,
            quality.perturbation,
            SEEDS.validation,
            limit=registry.TASKS[task].horizon,
            episodes=STATES,
            visit_rate=0.25,
            bar=bar,
        )
        visits = one_per_episode(visits, rng)
        actions = candidates(expert, np.stack([visit.state for visit in visits]), quality.candidates, rng)[0]

        data = branches(lock, expert, visits, actions, tail, bar)
        data_near = branches(lock, expert, [_near(lock.envs[0], visit, rng) for visit in visits], actions, tail, bar)
    full, near, early = (
        discounted(branch_data, gamma, steps)[branch_data.starts].reshape(actions.shape[:2])
        for branch_data, steps in ((data, tail), (data_near, tail), (data, branched))
    )
    orders = {f"{DISTANCE:g} rad or m away": near, f"after {branched} of {tail} steps": early}
    return [
        Row(
            name=f"ranking/{task}: {change}",
            value=float(np.nanmean(rank_correlations(changed, full))),
            unit="rank correlation",
            ratio=None,
            target="",
            met=None,
        )
        for change, changed in orders.items()
    ]


def _near(env, visit: Visit, rng: np.random.Generator) -> Visit:
    """The visit with Gaussian offsets of all positions."""
    env.restore(visit.snapshot)
    mujoco.mj_integratePos(env.model, env.data.qpos, DISTANCE * rng.standard_normal(env.model.nv), 1)
    mujoco.mj_forward(env.model, env.data)
    integration = np.empty_like(visit.snapshot.integration)
    mujoco.mj_getState(env.model, env.data, integration, STATE)
    snapshot = replace(visit.snapshot, integration=integration)
    return replace(visit, snapshot=snapshot, state=env.restore(snapshot)["state"])


if __name__ == "__main__":
    for name in sys.argv[1:] or TASKS:
        for row in run([name]):
            print(f"{row['name']:60} {row['value']:.2f}", flush=True)
