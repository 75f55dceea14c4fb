"""Two Shadow Hands with floating bases: the robot of the BiDex suite.

Description and meshes of the hand are files of the gymnasium-robotics package, which is not imported. Both are right
hands, as in Bi-DexHands. A base has three slides along the world's axes and three hinges at the palm. A hand has 20
motors; tendons couple the four outermost joints to their neighbours.
"""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from acgd.tasks.scene import Robot, rest
from acgd.tasks.simulator import mujoco

SIDES = ("right", "left")
"""Order of the hands in actions and observations, and prefixes of their names."""
BASE = ("x", "y", "z", "roll", "pitch", "yaw")
FINGERS = ("ff", "mf", "rf", "lf", "th")
"""Order of fingertips: index to little finger, thumb."""

JOINTS = (
    *BASE, "WRJ1", "WRJ0",
    "FFJ3", "FFJ2", "FFJ1", "FFJ0", "MFJ3", "MFJ2", "MFJ1", "MFJ0", "RFJ3", "RFJ2", "RFJ1", "RFJ0",
    "LFJ4", "LFJ3", "LFJ2", "LFJ1", "LFJ0", "THJ4", "THJ3", "THJ2", "THJ1", "THJ0",
)  # fmt: skip
"""Order of a hand's 30 joints in `proprio`."""
_SLIDES = [*range(3), *range(len(JOINTS), len(JOINTS) + 3)]
COUPLED = [i for i, name in enumerate(JOINTS) if name.endswith("J0") and name[:2] not in ("WR", "TH")]
"""Indices of the outermost joints, which tendons couple to the joint before."""
MOTORS = tuple(name for i, name in enumerate(JOINTS) if i not in COUPLED)
"""Order of a hand's 26 motors in actions."""
BASE_SLIDE, BASE_TURN, FINGER_TURN = 0.008, 0.03, 0.08
"""Change of a target by an action of 1 in one control step: metres, radians, share of the joint's range."""
START_SLIDE, START_NOISE = 0.015, 0.05
"""Uniform noise of a start: place of a base in metres, all angles in shares of their range."""

TIP = (0.0, 0.0, 0.02)
"""Place of a fingertip in its last link, metres, as in Bi-DexHands."""
PALM = (0.0, -0.02, 0.08)
"""Place of the palm's middle in its link, metres."""
OBJECT = {"contype": 2, "conaffinity": 1}
TABLE = {"contype": 0, "conaffinity": 3}
"""Contacts: hands (contype 1, conaffinity 0) and objects collide with the table and with each other. Hands do not
collide with hands, nor objects with objects."""
_PALM_IN_MOUNT = (0.0, 0.01, 0.29)
_SLIDE = {"reach": 0.25, "kp": 1500.0, "kv": 80.0, "force": 150.0, "armature": 0.5}
_HINGE = {"reach": 0.6, "kp": 60.0, "kv": 3.0, "force": 20.0, "armature": 0.02}
"""Motors of a base. reach: largest deflection in both directions, m and rad."""


@dataclass(frozen=True)
class HandPlace:
    """Pose of a hand at base joints of zero."""

    palm: tuple[float, float, float]
    """Origin of the palm's link in the world, metres."""
    fingers: tuple[float, float, float]
    """Unit vector along the outstretched fingers, in the world."""
    back: tuple[float, float, float]
    """Unit vector out of the back of the hand, in the world."""

    def quat(self) -> np.ndarray:
        """Quaternion (4,) of the hand's frame: x to the thumb's side, y out of the back, z along the fingers."""
        y, z = np.asarray(self.back, float), np.asarray(self.fingers, float)
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, np.stack([np.cross(y, z), y, z], axis=1).ravel())
        return quat


def hand_file() -> Path:
    """The Shadow Hand's MJCF file in the installed gymnasium-robotics. FileNotFoundError without it."""
    package = find_spec("gymnasium_robotics")
    folder = package.submodule_search_locations[0] if package else "gymnasium_robotics"
    file = Path(folder, "envs/assets/hand/reach.xml")
    if not file.is_file():
        raise FileNotFoundError(
            f"The BiDex tasks need the Shadow Hand's model, which comes with gymnasium-robotics: there is no {file}. "
            "Install it with: pip install --force-reinstall --no-deps gymnasium-robotics==1.4.2"
        )
    return file


def new_spec() -> mujoco.MjSpec:
    """An empty scene with the settings of the hands."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    _same_settings(spec)
    return spec


def add_table(spec: mujoco.MjSpec, half_size: tuple[float, float], height: float) -> None:
    """Adds a table at the world's origin. half_size: of its top, metres. height: of its top, metres."""
    half = height / 2.0
    spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(*half_size, half),
        pos=(0, 0, half),
        rgba=(0.42, 0.33, 0.25, 1),
        **TABLE,
    )


def add_hands(spec: mujoco.MjSpec, right: HandPlace, left: HandPlace) -> None:
    """Adds both hands to a scene of `new_spec`."""
    file = str(hand_file())
    for side, place in zip(SIDES, (right, left)):
        base = spec.worldbody.add_body(name=f"{side}/base", pos=place.palm, gravcomp=1.0)
        base.mass, base.inertia, base.explicitinertial = 0.01, (1e-5,) * 3, True
        for i, name in enumerate(BASE):
            _add_base_joint(spec, base, f"{side}/{name}", i)
        quat = place.quat()
        offset = np.empty(3)
        mujoco.mju_rotVecQuat(offset, -np.array(_PALM_IN_MOUNT), quat)
        hand = _load_hand(file)
        base.add_frame(pos=offset, quat=quat).attach_body(hand.body("robot0:hand mount"), f"{side}/", "")


def _add_base_joint(spec: mujoco.MjSpec, base, name: str, i: int) -> None:
    kind, servo = (mujoco.mjtJoint.mjJNT_SLIDE, _SLIDE) if i < 3 else (mujoco.mjtJoint.mjJNT_HINGE, _HINGE)
    reach = servo["reach"]
    base.add_joint(
        name=name, type=kind, axis=np.eye(3)[i % 3], range=(-reach, reach), limited=True, armature=servo["armature"]
    )
    motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.set_to_position(kp=servo["kp"], kv=servo["kv"])
    motor.ctrllimited = motor.forcelimited = True
    motor.ctrlrange, motor.forcerange = (-reach, reach), (-servo["force"], servo["force"])


def _load_hand(file: str) -> mujoco.MjSpec:
    """The spec of one hand, without sensors, measuring tendons, and the placement of its file."""
    hand = mujoco.MjSpec.from_file(file)
    _same_settings(hand)
    for sensor in list(hand.sensors):
        hand.delete(sensor)
    for tendon in list(hand.tendons):
        if not tendon.name.endswith("J1c"):  # J1c tendons couple a finger's last joint to the joint before it
            hand.delete(tendon)
    for finger in FINGERS:
        hand.body(f"robot0:{finger}distal").add_site(name=f"tip/{finger}", pos=TIP, group=5)
    hand.body("robot0:palm").add_site(name="palm", pos=PALM, group=5)
    mount = hand.body("robot0:hand mount")
    mount.pos, mount.quat = (0, 0, 0), (1, 0, 0, 0)
    mount.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT  # the Euler angles would override the quaternion
    for body in hand.bodies:
        body.gravcomp = 1.0
        for joint in body.joints:
            joint.frictionloss = 0.0
        for geom in body.geoms:
            if geom.type == mujoco.mjtGeom.mjGEOM_MESH and geom.contype == 0:
                geom.group = 0  # the rendered group
    return hand


def _same_settings(spec: mujoco.MjSpec) -> None:
    """Sets options that must agree between merged specs. MuJoCo otherwise takes the smaller time step."""
    spec.option.timestep, spec.option.iterations = 0.005, 20
    spec.njmax = spec.nconmax = -1
    spec.nuser_jnt = spec.nuser_site = spec.nuser_tendon = spec.nuser_sensor = spec.nuser_actuator = -1


class Hands:
    """Both hands of a compiled scene: their places and their starts."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        joints = [f"{side}/{name if name in BASE else f'robot0:{name}'}" for side in SIDES for name in JOINTS]
        low, high = model.actuator_ctrlrange.T
        base = np.r_[np.full(3, BASE_SLIDE), np.full(3, BASE_TURN)]
        stride = np.concatenate([np.r_[base, FINGER_TURN * s[6:]] for s in np.split(high - low, len(SIDES))])
        self.robot = Robot.of(model, joints, stride)
        self._range = model.jnt_range[[model.joint(name).id for name in joints]].T
        self._tips = np.array([[model.site(f"{side}/tip/{finger}").id for finger in FINGERS] for side in SIDES])
        self._palms = np.array([model.site(f"{side}/palm").id for side in SIDES])
        self.geoms = {side: _geoms(model, f"{side}/") for side in SIDES}
        """Side -> (ngeom,) bool, geoms of the hand."""

    def tips(self, data: mujoco.MjData) -> np.ndarray:
        """Fingertips (2, 5, 3) in the world, metres, ordered as SIDES and FINGERS."""
        return data.site_xpos[self._tips]

    def palms(self, data: mujoco.MjData) -> np.ndarray:
        """Middles of the palms (2, 3) in the world, metres."""
        return data.site_xpos[self._palms]

    def start(
        self,
        data: mujoco.MjData,
        right: dict[str, float],
        left: dict[str, float],
        rng: np.random.Generator | None,
        holding: str | None = None,
    ) -> None:
        """Writes a start into `data`, and computes its kinematics.

        right, left: joint -> position, m or rad; other joints are 0. rng: source of noise; None for none. holding: the
        hand that holds an object; only its base gets noise.
        """
        pose = np.array([joints.get(name, 0.0) for joints in (right, left) for name in JOINTS])
        if rng is not None:
            spread = START_NOISE * np.ptp(self._range, axis=0)
            spread[_SLIDES] = START_SLIDE
            for side, fingers in zip(SIDES, np.split(spread, len(SIDES))):
                fingers[len(BASE) :] *= side != holding
            pose += rng.uniform(-spread, spread)
        pose = np.clip(pose, *self._range)
        for hand in np.split(pose, len(SIDES)):
            for last in COUPLED:
                hand[last] = hand[last - 1]
        data.qpos[self.robot.qpos] = pose
        data.ctrl[:] = rest(self._model, data)


def _geoms(model: mujoco.MjModel, prefix: str) -> np.ndarray:
    return np.array([model.body(model.geom_bodyid[i]).name.startswith(prefix) for i in range(model.ngeom)])


def distances(points: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Distances (...,) in metres from points (..., 3) to places, which broadcast against the points."""
    away = points - place
    return np.sqrt(np.einsum("...i,...i", away, away))
