"""The observation space that all tasks share."""

import gymnasium
import numpy as np

DEFAULT_SIZE = 84
"""Height and width in pixels of a rendered picture where the observations have no image."""


def layout(entries: dict[str, np.ndarray]) -> dict[str, slice]:
    """Name -> columns of the state that concatenates the entries in order."""
    slices, at = {}, 0
    for name, value in entries.items():
        slices[name] = slice(at, at + value.size)
        at += value.size
    return slices


def space(proprio: int, state: int, image_size: int | None) -> gymnasium.spaces.Dict:
    """`proprio` (P,) and `state` (S,) float32, and `image` (H, H, 3) uint8 unless `image_size` is None."""
    spaces = {
        name: gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)
        for name, size in (("proprio", proprio), ("state", state))
    }
    if image_size is not None:
        spaces["image"] = gymnasium.spaces.Box(0, 255, (image_size, image_size, 3), np.uint8)
    return gymnasium.spaces.Dict(spaces)
