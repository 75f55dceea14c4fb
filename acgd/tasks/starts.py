"""Perturbed starts of the MyoDex suite: one distribution per kind of task, drawn by the episode's seed.

MyoSuite's Fixed tasks always reset to one state, so that a deterministic policy repeats one episode for all seeds. The
perturbation draws hand, object and goal for every seed. Experts, critics, demonstrations and evaluation use the same
distribution. In MyoSuite's Random tasks the suite draws the goal, and only hand and object are perturbed.
"""

import numpy as np

from acgd.tasks.myo_kind import MyoKind


def perturb(kind: MyoKind, base, hand_qpos: np.ndarray, rng: np.random.Generator, *, goal: bool) -> None:
    """Perturbs the start of `base`, a MyoSuite environment after its reset.

    hand_qpos: (23,) addresses of the hand's joints in qpos. goal: whether the goal is perturbed. The caller runs the
    forward kinematics afterwards.
    """
    _hand(base, hand_qpos, kind.hand_std, rng)
    kind.perturb(base, rng, goal)


def _hand(base, hand_qpos: np.ndarray, std: float, rng: np.random.Generator) -> None:
    model, data = base.model, base.data
    joints = [int(np.flatnonzero(model.jnt_qposadr == adr)[0]) for adr in hand_qpos]
    low, high = model.jnt_range[joints].T
    data.qpos[hand_qpos] = np.clip(data.qpos[hand_qpos] + rng.normal(0.0, std, len(hand_qpos)), low, high)
