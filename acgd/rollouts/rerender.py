"""Frames of recorded episodes, rendered again from the stored simulation states."""

from pathlib import Path

import numpy as np

from acgd.rollouts.dataset import Demonstrations
from acgd.rollouts.store import read_attributes
from acgd.simulate.record import FIELDS
from acgd.tasks import registry
from acgd.tasks.settings import TaskConfig
from acgd.tasks.snapshot import Snapshot


def rerender(
    artifact_dir: Path, task: TaskConfig, episodes: list[int] | None = None, image_size: int | None = None
) -> dict[int, np.ndarray]:
    """Frames (T + 1, H, W, 3) uint8 of each episode. The last frame is that of the final observation.

    Without `image_size`, in pixels, and with the task of the rollouts the frames equal the stored frames byte for byte.
    """
    stored = read_attributes(Path(artifact_dir) / "rollouts.zarr")["chunks"]
    fields = [name for name in stored if name.startswith(FIELDS)]
    demos = Demonstrations.load(artifact_dir, ["integration", "final_integration", "final_image", *fields])
    env = registry.make(task, image_size=image_size or demos.arrays["final_image"].shape[1])
    env.reset(seed=0)
    frames = {}
    for e in range(len(demos.episode_ends)) if episodes is None else episodes:
        model = {name.removeprefix(FIELDS): demos.arrays[name][e] for name in fields}
        states = demos.arrays["integration"][demos.episode_starts[e] : demos.episode_ends[e]]
        states = [*states, demos.arrays["final_integration"][e]]
        frames[e] = np.stack([env.restore(Snapshot(state, model))["image"] for state in states])
    return frames
