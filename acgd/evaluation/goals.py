"""Goal images o_T (Section III-A; docs/deviations.md): last frames of demonstrations or of the expert's episodes."""

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
    """Index of the demonstration for an episode's seed. It is the same for every student and every control."""
    return int(np.random.default_rng([seed, 2]).integers(demonstrations))


def training_goals(rollouts: Path, seeds: Sequence[int]) -> np.ndarray:
    """Goal images (m, H, W, 3) uint8: for each seed the last frame of a demonstration."""
    images = Demonstrations.load(rollouts, ["final_image"]).arrays["final_image"]
    return images[[demonstration_for(seed, len(images)) for seed in seeds]]


def oracle_goals(task: TaskConfig, expert: Expert, seeds: Sequence[int], size: int, image_size: int) -> np.ndarray:
    """Goal images (m, H, W, 3) uint8: for each seed the last frame of the expert's episode, solved or not.

    size: episodes in lockstep. image_size: H and W.
    """
    lock = Lockstep(task, size, image_size=None)
    images = []
    for first in range(0, len(seeds), size):
        batch = list(seeds[first : first + size])
        roll(lock, Padded(Mean(expert), size), batch)
        images += [env.render(image_size) for env in lock.envs[: len(batch)]]
    return np.stack(images)
