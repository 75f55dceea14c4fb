"""BiDex Bottle: the left hand holds a bottle, and the right hand pulls its cap off."""

from dataclasses import replace

import numpy as np

from acgd.tasks.rendering.camera import Camera
from acgd.tasks.robots import shadow
from acgd.tasks.scene import NEAR, Touch, closeness, compiled
from acgd.tasks.simulator import mujoco

CAMERA = Camera((0.08, -0.6, 0.55), 0.42, -50.0, -30.0)
PLACE, PITCH = (0.0, -0.6, 0.5), -0.7
"""Place of the bottle's held middle in metres, and its pitch in radians: the cap points to +x and upwards."""
QUAT = (np.cos(PITCH / 2.0), 0.0, np.sin(PITCH / 2.0), 0.0)
AXIS = np.array([np.cos(PITCH), 0.0, -np.sin(PITCH)])
"""Unit vector from the bottom to the cap, in the world."""
BACK = np.array([AXIS[2], 0.0, -AXIS[0]])
"""Unit vector out of the back of both hands, in the world. The palms are parallel to the bottle and face up."""
BODY, RADIUS = 0.175, 0.038
NECK, NECK_RADIUS = 0.09, 0.010
CAP, CAP_RADIUS = 0.010, 0.013
"""Lengths and radii of the wide part, the neck and the cap, metres."""
CAP_PLACE = BODY / 2.0 + NECK + CAP / 2.0
"""Place of the cap along the axis, metres."""
TRAVEL, OFF = 0.064, 0.028
"""Largest travel of the cap, and travel from which it counts as off, metres."""
TILT = 0.3
"""Angle of the left hand's fingers below the wrist, radians. The bottle lies in the hooked fingers."""
IN_LEFT = (-0.018, -0.0495, 0.070)
IN_RIGHT = (0.05, -0.026, 0.125)
"""Place of the bottle's middle in the left palm, and of the cap in the right palm in a grasp of the neck, metres."""
FAR_RIGHT = (0.04, 0.075, -0.06)
"""Start of the right hand relative to that grasp: along the bottle's axis, along BACK, along the fingers; metres."""
OUT_NOISE, YAW_NOISE = 0.04, 0.25
"""Uniform perturbation of the bottle in the left hand: outwards by at most metres, yaw by radians either way."""
FINGERS = ("FF", "MF", "RF", "LF")
HOLDING = {f"{finger}{joint}": angle for finger in FINGERS for joint, angle in (("J2", 0.78), ("J1", 0.70))}
HOLDING |= {"THJ4": 0.6, "THJ3": 0.05, "THJ1": -0.3, "THJ0": -0.3}
"""Joint angles of the left hand around the bottle, rad."""
APPROACH = 0.3
"""Share of the way from the far start to the neck at which the near start lies."""


class Bottle:
    """The hands and the bottle. Without noise the right hand is 10 cm from the cap."""

    weights = {"reach": 0.5, "held": 0.5, "travel": 3.0, "original": 0.0}
    hold_steps = 1

    def __init__(self) -> None:
        self.model = model = compiled(_build())
        self.hands = shadow.Hands(model)
        self.robot = self.hands.robot
        self._bottle, self._cap = model.body("bottle").id, model.body("cap").id
        free, slide, twist = model.joint("bottle"), model.joint("cap"), model.joint("twist")
        self._place, self._velocity = int(free.qposadr[0]), int(free.dofadr[0])
        self._travel = int(slide.qposadr[0])
        self._cap_speed = [int(slide.dofadr[0]), int(twist.dofadr[0])]
        self._left = model.body("left/robot0:palm").id
        self._in_left = np.empty(4)
        mujoco.mju_negQuat(self._in_left, _hand_places()[1].quat())
        mujoco.mju_mulQuat(self._in_left, self._in_left, np.array(QUAT))
        cap = np.arange(model.ngeom) == model.geom("cap").id
        self._touch = Touch((self.hands.geoms["right"], cap))

    def reset(self, data: mujoco.MjData, rng: np.random.Generator | None) -> None:
        right, out, yaw = {}, 0.0, 0.0
        if rng is not None:
            right = dict(zip("xyz", APPROACH * _to_neck())) if rng.random() < NEAR else {}
            out, yaw = rng.uniform(0.0, OUT_NOISE), rng.uniform(-YAW_NOISE, YAW_NOISE)
        self.hands.start(data, right, HOLDING, rng, holding="left")
        x, y, z = IN_LEFT
        place, quat = np.split(data.qpos[self._place : self._place + 7], [3])  # views
        place[:] = data.xpos[self._left] + data.xmat[self._left].reshape(3, 3) @ (x - out, y, z)
        turn = np.array([np.cos(yaw / 2.0), 0.0, np.sin(yaw / 2.0), 0.0])  # yaw about the palm's normal
        mujoco.mju_mulQuat(quat, turn, self._in_left)
        mujoco.mju_mulQuat(quat, data.xquat[self._left], quat.copy())

    def entries(self, data: mujoco.MjData) -> dict[str, np.ndarray]:
        rotation = data.xmat[self._bottle].reshape(3, 3)
        bottle, cap = data.xpos[self._bottle], data.xpos[self._cap]
        palms, tips = self.hands.palms(data), self.hands.tips(data)
        return {
            "bottle_pos": bottle,
            "bottle_rot": rotation[:, 0],
            "bottle_vel": data.qvel[self._velocity : self._velocity + 6],
            "cap": data.qpos[[self._travel]] / TRAVEL,
            "cap_speed": data.qvel[self._cap_speed],
            "tips_to_cap": (cap - tips[0]).ravel(),
            "tips_to_bottle": (bottle - tips[1]).ravel(),
            "palms_to_bottle": (bottle - palms).ravel(),
            "touch": self._touch(data).astype(float),
        }

    def terms(self, data: mujoco.MjData) -> dict[str, float]:
        """Reward terms. `original` is the reward of Bi-DexHands."""
        bottle, cap = data.xpos[self._bottle], data.xpos[self._cap]
        far = shadow.distances(self.hands.tips(data)[0], cap)
        palm = float(shadow.distances(self.hands.palms(data)[1], bottle))
        travel = float(data.qpos[self._travel])
        return {
            "reach": closeness(far[:4].sum() / 4.0),
            "held": closeness(palm),
            "travel": min(max(travel / 0.03, 0.0), 1.0) * float(self._touch(data)[0]),
            "original": float(2.0 - far.sum() - palm + 30.0 * travel * (far.sum() <= 0.3)),
        }

    def met(self, data: mujoco.MjData) -> bool:
        return bool(data.qpos[self._travel] >= OFF)

    def failed(self, data: mujoco.MjData) -> bool:
        """Whether the bottle has fallen, or a hand is far from its part of the bottle."""
        cap, palms = data.xpos[self._cap], self.hands.palms(data)
        right, left = shadow.distances(palms, np.stack([cap, data.xpos[self._bottle]]))
        return bool(cap[2] < 0.5 or right > 0.5 or left > 0.2)


def _in_world(point: tuple[float, float, float], hand: shadow.HandPlace) -> np.ndarray:
    """A vector (3,) of the hand's frame, rotated into the world frame."""
    turned = np.empty(3)
    mujoco.mju_rotVecQuat(turned, np.array(point), hand.quat())
    return turned


def _to_neck() -> np.ndarray:
    """Vector (3,) in the world from the right hand's start to its grasp of the neck, metres."""
    return -np.stack([AXIS, BACK, [0.0, 1.0, 0.0]], axis=1) @ FAR_RIGHT


def _build() -> mujoco.MjSpec:
    spec = shadow.new_spec()
    bottle = spec.worldbody.add_body(name="bottle", pos=PLACE, quat=QUAT)
    bottle.add_freejoint(name="bottle")
    capsule, cylinder = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER
    look = {"rgba": (0.15, 0.5, 0.3, 1), **shadow.OBJECT}
    inside = BODY / 2.0 - RADIUS
    bottle.add_geom(type=capsule, fromto=(-inside, 0, 0, inside, 0, 0), size=(RADIUS, 0, 0), mass=0.15, **look)
    bottle.add_geom(
        type=capsule, fromto=(inside, 0, 0, BODY / 2.0 + NECK, 0, 0), size=(NECK_RADIUS, 0, 0), mass=0.02, **look
    )
    cap = bottle.add_body(name="cap", pos=(CAP_PLACE, 0, 0))
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    cap.add_joint(
        name="cap",
        type=slide,
        axis=(1, 0, 0),
        limited=True,
        range=(0, TRAVEL),
        damping=1.0,
        frictionloss=2.0,
        armature=0.01,
    )
    cap.add_joint(name="twist", type=hinge, axis=(1, 0, 0), damping=1e-3, armature=1e-4)
    top = np.array([-CAP / 2.0, 0, 0, CAP / 2.0, 0, 0])
    cap.add_geom(
        name="cap",
        type=cylinder,
        fromto=top,
        size=(CAP_RADIUS, 0, 0),
        mass=0.01,
        rgba=(0.95, 0.6, 0.1, 1),
        **shadow.OBJECT,
    )
    # the cork becomes visible when the cap is off; it has no contacts
    cork = np.array([-TRAVEL, 0, 0, 0, 0, 0])
    cap.add_geom(
        type=cylinder,
        fromto=cork,
        size=(0.8 * NECK_RADIUS, 0, 0),
        mass=0,
        rgba=(1, 0.85, 0.2, 1),
        contype=0,
        conaffinity=0,
    )
    shadow.add_hands(spec, *_hand_places())
    return spec


def _hand_places() -> tuple[shadow.HandPlace, shadow.HandPlace]:
    """Places of the right hand, behind the neck, and of the left hand, under the bottle."""
    ahead = np.array([0.0, 1.0, 0.0])
    right = shadow.HandPlace((0, 0, 0), tuple(ahead), tuple(BACK))
    down, level = np.sin(TILT), np.cos(TILT)
    left = shadow.HandPlace((0, 0, 0), tuple(down * BACK - level * ahead), tuple(level * BACK + down * ahead))
    at_neck = PLACE + CAP_PLACE * AXIS - _in_world(IN_RIGHT, right)
    return replace(right, palm=tuple(at_neck - _to_neck())), replace(left, palm=tuple(PLACE - _in_world(IN_LEFT, left)))


SCENE = Bottle
