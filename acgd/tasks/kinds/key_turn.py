"""Key-turn: turn a key with thumb and index finger."""

import numpy as np

from acgd.tasks.myo_kind import MyoKind
from acgd.tasks.rendering.camera import Camera

CAMERA = Camera((-0.16, -0.555, 1.42), 0.29, 100.0, -40.0)
KEY_PLACE = 0.002
"""Uniform noise of the key's place, metres per axis."""
KEY_ANGLE = 0.2
"""Uniform noise of the key's angle, rad."""


def _entries(base, data, step: float) -> dict[str, np.ndarray]:
    key = data.site_xpos[base.keyhead_sid].copy()
    return {
        "key_qpos": data.qpos[-1:].copy(),
        "key_qvel": data.qvel[-1:] * step,
        "key_pos": key,
        "IFtip_approach": key - data.site_xpos[base.IF_sid],
        "THtip_approach": key - data.site_xpos[base.TH_sid],
    }


def _perturb(base, rng: np.random.Generator, goal: bool) -> None:
    place = rng.uniform(-KEY_PLACE, KEY_PLACE, 3)
    angle = rng.uniform(-KEY_ANGLE, KEY_ANGLE)
    if goal:  # the Random task draws place and angle over wider ranges
        base.model.body_pos[-1] = base.key_init_pos + place
        base.data.qpos[-1] = angle


def _advance(base, share: float) -> None:
    base.data.qpos[-1] += share * (base.goal_th - base.data.qpos[-1])


KIND = MyoKind(
    model_fields=("body_pos",),
    hand_std=0.03,
    entries=_entries,
    perturb=_perturb,
    advance=_advance,
)
