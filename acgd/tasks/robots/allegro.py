"""An Allegro right hand of boxes and capsules, on a wrist with six servos.

Frame of the palm: +z along the fingers, +x out of the palm, +y to the side of the index finger. Lengths, masses and
limits are those of the real hand.
"""

from dataclasses import dataclass

import numpy as np

from acgd.tasks.simulator import mujoco

Vector = tuple[float, ...]

JOINTS = tuple(f"wrist_{axis}" for axis in ("x", "y", "z", "roll", "pitch", "yaw")) + tuple(
    f"{finger}_{i}" for finger in ("index", "middle", "ring", "thumb") for i in range(4)
)
"""Order of the 22 joints in `proprio`, and of the 22 actuators."""
TIPS = ("index_tip", "middle_tip", "ring_tip", "thumb_tip")
"""Sites at the centres of the fingertips."""
STRIDE = np.array([0.008] * 3 + [0.03] * 3)
"""(6,) largest change of the wrist targets in one control step, m and rad."""
FINGER_STRIDE = 0.08
"""Largest change of a finger target in one control step, in shares of the joint's range."""
SHELL, LINK, TIP = (0.34, 0.36, 0.42, 1.0), (0.50, 0.52, 0.57, 1.0), (0.95, 0.93, 0.86, 1.0)


@dataclass(frozen=True)
class Link:
    """A joint and the box that it moves."""

    at: Vector
    """Place of the joint in the frame of the link before it, metres."""
    axis: Vector
    limits: tuple[float, float]
    """Range of the joint, rad."""
    half: Vector
    """Half sizes of the box, metres. `centre`: its centre in the frame of the joint, metres."""
    centre: Vector
    mass: float
    """kg"""
    quat: Vector = (1.0, 0.0, 0.0, 0.0)


X, Y, Z = (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
"""Axes of the joints. The thumb's first joint turns about -x."""


def _finger(at: Vector, roll: float) -> tuple[Link, ...]:
    """Links of a finger at `at`, metres, rolled by `roll` rad about x."""
    tilt = (float(np.cos(roll / 2)), float(np.sin(roll / 2)), 0.0, 0.0)
    return (
        Link(at, Z, (-0.47, 0.47), (0.0098, 0.01375, 0.0082), (0, 0, 0.0082), 0.0119, tilt),
        Link((0, 0, 0.0164), Y, (-0.196, 1.61), (0.0098, 0.01375, 0.027), (0, 0, 0.027), 0.065),
        Link((0, 0, 0.054), Y, (-0.174, 1.709), (0.0098, 0.01375, 0.0192), (0, 0, 0.0192), 0.0355),
        Link((0, 0, 0.0384), Y, (-0.227, 1.618), (0.0098, 0.01375, 0.008), (0, 0, 0.008), 0.0096),
    )


FINGERS: dict[str, tuple[Link, ...]] = {
    "index": _finger((0, 0.0435, -0.001542), -0.08727),
    "middle": _finger((0, 0, 0.0007), 0.0),
    "ring": _finger((0, -0.0435, -0.001542), 0.08727),
    "thumb": (
        Link((-0.0182, 0.019333, -0.045987), X, (0.263, 1.396), (0.0179, 0.017, 0.02275), (-0.0179, 0.009, 0.0145),
             0.0176, (0.477714, -0.521334, -0.521334, -0.477714)),
        Link((-0.027, 0.005, 0.0399), Z, (-0.105, 1.163), (0.0098, 0.01375, 0.00885), (0, 0, 0.00885), 0.0119),
        Link((0, 0, 0.0177), Y, (-0.189, 1.644), (0.0098, 0.01375, 0.0257), (0, 0, 0.0257), 0.038),
        Link((0, 0, 0.0514), Y, (-0.162, 1.719), (0.0098, 0.01375, 0.0157), (0, 0, 0.0157), 0.0388),
    ),
}  # fmt: skip
TIP_RADIUS, TIP_MASS = 0.012, 0.0168
FINGER_TIP = (0.0267, 0.019, 0.010)
"""Along the last link, metres: centre of the tip, centre of its capsule, half length of the capsule."""
THUMB_TIP = (0.0423, 0.035, 0.008)


def add_hand(spec: mujoco.MjSpec, pos: Vector, quat: Vector, travel: np.ndarray) -> None:
    """Adds the hand. At wrist joints of zero the palm is at `pos`, metres, with orientation `quat`.

    The wrist slides along the world's axes, then turns about the palm's axes. travel: (6, 2) ranges of the wrist
    joints, m and rad.
    """
    palm = spec.worldbody.add_body(name="palm", pos=pos, quat=quat, gravcomp=1)
    to_palm = np.zeros(9)
    mujoco.mju_quat2Mat(to_palm, np.asarray(quat, float))
    axes = [*to_palm.reshape(3, 3), *np.eye(3)]  # a row of the matrix is a world axis in the palm's frame
    for i, (name, axis, limits) in enumerate(zip(JOINTS, axes, travel)):
        kind = mujoco.mjtJoint.mjJNT_SLIDE if i < 3 else mujoco.mjtJoint.mjJNT_HINGE
        palm.add_joint(name=name, type=kind, axis=axis, range=limits, limited=True, armature=0.1 if i < 3 else 0.005)
        gains = (600.0, 40.0, 60.0) if i < 3 else (20.0, 1.0, 6.0)
        _servo(spec, name, limits, *gains)
    _box(palm, "palm", (0.0204, 0.0565, 0.0475), (-0.0093, 0, -0.0475), 0.4154, SHELL)
    for finger, links in FINGERS.items():
        body = palm
        for i, link in enumerate(links):
            name = f"{finger}_{i}"
            body = body.add_body(name=name, pos=link.at, quat=link.quat, gravcomp=1)
            body.add_joint(name=name, axis=link.axis, range=link.limits, limited=True, damping=0.1, armature=0.002)
            _box(body, name, link.half, link.centre, link.mass, LINK if i else SHELL)
            _servo(spec, name, link.limits, 3.0, 0.0, 0.7)
        tip, centre, half = THUMB_TIP if finger == "thumb" else FINGER_TIP
        body.add_geom(
            name=f"{finger}_tip",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=(TIP_RADIUS, half, 0),
            pos=(0, 0, centre),
            mass=TIP_MASS,
            rgba=TIP,
        )
        body.add_site(name=f"{finger}_tip", pos=(0, 0, tip), group=3)
        spec.add_exclude(bodyname1="palm", bodyname2=f"{finger}_0")
    spec.add_exclude(bodyname1="palm", bodyname2="thumb_1")


def stride(model: mujoco.MjModel) -> np.ndarray:
    """(22,) change of each target by an action of 1, m and rad."""
    ranges = np.diff(model.actuator_ctrlrange[len(STRIDE) : len(JOINTS)]).ravel()
    return np.concatenate([STRIDE, FINGER_STRIDE * ranges])


def _box(body, name: str, half: Vector, centre: Vector, mass: float, rgba: Vector) -> None:
    body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=centre, mass=mass, rgba=rgba)


def _servo(spec: mujoco.MjSpec, joint: str, limits, kp: float, kv: float, force: float) -> None:
    """Adds a position servo. kp in N/m or N m/rad, kv in N s/m or N m s/rad, force (largest) in N or N m."""
    servo = spec.add_actuator(
        name=joint,
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        ctrlrange=limits,
        ctrllimited=True,
        forcerange=(-force, force),
        forcelimited=True,
    )
    servo.set_to_position(kp=kp, kv=kv)
