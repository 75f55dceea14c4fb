"""Dexterous tasks solved without feedback: from the nominal start, one posture of the servos after another."""

from dataclasses import dataclass

import numpy as np

from acgd.tasks.kinds import bottle
from acgd.tasks.robots.shadow import MOTORS


@dataclass(frozen=True)
class Posture:
    """Targets of all servos, metres and radians, approached for so many control steps at this share of full speed."""

    steps: int
    targets: np.ndarray
    speed: float = 1.0


def _allegro(wrist, index, middle, ring, thumb) -> np.ndarray:
    return np.array([*wrist, *index, *middle, *ring, *thumb])


def _shadow(right: dict[str, float], left: dict[str, float]) -> np.ndarray:
    """The named motors of both hands; the others at zero."""
    return np.array([hand.get(name, 0.0) for hand in (right, left) for name in MOTORS])


def _bend(
    angle: float, fingers: tuple[str, ...] = ("FF", "MF", "RF", "LF"), joints: tuple[str, ...] = ("J2",)
) -> dict[str, float]:
    return {finger + joint: angle for finger in fingers for joint in joints}


_OVER = {"x": -0.036} | _bend(1.45)
_PRESS = {"x": -0.055, "z": -0.1} | _bend(0.8)
_NECK = {"x": -0.064, "y": 0.06, "z": 0.0445}
_HOOK = _bend(1.4, ("FF", "MF"), ("J1", "J2"))

SOLUTIONS: dict[str, tuple[Posture, ...]] = {
    "opdex/spray-1": (
        Posture(40, _allegro((-0.03, -0.03, 0.01, -0.12, -0.10, 0.04), (0.08, 0.07, 0.16, 0.16),
                             (0.04, 0.04, 0.59, 0.53), (0.08, 0.13, 0.32, 0.44), (1.10, 0.50, 0.03, 0.26))),
        Posture(60, _allegro((0, 0, 0.01, 0.11, 0.06, 0.20), (0.21, 0.43, 1.18, 0.85), (0, 1.06, 1.24, 0.75),
                             (-0.37, 0.52, 0.85, 0.54), (1.28, 0.70, 1.01, 0.64)), 0.5),
    ),
    "opdex/spray-2": (
        Posture(40, _allegro((-0.02, -0.04, -0.03, -0.06, -0.17, 0.03), (0.14, 0.01, 0.73, 0.46),
                             (-0.07, 0.12, 0.52, -0.11), (-0.10, -0.04, 0.65, 0.31), (0.93, 0.40, 0.23, 0.17))),
        Posture(60, _allegro((-0.01, -0.01, -0.01, -0.09, 0.09, 0.17), (-0.19, 0.65, 1.42, 1.07),
                             (0.08, 0.89, 1.28, 0.89), (-0.07, 0.50, 0.88, 0.80), (1.38, 0.47, 0.82, 0.26)), 0.5),
    ),
    "bidex/switch": (Posture(125, _shadow(_PRESS, _PRESS)),),
    "bidex/scissors": (
        Posture(20, _shadow(_OVER | {"y": -0.13}, _OVER | {"y": 0.13})),
        Posture(20, _shadow(_OVER | {"y": -0.13, "z": -0.105}, _OVER | {"y": 0.13, "z": -0.105})),
        Posture(85, _shadow(_OVER | {"y": -0.03, "z": -0.105}, _OVER | {"y": 0.03, "z": -0.105})),
    ),
    "bidex/bottle": (
        Posture(20, _shadow(_NECK, bottle.HOLDING)),
        Posture(15, _shadow(_NECK | _HOOK, bottle.HOLDING)),
        Posture(90, _shadow(_NECK | _HOOK | {"x": -0.01, "z": 0.09}, bottle.HOLDING)),
    ),
}  # fmt: skip
"""OpDex: by the cross-entropy method, with the order given: beside the neck, then closed around it. BiDex: by hand.
Fingers on the rockers and down; fingers over the handles, into them, and apart; behind the neck, hooked around it, and
away with the cap."""


def follow(env, postures: tuple[Posture, ...]) -> tuple[np.ndarray, dict]:
    """Run an episode of `env`, a DexterousTask; returns the actions (T, A) and the last info."""
    env.reset(seed=0)
    taken = []
    for posture in postures:
        for _ in range(posture.steps):
            left = posture.targets - env.data.ctrl
            taken.append(np.clip(left / env.scene.robot.stride, -1, 1) * posture.speed)
            _, _, terminated, truncated, info = env.step(taken[-1])
            if terminated or truncated:
                return np.array(taken), info
    return np.array(taken), info
