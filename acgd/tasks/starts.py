"""Perturbed starts: one distribution per kind of task, drawn by the episode's seed.

MyoSuite's Fixed tasks always reset to one state, so that a deterministic policy repeats one episode
whatever the seed. Here the hand, the object and the goal are drawn anew for every seed; the same
distribution serves experts, critics, demonstrations and evaluation. Where MyoSuite itself draws the
goal (its Random tasks) that draw stays, and only hand and object are perturbed.
"""

import mujoco
import numpy as np

HAND_STD = {"key-turn": 0.03, "obj-hold": 0.03, "pen-twirl": 0.05, "pose": 0.05, "reach": 0.05}
"""Standard deviation of every hand joint's start, rad; clipped to the joint's range."""
KEY_PLACE = 0.002
KEY_ANGLE = 0.2
HOLD_PLACE = 0.003
HOLD_GOAL = 0.006
PEN_PLACE = 0.005
PEN_TILT = 0.1
PEN_GOAL = 0.2
POSE_GOAL = 0.15
REACH_GOAL = 0.015


def perturb(kind: str, base, hand_qpos: np.ndarray, rng: np.random.Generator, *, goal: bool) -> None:
    """Move the start of `base` (a MyoSuite environment that has just been reset).

    `hand_qpos` (23,) are the addresses of the hand's joints in qpos. `goal` is False where the suite
    has drawn the goal itself. The caller runs the forward kinematics afterwards.
    """
    _hand(base, hand_qpos, HAND_STD[kind], rng)
    _KINDS[kind](base, rng, goal)


def advance(kind: str, base, share: float) -> None:
    """Put the hand of a pose task, or the key of a key-turn task, `share` of the way from where it is to its goal."""
    _ADVANCED[kind](base, share)


def _hand(base, hand_qpos: np.ndarray, std: float, rng: np.random.Generator) -> None:
    model, data = base.model, base.data
    joints = [int(np.flatnonzero(model.jnt_qposadr == adr)[0]) for adr in hand_qpos]
    low, high = model.jnt_range[joints].T
    data.qpos[hand_qpos] = np.clip(data.qpos[hand_qpos] + rng.normal(0.0, std, len(hand_qpos)), low, high)


def _key(base, rng: np.random.Generator, goal: bool) -> None:
    place = rng.uniform(-KEY_PLACE, KEY_PLACE, 3)
    angle = rng.uniform(-KEY_ANGLE, KEY_ANGLE)
    if goal:  # the Random task draws place and angle over wider ranges itself
        base.model.body_pos[-1] = base.key_init_pos + place
        base.data.qpos[-1] = angle


def _hold(base, rng: np.random.Generator, goal: bool) -> None:
    base.data.qpos[-7:-5] += rng.uniform(-HOLD_PLACE, HOLD_PLACE, 2)
    offset = rng.uniform(-HOLD_GOAL, HOLD_GOAL, 3)
    if goal:
        base.model.site_pos[base.goal_sid] = base.nominal_goal + offset


def _pen(base, rng: np.random.Generator, goal: bool) -> None:
    from myosuite.physics.quat_math import euler2quat

    base.data.qpos[-6:-4] += rng.uniform(-PEN_PLACE, PEN_PLACE, 2)
    base.data.qpos[-3:] += rng.uniform(-PEN_TILT, PEN_TILT, 3)
    tilt = rng.uniform(-PEN_GOAL, PEN_GOAL, 2)
    if goal:
        base.model.body_quat[base.target_obj_bid] = euler2quat(np.array([tilt[0], tilt[1], 0.0]))


def _pose(base, rng: np.random.Generator, goal: bool) -> None:
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


def _reach(base, rng: np.random.Generator, goal: bool) -> None:
    offset = rng.uniform(-REACH_GOAL, REACH_GOAL, 3)
    if goal:
        base.model.site_pos[base.target_sids] = base.nominal_goal + offset


def _advance_key(base, share: float) -> None:
    base.data.qpos[-1] += share * (base.goal_th - base.data.qpos[-1])


def _advance_pose(base, share: float) -> None:
    low, high = base.model.jnt_range.T
    goal = np.clip(base.target_jnt_value, low, high)
    base.data.qpos[:] += share * (goal - base.data.qpos)


_KINDS = {"key-turn": _key, "obj-hold": _hold, "pen-twirl": _pen, "pose": _pose, "reach": _reach}
_ADVANCED = {"key-turn": _advance_key, "pose": _advance_pose}
ADVANCED_KINDS = tuple(_ADVANCED)
"""Tasks with starts on the way to their goal."""
