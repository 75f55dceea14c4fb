"""BiDex Switch: turn on two switches on a table, one with each hand."""

import numpy as np

from acgd.tasks.rendering.camera import Camera
from acgd.tasks.robots import shadow
from acgd.tasks.scene import NEAR, closeness, compiled
from acgd.tasks.simulator import mujoco

CAMERA = Camera((0.02, 0.0, 0.71), 0.68, 0.0, -33.0)
TABLE = 0.55
"""Height of the table, metres."""
OFF = 0.5585
"""Angle of a rocker in the off position, radians. The on position is 0."""
PRESSED = 0.8
"""Share of the travel above which a switch counts as on."""
HOUSING = (0.0725, 0.05, 0.0715)
ROCKER = (0.05, 0.03, 0.012)
PIVOT = (0.011, 0.0, 0.142)
HANDLE = (0.042, 0.0, 0.012)
"""Half sizes of housing and rocker, and places of pivot and handle in their frames, metres. The handle is the point to
press."""
PLACES = ((0.0, 0.2), (0.0, -0.2))
"""Places of the switches, that of the right hand first, metres."""
PLACE_NOISE, YAW_NOISE, ANGLE_NOISE = 0.05, 0.4, 0.05
"""Uniform noise of a perturbed start: place in metres, yaw in radians, angle in shares of a rocker's travel."""
NEAR_POSE = {"x": -0.045, "z": 0.05} | {f"{finger}J2": 0.4 for finger in ("FF", "MF", "RF", "LF")}
"""Joints of near starts: fingertips some centimetres above the raised ends of the rockers."""


class Switch:
    """The hands, and two rockers that keep their angle. Without noise the straight fingers are 9 cm above."""

    weights = {"reach": 0.5, "travel": 1.5, "original": 0.0}
    hold_steps = 1

    def __init__(self) -> None:
        self.model = model = compiled(_build())
        self.hands = shadow.Hands(model)
        self.robot = self.hands.robot
        rockers = [model.joint(f"rocker/{side}") for side in shadow.SIDES]
        self._angles, self._speeds = ([j.qposadr[0] for j in rockers], [j.dofadr[0] for j in rockers])
        self._handles = [model.site(f"handle/{side}").id for side in shadow.SIDES]

    def reset(self, data: mujoco.MjData, rng: np.random.Generator | None) -> None:
        data.qpos[self._angles] = OFF
        pose = {}
        if rng is not None:
            pose = NEAR_POSE if rng.random() < NEAR else {}
            data.qpos[self._angles] = OFF * (1.0 - rng.uniform(0.0, ANGLE_NOISE, 2))
            data.mocap_pos[:, :2] += rng.uniform(-PLACE_NOISE, PLACE_NOISE, (2, 2))
            half = rng.uniform(-YAW_NOISE, YAW_NOISE, 2) / 2.0
            data.mocap_quat[:, 0], data.mocap_quat[:, 3] = np.cos(half), np.sin(half)
        self.hands.start(data, pose, pose, rng)

    def entries(self, data: mujoco.MjData) -> dict[str, np.ndarray]:
        handles = data.site_xpos[self._handles]
        return {
            "switch_yaw": 2.0 * data.mocap_quat[:, 3],
            "handle": handles.ravel(),
            "rocker": data.qpos[self._angles],
            "rocker_speed": data.qvel[self._speeds],
            "tips_to_handle": (handles[:, None] - self.hands.tips(data)).ravel(),
        }

    def terms(self, data: mujoco.MjData) -> dict[str, float]:
        """Reward terms. `original` is the reward of Bi-DexHands."""
        handles = data.site_xpos[self._handles]
        far = shadow.distances(self.hands.tips(data), handles[:, None])
        return {
            "reach": float(sum(closeness(d / 4.0) for d in far[:, :4].sum(axis=1))),  # without the thumb
            "travel": float(self._travel(data).sum()),
            "original": float(2.0 - far.sum() + 50.0 * (1.4 - handles[:, 2].sum())),
        }

    def met(self, data: mujoco.MjData) -> bool:
        return bool((self._travel(data) >= PRESSED).all())

    def failed(self, data: mujoco.MjData) -> bool:
        return False

    def _travel(self, data: mujoco.MjData) -> np.ndarray:
        """Share (2,) of the travel of each rocker, in [0, 1]."""
        return np.clip(1.0 - data.qpos[self._angles] / OFF, 0.0, 1.0)


def _build() -> mujoco.MjSpec:
    spec = shadow.new_spec()
    shadow.add_table(spec, (0.25, 0.5), TABLE)
    for side, place in zip(shadow.SIDES, PLACES):
        # a mocap body is static, and its place is part of the state
        switch = spec.worldbody.add_body(name=f"switch/{side}", pos=(*place, TABLE), mocap=True)
        box = mujoco.mjtGeom.mjGEOM_BOX
        switch.add_geom(type=box, size=HOUSING, pos=(0, 0, HOUSING[2]), rgba=(0.16, 0.28, 0.45, 1), **shadow.OBJECT)
        rocker = switch.add_body(name=f"rocker/{side}", pos=PIVOT)
        rocker.add_joint(
            name=f"rocker/{side}",
            axis=(0, -1, 0),
            limited=True,
            range=(0, OFF),
            damping=0.02,
            frictionloss=0.15,
            armature=0.001,
        )
        rocker.add_geom(type=box, size=ROCKER, mass=0.05, rgba=(0.9, 0.35, 0.1, 1), **shadow.OBJECT)
        near = (
            ROCKER[0] / 2.0,
            ROCKER[1],
            ROCKER[2],
        )  # hidden in the housing while the switch is off, so that pictures show the state
        rocker.add_geom(
            type=box,
            size=np.array(near) + 2e-4,
            pos=(-near[0], 0, 0),
            mass=0,
            rgba=(0.2, 0.9, 0.3, 1),
            contype=0,
            conaffinity=0,
        )
        rocker.add_site(name=f"handle/{side}", pos=HANDLE, group=5)
    ahead, up = (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    right, left = (shadow.HandPlace((0.26, y, 0.81), fingers=ahead, back=up) for y in (0.2, -0.2))
    shadow.add_hands(spec, right, left)
    return spec


SCENE = Switch
