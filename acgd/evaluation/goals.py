"""Goal images o_T (paper III-A; docs/deviations.md).

An image is the end of a demonstration, or of the expert's own run from the same seed.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from acgd.experts.policy import Expert
from acgd.rollouts.dataset import Demonstrations
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.policy import Mean, Padded
from acgd.simulate.roll import roll
from acgd.tasks.settings import TaskConfig


def demonstration_for(seed: int, demonstrations: int) -> int:
    """The demonstration that belongs to an episode's seed: the same for every student and every control."""
    return int(np.random.default_rng([seed, 2]).integers(demonstrations))


def training_goals(rollouts: Path, seeds: Sequence[int]) -> np.ndarray:
    """(m, H, W, 3) uint8: for each seed the last frame of a demonstration."""
    images = Demonstrations.load(rollouts, ["final_image"]).arrays["final_image"]
    return images[[demonstration_for(seed, len(images)) for seed in seeds]]


def oracle_goals(task: TaskConfig, expert: Expert, seeds: Sequence[int], size: int, image_size: int) -> np.ndarray:
    """(m, H, W, 3) uint8: for each seed the last frame of the expert's own run, solved or not.

    size: runs at a time. image_size: H and W.
    """
    lock = Lockstep(task, size, image_size=None)
    images = []
    for at in range(0, len(seeds), size):
        batch = list(seeds[at : at + size])
        roll(lock, Padded(Mean(expert), size), batch)
        images += [env.render(image_size) for env in lock.envs[: len(batch)]]
    return np.stack(images)
