"""OpDex: grasp a spray bottle by its neck and press the trigger, without toppling the bottle.

World frame: the bottle sprays along +x, +z is up, and the table's top is z = 0. The hand approaches from -y with its
palm towards +y and its index finger on top.
"""

import math
from dataclasses import dataclass

import numpy as np

from acgd.tasks.robots import allegro
from acgd.tasks.scene import NEAR, Robot, Touch, closeness, compiled, rest
from acgd.tasks.simulator import mujoco


@dataclass(frozen=True)
class Bottle:
    """Sizes in metres. The trigger hangs from the head, `REACH_OUT` in front of the neck's axis."""

    half: tuple[float, float, float]
    """Half sizes of the body; of a round one radius, radius, half height."""
    round: bool
    neck_radius: float
    trigger: float
    """Length of the trigger and of the neck."""

    @property
    def shoulder(self) -> float:
        """Height of the top of the body, where the neck begins."""
        return 2 * self.half[2]


REACH_OUT = 0.05
"""Distance of the trigger's hinge from the neck's axis, metres."""
TRAVEL = 0.5
"""Largest angle of the trigger, rad."""
PRESSED = 0.35
"""Angle of the trigger above which the bottle sprays, rad."""
HOLD_STEPS = 10
"""Consecutive control steps of spraying that solve the task."""
UPRIGHT, TOPPLED = 0.9, 0.8
"""Cosines of the bottle's tilt: an upright bottle lies above the first, a toppled one below the second."""
TABLE = 0.35
"""Half the side of the table, metres."""

GRASP = np.array([0.05, 0.0, 0.0])
"""Place of the neck's axis in the palm's frame in a grasp, metres."""
PALM = (0.5, 0.5, 0.5, 0.5)
"""Orientation of the palm at wrist angles of zero: palm +x is world +y, +y is +z, +z is +x."""
WRIST = np.array([(-0.20, 0.15), (-0.25, 0.10), (-0.10, 0.15), (-0.6, 0.6), (-0.6, 0.6), (-0.6, 0.6)])
"""Ranges of the wrist joints, m and rad, relative to the place where the neck is at GRASP."""
OPEN = np.array([0, 0.0, 0.4, 0.3] * 3 + [1.2, 0.3, 0.1, 0.1])
"""Finger angles (16,) at the start, rad."""
NEAR_WRIST = np.array([-0.05, -0.12, 0.0, 0, 0, 0])
FAR_WRIST = np.array([-0.06, -0.22, 0.06, 0, 0, 0])
"""Wrist joints (6,) of near and far starts, m and rad."""
WRIST_NOISE, JOINT_NOISE = 0.015, 0.05
"""Uniform noise of a start: wrist position in metres, finger angles in shares of their range."""
PLACE_NOISE, YAW_NOISE, TRIGGER_NOISE = 0.05, 0.5, 0.05
"""Uniform noise of the bottle: place in metres, yaw and trigger in rad."""


class SprayScene:
    """A bottle, a table and an Allegro hand."""

    weights = {"palm": 0.5, "fingers": 0.5, "grip": 0.5, "trigger": 3.0, "tilt": -2.0}
    hold_steps = HOLD_STEPS

    def __init__(self, bottle: Bottle) -> None:
        self.bottle = bottle
        self.model = model = _build(bottle)
        self.robot = Robot.of(model, list(allegro.JOINTS), allegro.stride(model))
        self._tips = [model.site(name).id for name in allegro.TIPS]
        self._neck, self._grip, self._palm = model.site("neck").id, model.site("trigger").id, model.site("grasp").id
        self._body, self._hand = model.body("bottle").id, model.body("palm").id
        self._place = model.joint("bottle").qposadr[0]
        self._motion = model.joint("bottle").dofadr[0]
        self._trigger, self._trigger_speed = model.joint("trigger").qposadr[0], model.joint("trigger").dofadr[0]
        bodies, geoms = _names(model.body, model.geom_bodyid), _names(model.geom, range(model.ngeom))
        neck, trigger = np.isin(geoms, ("neck", "head")), geoms == "trigger"
        thumb = np.char.startswith(bodies, "thumb")
        finger = (
            np.char.startswith(bodies, "index")
            | np.char.startswith(bodies, "middle")
            | np.char.startswith(bodies, "ring")
        )
        self._touch = Touch((thumb, neck), (finger, neck | trigger), (finger, trigger))

    def reset(self, data: mujoco.MjData, rng: np.random.Generator | None) -> None:
        """Starts with an open hand, near or far from the neck, and an upright bottle with its nozzle towards +x."""
        wrist, fingers, place = FAR_WRIST.copy(), OPEN.copy(), np.zeros(4)
        if rng is not None:
            near = rng.random() < NEAR
            wrist = (NEAR_WRIST if near else FAR_WRIST).copy()
            wrist[:3] += rng.uniform(-WRIST_NOISE, WRIST_NOISE, 3)
            low, high = self.model.actuator_ctrlrange[6:].T
            fingers = np.clip(fingers + rng.uniform(-JOINT_NOISE, JOINT_NOISE, 16) * (high - low), low, high)
            place = rng.uniform(-1, 1, 4) * [PLACE_NOISE, PLACE_NOISE, YAW_NOISE, TRIGGER_NOISE]
        data.qpos[self.robot.qpos] = np.concatenate([wrist, fingers])
        data.qpos[self._place : self._place + 2] = place[:2]
        data.qpos[self._place + 3 : self._place + 7] = [np.cos(place[2] / 2), 0, 0, np.sin(place[2] / 2)]
        data.qpos[self._trigger] = abs(place[3])
        data.ctrl[:] = rest(self.model, data)

    def entries(self, data: mujoco.MjData) -> dict[str, np.ndarray]:
        """Name -> entries. Rotations are two rows of the matrix; vectors are in the world frame, in m and m/s.

        `touch` (3,): thumb and neck; a finger and neck or trigger; a finger and trigger.
        """
        neck, tips = data.site_xpos[self._neck], data.site_xpos[self._tips]
        return {
            "bottle_pos": data.xpos[self._body],
            "bottle_rot": data.xmat[self._body, :6],
            "bottle_vel": data.qvel[self._motion : self._motion + 6],
            "trigger": data.qpos[self._trigger : self._trigger + 1],
            "trigger_vel": data.qvel[self._trigger_speed : self._trigger_speed + 1],
            "palm_rot": data.xmat[self._hand, :6],
            "palm_neck": neck - data.site_xpos[self._palm],
            "tips_neck": (neck - tips).ravel(),
            "tips_trigger": (data.site_xpos[self._grip] - tips).ravel(),
            "touch": self._touch(data),
        }

    def terms(self, data: mujoco.MjData) -> dict[str, float]:
        """Reward terms. All but `tilt`, which is 1 minus the cosine of the tilt, lie in [0, 1]."""
        grip, index, middle = data.site_xpos[[self._grip, *self._tips[:2]]]
        thumb, finger, _ = self._touch(data)
        return {
            "palm": closeness(math.dist(data.site_xpos[self._neck], data.site_xpos[self._palm])),
            "fingers": closeness((math.dist(grip, index) + math.dist(grip, middle)) / 2),
            "grip": float(thumb and finger),
            "trigger": min(max(float(data.qpos[self._trigger]) / PRESSED, 0.0), 1.0),
            "tilt": 1.0 - self._upright(data),
        }

    def met(self, data: mujoco.MjData) -> bool:
        """Whether the trigger is pressed and the bottle is upright."""
        return bool(data.qpos[self._trigger] > PRESSED and self._upright(data) > UPRIGHT)

    def failed(self, data: mujoco.MjData) -> bool:
        """Whether the bottle has toppled or left the table."""
        return bool(self._upright(data) < TOPPLED or max(map(abs, data.xpos[self._body, :2])) > TABLE)

    def _upright(self, data: mujoco.MjData) -> float:
        return float(data.xmat[self._body, 8])


def _names(of, ids) -> np.ndarray:
    return np.array([of(int(i)).name for i in ids])


def _build(bottle: Bottle) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.worldbody.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(TABLE, TABLE, 0.01), rgba=(0.55, 0.47, 0.38, 1)
    )
    _add_bottle(spec, bottle)
    height = bottle.shoulder + 0.2 * bottle.trigger
    allegro.add_hand(spec, (-GRASP[2], -GRASP[0], height), PALM, WRIST)
    spec.body("palm").add_site(name="grasp", pos=GRASP, group=3)
    return compiled(spec)


def _add_bottle(spec: mujoco.MjSpec, bottle: Bottle) -> None:
    """Adds a free bottle of 0.36 kg (body, neck, head), and a trigger on a hinge with a spring."""
    body = spec.worldbody.add_body(name="bottle")
    body.add_freejoint(name="bottle")
    shape = mujoco.mjtGeom.mjGEOM_CYLINDER if bottle.round else mujoco.mjtGeom.mjGEOM_BOX
    size = (bottle.half[0], bottle.half[2], 0) if bottle.round else bottle.half
    top = bottle.shoulder + bottle.trigger
    blue, yellow, red = (0.16, 0.45, 0.80, 1), (0.95, 0.75, 0.20, 1), (0.90, 0.15, 0.10, 1)
    capsule, box = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX
    body.add_geom(name="body", type=shape, size=size, pos=(0, 0, bottle.half[2]), mass=0.30, rgba=blue)
    body.add_geom(
        name="neck",
        type=capsule,
        size=(bottle.neck_radius, 0, 0),
        fromto=(0, 0, bottle.shoulder, 0, 0, top),
        mass=0.02,
        rgba=yellow,
    )
    body.add_geom(name="head", type=box, size=(0.045, 0.014, 0.012), pos=(0.02, 0, top + 0.012), mass=0.03, rgba=yellow)
    body.add_site(name="neck", pos=(0, 0, bottle.shoulder + 0.5 * bottle.trigger), group=3)
    trigger = body.add_body(name="trigger", pos=(REACH_OUT, 0, top))
    trigger.add_joint(
        name="trigger",
        axis=(0, 1, 0),
        range=(0, TRAVEL),
        limited=True,
        stiffness=0.2,
        springref=-0.15,
        damping=0.01,
        armature=1e-4,
    )
    trigger.add_geom(
        name="trigger", type=capsule, size=(0.006, 0, 0), fromto=(0, 0, 0, 0, 0, -bottle.trigger), mass=0.01, rgba=red
    )
    trigger.add_site(name="trigger", pos=(0, 0, -0.6 * bottle.trigger), group=3)
