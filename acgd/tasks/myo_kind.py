"""What a kind of MyoDex task brings along: what is observed, where it starts, what its reset writes."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np


@dataclass(frozen=True)
class MyoKind:
    """One kind. `base` is MyoSuite's environment, without wrappers."""

    model_fields: tuple[str, ...]
    """Fields of mjModel that a reset writes: with the integration state they determine the episode."""
    hand_std: float
    """Standard deviation of every hand joint's start, rad; clipped to the joint's range."""
    entries: Callable[[Any, mujoco.MjData, float], dict[str, np.ndarray]]
    """(base, data, control step in s) -> object and goal by name, each (n,)."""
    perturb: Callable[[Any, np.random.Generator, bool], None]
    """(base, rng, goal): moves the object, and, where `goal` is true, the goal. Draws every number in any case, so that
    a seed means the same start for all."""
    goal: Callable[[Any, mujoco.MjData], np.ndarray] | None = None
    """(base, data) -> what the environment is asked for, (G,), constant within an episode. None: the same in every
    episode. G stands in spec.GOAL_SIZES."""
    nominal_goal: Callable[[Any], np.ndarray] | None = None
    """base -> the goal of MyoSuite's own reset, which `perturb` finds in `base.nominal_goal`. For tasks whose goal the
    suite does not draw."""
    advance: Callable[[Any, float], None] | None = None
    """(base, share): puts the start `share` of the way to the goal, for training. None: there is no such start."""
