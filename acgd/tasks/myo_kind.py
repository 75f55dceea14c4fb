"""A kind of MyoDex task: its observations, its starts, and the model fields that its reset writes."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from acgd.tasks.simulator import mujoco


@dataclass(frozen=True)
class MyoKind:
    """One kind. `base` is MyoSuite's environment without wrappers."""

    model_fields: tuple[str, ...]
    """Fields of mjModel that a reset writes. Together with the integration state they determine the episode."""
    hand_std: float
    """Standard deviation in rad of each hand joint's start, which is clipped to the joint's range."""
    entries: Callable[[Any, mujoco.MjData, float], dict[str, np.ndarray]]
    """(base, data, control step in s) -> name -> entries (n,) of object and goal."""
    perturb: Callable[[Any, np.random.Generator, bool], None]
    """(base, rng, goal): moves the object and, if `goal` is true, the goal. The number of draws does not depend on
    `goal`, so that a seed gives the same start in both cases."""
    goal: Callable[[Any, mujoco.MjData], np.ndarray] | None = None
    """(base, data) -> commanded goal (G,), constant within an episode. G stands in spec.GOAL_SIZES. None: the goal is
    the same in every episode."""
    nominal_goal: Callable[[Any], np.ndarray] | None = None
    """base -> goal of MyoSuite's reset, for tasks with a fixed goal. `perturb` reads it as `base.nominal_goal`."""
    advance: Callable[[Any, float], None] | None = None
    """(base, share): moves the start by `share` of the way to the goal, for training. None without such starts."""
