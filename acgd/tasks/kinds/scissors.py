"""BiDex Scissors: open a large pair of scissors on a table by pulling its handles apart, one with each hand."""

import numpy as np

from acgd.tasks.rendering.camera import Camera
from acgd.tasks.robots import shadow
from acgd.tasks.scene import NEAR, closeness, compiled
from acgd.tasks.simulator import mujoco

CAMERA = Camera((0.05, 0.0, 0.64), 0.7, 0.0, -50.0)
TABLE = 0.6
"""Height of the table, metres."""
CLOSED, OPEN = -0.59, -0.3
"""Angles of the hinge, radians: at the start, and above which the scissors count as open."""
WIDE = 0.4
"""Largest angle of the hinge, radians."""
HINGE = (-0.07, 0.0, 0.0)
"""Place of the hinge in the frame of the scissors, whose x axis points at the hands, metres."""
BLADE, WIDTH, HALF = 0.23, 0.012, 0.006
"""Length and half width of a blade, and half the thickness of all parts, metres."""
RING = ((0.13, 0.012), (0.13, 0.134), (0.245, 0.134), (0.245, 0.012))
"""Corners of the right handle relative to the hinge, metres. The left handle is the mirror image."""
FEET = ((-0.12, 0.0), RING[1], RING[2])
"""Points at which a half touches the table, relative to the hinge, metres. Flat parts would have forty contacts."""
GRIP = (0.1875, 0.073, 0.0)
"""Middle of the right handle, where the fingers go, metres."""
PLACE_NOISE, YAW_NOISE = (0.06, 0.12), 0.7
"""Uniform noise of a perturbed start: place along x and y in metres, yaw in radians."""
_BENT = {f"{finger}J2": 0.7 for finger in ("FF", "MF", "RF", "LF")}
NEAR_RIGHT = {"x": -0.03, "y": -0.13, "z": -0.02} | _BENT
NEAR_LEFT = {"x": -0.03, "y": 0.13, "z": -0.02} | _BENT
"""Joints of near starts: half bent fingers, some centimetres above the handles."""


class Scissors:
    """The hands and the free scissors. Without noise the straight fingers are 20 cm above the table."""

    weights = {"reach": 0.5, "opening": 3.0, "original": 0.0}
    hold_steps = 1

    def __init__(self) -> None:
        self.model = model = compiled(_build())
        self.hands = shadow.Hands(model)
        self.robot = self.hands.robot
        self._body = model.body("scissors").id
        free, hinge = model.joint("scissors"), model.joint("hinge")
        self._place, self._velocity = int(free.qposadr[0]), int(free.dofadr[0])
        self._angle, self._speed = int(hinge.qposadr[0]), int(hinge.dofadr[0])
        self._handles = [model.site(f"handle/{side}").id for side in shadow.SIDES]

    def reset(self, data: mujoco.MjData, rng: np.random.Generator | None) -> None:
        right, left = {}, {}
        if rng is not None:
            if rng.random() < NEAR:
                right, left = NEAR_RIGHT, NEAR_LEFT
            data.qpos[self._place : self._place + 2] += rng.uniform(-1.0, 1.0, 2) * PLACE_NOISE
            half = rng.uniform(-YAW_NOISE, YAW_NOISE) / 2.0
            data.qpos[self._place + 3 : self._place + 7] = np.cos(half), 0.0, 0.0, np.sin(half)
        self.hands.start(data, right, left, rng)

    def entries(self, data: mujoco.MjData) -> dict[str, np.ndarray]:
        rotation = data.xmat[self._body].reshape(3, 3)
        handles = data.site_xpos[self._handles]
        return {
            "scissors_pos": data.xpos[self._body],
            "scissors_rot": rotation[:, [0, 2]].T.ravel(),
            "scissors_vel": data.qvel[self._velocity : self._velocity + 6],
            "hinge": data.qpos[[self._angle]],
            "hinge_speed": data.qvel[[self._speed]],
            "tips_to_handle": (handles[:, None] - self.hands.tips(data)).ravel(),
        }

    def terms(self, data: mujoco.MjData) -> dict[str, float]:
        """Reward terms. `original` is the reward of Bi-DexHands."""
        handles = data.site_xpos[self._handles]
        far = shadow.distances(self.hands.tips(data), handles[:, None])
        opened = float(data.qpos[self._angle]) - CLOSED
        return {
            "reach": float(sum(closeness(d / 4.0) for d in far[:, :4].sum(axis=1))),  # without the thumb
            "opening": min(max(opened / 0.6, 0.0), 1.0),
            "original": float(2.0 - far.sum() + 5.0 * opened * (far.sum(axis=1) < 0.7).all()),
        }

    def met(self, data: mujoco.MjData) -> bool:
        return bool(data.qpos[self._angle] > OPEN)

    def failed(self, data: mujoco.MjData) -> bool:
        """Whether the scissors have fallen from the table."""
        return bool(data.xpos[self._body, 2] < TABLE - 0.1)


def _build() -> mujoco.MjSpec:
    spec = shadow.new_spec()
    shadow.add_table(spec, (0.25, 0.5), TABLE)
    scissors = spec.worldbody.add_body(name="scissors", pos=(0, 0, TABLE + HALF))
    scissors.add_freejoint(name="scissors")
    _add_half(scissors, HINGE, 1.0, "right", (0.75, 0.15, 0.12, 1))
    other = scissors.add_body(name="scissors/left", pos=HINGE)
    other.add_joint(
        name="hinge",
        axis=(0, 0, -1),
        limited=True,
        range=(CLOSED - 0.007, WIDE),
        ref=CLOSED,
        damping=0.02,
        frictionloss=0.02,
        armature=0.001,
    )
    _add_half(other, (0.0, 0.0, 0.0), -1.0, "left", (0.95, 0.7, 0.1, 1))
    ahead, up = (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    right, left = (shadow.HandPlace((0.26, y, 0.81), fingers=ahead, back=up) for y in (0.2, -0.2))
    shadow.add_hands(spec, right, left)
    return spec


def _add_half(body, hinge: tuple[float, float, float], sign: float, side: str, colour: tuple[float, ...]) -> None:
    """Adds a blade and a handle at `hinge`. The handle lies on the side of `sign` * y."""
    box, hinge = mujoco.mjtGeom.mjGEOM_BOX, np.array(hinge)
    look = {"type": box, "rgba": colour, "contype": 0, "conaffinity": 1}
    blade = hinge + (-BLADE / 2.0, 0.0, -sign * HALF / 2.0)  # one blade lies above the other
    body.add_geom(size=(BLADE / 2.0, WIDTH, HALF / 2.0), pos=blade, mass=0.05, **look)
    corners = [hinge + (x, sign * y, 0.0) for x, y in RING]
    near = (corners[0] + corners[1]) / 2.0
    for start, end in [(hinge, near), *zip(corners, corners[1:] + corners[:1])]:
        along = end - start
        half = np.arctan2(along[1], along[0]) / 2.0
        size, quat = (np.linalg.norm(along) / 2.0 + HALF, HALF, HALF), (np.cos(half), 0, 0, np.sin(half))
        body.add_geom(size=size, pos=(start + end) / 2.0, quat=quat, mass=0.02, **look)
    for x, y in FEET:
        place = hinge + (x, sign * y, 0.0)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(HALF, 0, 0), pos=place, mass=0.001, rgba=colour, **shadow.OBJECT
        )
    body.add_site(name=f"handle/{side}", pos=hinge + np.array(GRIP) * (1.0, sign, 1.0), group=5)


SCENE = Scissors
