"""Reach: move the five fingertips to five targets."""

import numpy as np

from acgd.tasks.myo_kind import MyoKind
from acgd.tasks.rendering.camera import Camera

CAMERA = Camera((-0.17, -0.53, 1.43), 0.28, 150.0, -25.0)
REACH_GOAL = 0.015
"""Uniform noise that moves all targets together, metres per axis."""


def _entries(base, data, step: float) -> dict[str, np.ndarray]:
    tips, targets = data.site_xpos[base.tip_sids].ravel(), data.site_xpos[base.target_sids].ravel()
    return {"tip_pos": tips, "target_pos": targets, "reach_err": targets - tips}


def _goal(base, data) -> np.ndarray:
    """Where the five fingertips are wanted (15,), m."""
    return data.site_xpos[base.target_sids].ravel()


def _nominal_goal(base) -> np.ndarray:
    return np.array([span[0] for span in base.target_reach_range.values()])


def _perturb(base, rng: np.random.Generator, goal: bool) -> None:
    offset = rng.uniform(-REACH_GOAL, REACH_GOAL, 3)
    if goal:
        base.model.site_pos[base.target_sids] = base.nominal_goal + offset


KIND = MyoKind(
    model_fields=("site_pos",),
    hand_std=0.05,
    entries=_entries,
    goal=_goal,
    perturb=_perturb,
    nominal_goal=_nominal_goal,
)
