"""Pen-twirl: turn the pen in the hand to a target direction."""

import numpy as np

from acgd.tasks.myo_kind import MyoKind
from acgd.tasks.rendering.camera import Camera

CAMERA = Camera((-0.125, -0.53, 1.40), 0.50, 90.0, -50.0)
PEN_PLACE = 0.005
"""Uniform noise of the pen's place, metres per axis."""
PEN_TILT = 0.1
PEN_GOAL = 0.2
"""Uniform noise of the pen's tilt and of the target's tilt, rad per axis."""


def _entries(base, data, step: float) -> dict[str, np.ndarray]:
    position, goal = data.xpos[base.obj_bid].copy(), data.site_xpos[base.eps_ball_sid]
    rotation = (data.site_xpos[base.obj_t_sid] - data.site_xpos[base.obj_b_sid]) / base.pen_length
    wanted = (data.site_xpos[base.tar_t_sid] - data.site_xpos[base.tar_b_sid]) / base.tar_length
    return {
        "obj_pos": position,
        "obj_vel": data.qvel[-6:] * step,
        "obj_rot": rotation,
        "obj_des_rot": wanted,
        "obj_err_pos": position - goal,
        "obj_err_rot": rotation - wanted,
    }


def _goal(base, data) -> np.ndarray:
    """The wanted direction of the pen (3,), a unit vector."""
    return (data.site_xpos[base.tar_t_sid] - data.site_xpos[base.tar_b_sid]) / base.tar_length


def _perturb(base, rng: np.random.Generator, goal: bool) -> None:
    from myosuite.physics.quat_math import euler2quat

    base.data.qpos[-6:-4] += rng.uniform(-PEN_PLACE, PEN_PLACE, 2)
    base.data.qpos[-3:] += rng.uniform(-PEN_TILT, PEN_TILT, 3)
    tilt = rng.uniform(-PEN_GOAL, PEN_GOAL, 2)
    if goal:
        base.model.body_quat[base.target_obj_bid] = euler2quat(np.array([tilt[0], tilt[1], 0.0]))


KIND = MyoKind(model_fields=("body_quat",), hand_std=0.05, entries=_entries, goal=_goal, perturb=_perturb)
