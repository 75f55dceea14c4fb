"""What a dexterous task brings along: robot and object, where they start, what is scored, when it is over."""

import math
from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np

NEAR = 0.7
"""Share of perturbed starts with the hands near the object; the others start where the original task does."""
REACH = 0.1
"""Metres over which `closeness` falls."""


@dataclass(frozen=True)
class Robot:
    """Which part of a model is the robot: H joint positions and velocities, A actuators."""

    qpos: np.ndarray
    """(H,) int, addresses in qpos."""
    qvel: np.ndarray
    """(H,) int, addresses in qvel."""
    stride: np.ndarray
    """(A,) by how much an action of 1 moves each actuator's target in a control step; metres or radians."""

    @classmethod
    def of(cls, model: mujoco.MjModel, joints: list[str], stride: np.ndarray) -> "Robot":
        """Addresses of the named joints, in their order; every joint has one degree of freedom."""
        ids = [model.joint(name).id for name in joints]
        return cls(model.jnt_qposadr[ids].copy(), model.jnt_dofadr[ids].copy(), np.asarray(stride, float))


class Scene(Protocol):
    """One task's model and rules. Everything that changes in an episode is in `data`, so that a scene keeps no state.

    The methods read a `data` whose kinematics and contacts are up to date (mj_step1).
    """

    model: mujoco.MjModel
    """Made by `compiled`: every actuator is a position servo, its ctrlrange the range of its target."""
    robot: Robot
    weights: dict[str, float]
    """Default weight of each of the terms that `terms` gives, and, if they differ from dexterous.WEIGHTS, of the common ones."""
    hold_steps: int
    """Control steps in a row for which `met` must be true before the task counts as solved."""

    def reset(self, data: mujoco.MjData, rng: np.random.Generator | None) -> None:
        """Write the start into a `data` fresh from mj_resetData: qpos, and ctrl (see `rest`). Without `rng` the original start."""

    def entries(self, data: mujoco.MjData) -> dict[str, np.ndarray]:
        """Object and goal by name, each (n,); velocities per second."""

    def terms(self, data: mujoco.MjData) -> dict[str, float]:
        """The reward's own terms before weighting."""

    def met(self, data: mujoco.MjData) -> bool:
        """Whether the goal is met at this moment."""

    def failed(self, data: mujoco.MjData) -> bool:
        """Whether the episode is lost: toppled, dropped."""


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The model of a scene, with the physics that all scenes share and room for what `DexterousTask` keeps in userdata."""
    spec.option.timestep = 0.005
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # MuJoCo 4.0.0's sparse solver is at fault: its issue 3767
    spec.nuserdata = len(spec.actuators) + 1
    return spec.compile()


def rest(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Targets (A,) that keep the actuators where qpos has them."""
    mujoco.mj_fwdPosition(model, data)
    return np.clip(data.actuator_length, *model.actuator_ctrlrange.T)


def closeness(distance: float) -> float:
    """1 at contact, 0 far away; `distance` in metres."""
    return 1.0 - math.tanh(distance / REACH)


class Touch:
    """Tells of P pairs of parts whether they touch, in one pass over the contacts."""

    def __init__(self, *pairs: tuple[np.ndarray, np.ndarray]) -> None:
        """Each part is a mask (ngeom,) bool."""
        one, other = np.stack([a for a, _ in pairs]), np.stack([b for _, b in pairs])
        both = one[:, :, None] & other[:, None, :]
        self._pairs = np.ascontiguousarray((both | both.swapaxes(1, 2)).transpose(1, 2, 0))  # (ngeom, ngeom, P)

    def __call__(self, data: mujoco.MjData) -> np.ndarray:
        """(P,) bool"""
        touching = data.contact.geom
        return self._pairs[touching[:, 0], touching[:, 1]].any(axis=0)
