"""Obj-hold: move the object in the hand to a goal, and hold it there."""

import numpy as np

from acgd.tasks.myo_kind import MyoKind
from acgd.tasks.rendering.camera import Camera

CAMERA = Camera((-0.23, -0.53, 1.43), 0.26, 130.0, -50.0)
HOLD_PLACE = 0.003
HOLD_GOAL = 0.006
"""Uniform noise of the object's place and of the goal, metres per axis."""


def _entries(base, data, step: float) -> dict[str, np.ndarray]:
    position, goal = data.site_xpos[base.object_sid].copy(), data.site_xpos[base.goal_sid].copy()
    return {
        "obj_pos": position,
        "goal_pos": goal,
        "obj_err": goal - position,
        "obj_rot": data.site_xmat[base.object_sid][:6].copy(),
        "obj_vel": data.qvel[-6:] * step,
        "obj_size": base.model.geom_size[-1].copy(),
    }


def _goal(base, data) -> np.ndarray:
    """Where the object is wanted (3,), m."""
    return data.site_xpos[base.goal_sid]


def _nominal_goal(base) -> np.ndarray:
    return base.model.site_pos[base.goal_sid].copy()


def _perturb(base, rng: np.random.Generator, goal: bool) -> None:
    base.data.qpos[-7:-5] += rng.uniform(-HOLD_PLACE, HOLD_PLACE, 2)
    offset = rng.uniform(-HOLD_GOAL, HOLD_GOAL, 3)
    if goal:
        base.model.site_pos[base.goal_sid] = base.nominal_goal + offset


KIND = MyoKind(
    model_fields=(
        "site_pos", "site_size", "geom_size", "geom_rbound", "geom_aabb", "body_mass", "body_inertia",
        "body_subtreemass", "body_invweight0", "dof_invweight0", "body_ipos", "body_iquat",
    ),
    hand_std=0.03,
    entries=_entries,
    goal=_goal,
    perturb=_perturb,
    nominal_goal=_nominal_goal,
)  # fmt: skip
