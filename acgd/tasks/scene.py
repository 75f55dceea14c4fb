"""The scene of a dexterous task: robot and object, starts, reward terms, success and failure."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from acgd.tasks.simulator import mujoco

NEAR = 0.7
"""Share of perturbed starts with the hands near the object. Other starts are near those of the original task."""
REACH = 0.1
"""Length scale of `closeness` in metres."""


@dataclass(frozen=True)
class Robot:
    """The robot in a model: addresses of H joint positions and velocities, and strides of A actuators."""

    qpos: np.ndarray
    """(H,) int, addresses in qpos."""
    qvel: np.ndarray
    """(H,) int, addresses in qvel."""
    stride: np.ndarray
    """(A,) change of each actuator's target by an action of 1 in one control step, in m or rad."""

    @classmethod
    def of(cls, model: mujoco.MjModel, joints: list[str], stride: np.ndarray) -> "Robot":
        """Addresses of the named joints, in that order. Each joint has one degree of freedom."""
        ids = [model.joint(name).id for name in joints]
        return cls(model.jnt_qposadr[ids].copy(), model.jnt_dofadr[ids].copy(), np.asarray(stride, float))


class Scene(Protocol):
    """Model and rules of one task. A scene is stateless: everything that changes in an episode is in `data`.

    Kinematics and contacts of `data` must be current (mj_step1).
    """

    model: mujoco.MjModel
    """The model from `compiled`. Each actuator is a position servo, and its ctrlrange is the range of its target."""
    robot: Robot
    weights: dict[str, float]
    """Default weights of the terms of `terms`, and of common terms whose weight differs from dexterous.WEIGHTS."""
    hold_steps: int
    """Consecutive control steps for which `met` must be true before the task counts as solved."""

    def reset(self, data: mujoco.MjData, rng: np.random.Generator | None) -> None:
        """Writes the start into `data` after mj_resetData: qpos, and ctrl (see `rest`).

        Without `rng` the start is that of the original task.
        """

    def entries(self, data: mujoco.MjData) -> dict[str, np.ndarray]:
        """Name -> entries (n,) of object and goal. Velocities are per second."""

    def terms(self, data: mujoco.MjData) -> dict[str, float]:
        """Reward terms of the scene before weighting."""

    def met(self, data: mujoco.MjData) -> bool:
        """Whether the goal is met in this step."""

    def failed(self, data: mujoco.MjData) -> bool:
        """Whether the task has failed, for example because the object has toppled or fallen."""


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compiles a scene with the physics options of all scenes, and with the user data of `DexterousTask`."""
    spec.option.timestep = 0.005
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # MuJoCo 4.0.0's sparse solver is wrong (MuJoCo issue 3767)
    spec.nuserdata = len(spec.actuators) + 1
    return spec.compile()


def rest(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Targets (A,) at which the actuators hold the positions in qpos."""
    mujoco.mj_fwdPosition(model, data)
    return np.clip(data.actuator_length, *model.actuator_ctrlrange.T)


def closeness(distance: float) -> float:
    """1 - tanh(distance / REACH): 1 at contact, 0 far away. `distance` in metres."""
    return 1.0 - math.tanh(distance / REACH)


class Touch:
    """Contact of P pairs of parts, in one pass over the contacts."""

    def __init__(self, *pairs: tuple[np.ndarray, np.ndarray]) -> None:
        """pairs: two masks (ngeom,) bool each."""
        one, other = np.stack([a for a, _ in pairs]), np.stack([b for _, b in pairs])
        both = one[:, :, None] & other[:, None, :]
        self._pairs = np.ascontiguousarray((both | both.swapaxes(1, 2)).transpose(1, 2, 0))  # (ngeom, ngeom, P)

    def __call__(self, data: mujoco.MjData) -> np.ndarray:
        """(P,) bool, whether each pair is in contact."""
        touching = data.contact.geom
        return self._pairs[touching[:, 0], touching[:, 1]].any(axis=0)
