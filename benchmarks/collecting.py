"""Environment steps per second of the recording of demonstrations, with and without images:
`python -m benchmarks.collecting`."""

import time

import torch

from acgd.collection.demonstrations import run_wave
from acgd.collection.settings import RolloutsConfig
from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.seeds import SEEDS
from acgd.tasks import registry
from acgd.tasks.settings import TaskConfig
from benchmarks.row import Row

TASKS = ("myo/key-turn", "myo/obj-hold", "myo/reach")
EPISODES = 4
"""Episodes in lockstep."""
WAVES = 2
"""Measured waves of episodes; one more comes first and is not counted."""
LEAST_RATIO = 0.6
"""Smallest accepted rate with images over the rate without."""


def run() -> list[Row]:
    """One row per task. The expert is untrained, which does not change the cost of a step."""
    torch.set_num_threads(1)
    return [_measure(TaskConfig(name=name)) for name in TASKS]


def _measure(task: TaskConfig) -> Row:
    config = RolloutsConfig()
    locks = {image: Lockstep(task, EPISODES, image_size=84 if image else None) for image in (False, True)}
    env = registry.make(task, image_size=None)
    expert = Expert.random(env.observation_space["state"].shape[0], env.action_space.shape[0])
    seconds, steps = {False: 0.0, True: 0.0}, {False: 0, True: 0}
    for wave in range(WAVES + 1):
        seeds = SEEDS.demonstrations.take(EPISODES, offset=wave * EPISODES)
        for image, lock in locks.items():
            started = time.perf_counter()
            episodes = run_wave(expert, lock, seeds, config)
            if wave:  # the first wave uploads meshes
                seconds[image] += time.perf_counter() - started
                steps[image] += sum(len(episode["reward"]) for episode in episodes)
    rate = {image: steps[image] / seconds[image] for image in locks}
    return Row(
        name=f"collecting/{task.name}",
        value=rate[True],
        unit="steps/s",
        ratio=rate[True] / rate[False],
        target=f">= {LEAST_RATIO:.0%} of the rate without images",
        met=rate[True] >= LEAST_RATIO * rate[False],
    )


if __name__ == "__main__":
    for row in run():
        print(row)
