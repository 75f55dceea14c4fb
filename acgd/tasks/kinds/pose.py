"""Pose: move all joints of the hand to target angles."""

import numpy as np

from acgd.tasks.myo_kind import MyoKind
from acgd.tasks.rendering.camera import Camera
from acgd.tasks.simulator import mujoco

CAMERA = Camera((-0.17, -0.53, 1.43), 0.28, 150.0, -25.0)
POSE_GOAL = 0.15
"""Uniform noise of the target angles, rad per joint."""


def _entries(base, data, step: float) -> dict[str, np.ndarray]:
    return {
        "pose_err": base.target_jnt_value - data.qpos,
        "target_tips": data.site_xpos[base.target_sids].ravel(),
    }


def _goal(base, data) -> np.ndarray:
    """The wanted joint angles (23,) in the order of qpos, rad."""
    return base.target_jnt_value


def _nominal_goal(base) -> np.ndarray:
    return base.target_jnt_value.copy()


def _perturb(base, rng: np.random.Generator, goal: bool) -> None:
    offset = rng.uniform(-POSE_GOAL, POSE_GOAL, base.model.nq)
    if not goal:
        return
    low, high = base.model.jnt_range.T
    target = np.clip(base.nominal_goal + offset, low, high)
    base.target_jnt_value = target
    start = base.data.qpos.copy()
    base.data.qpos[:] = target
    mujoco.mj_kinematics(base.model, base.data)
    base.model.site_pos[base.target_sids] = base.data.site_xpos[base.tip_sids]
    base.data.qpos[:] = start


def _advance(base, share: float) -> None:
    low, high = base.model.jnt_range.T
    goal = np.clip(base.target_jnt_value, low, high)
    base.data.qpos[:] += share * (goal - base.data.qpos)


KIND = MyoKind(
    model_fields=("site_pos",),
    hand_std=0.05,
    entries=_entries,
    goal=_goal,
    perturb=_perturb,
    nominal_goal=_nominal_goal,
    advance=_advance,
)
