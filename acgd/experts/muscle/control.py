"""Muscle controller: activations that move a hand towards its goal, from the simulator's equations of motion.

Resolved-rate control (Whitney 1969) by damped least squares. Derivation: docs/method.md, "Muscle controller".
"""

import numpy as np
from scipy.optimize import nnls

from acgd.experts.muscle.detours import CLENCHED, DETOURS, Detour
from acgd.experts.muscle.settings import ControllerSettings
from acgd.nn.excitation import HIGHEST, LOWEST
from acgd.tasks.myodex import MyoDexTask
from acgd.tasks.simulator import mujoco

TIP_UNIT = 0.05
"""Fingertip error in metres that weighs as much as a joint error of one radian."""


class MuscleControl:
    """The controller of one environment of a pose or reach task. ValueError for other kinds of tasks.

    detour: replaces the detour in DETOURS on a pose task.
    """

    def __init__(self, env: MyoDexTask, settings: ControllerSettings, detour: Detour | None = None) -> None:
        if env.task.kind not in _ERRORS:
            raise ValueError(
                f"{env.task.name} has no muscle controller, only {', '.join(_ERRORS)} tasks have: set "
                "expert.kind to ppo or sac"
            )
        self._env, self._settings, self._error = env, settings, _ERRORS[env.task.kind]
        self._detour = detour or DETOURS.get(env.task.name)
        self._moment = np.zeros((env.model.nu, env.model.nv))

    def action(self) -> np.ndarray:
        """Action (A,) in [-1, 1] for the current state of the environment. The simulation does not advance."""
        excitation = np.clip(self._activation(), LOWEST, HIGHEST)  # activations follow excitations within 10 to 60 ms
        return (np.log(excitation / (1 - excitation)) / 5 + 0.5).astype(np.float32)

    def _activation(self) -> np.ndarray:
        """Activations (M,) in [0, 1] by non-negative least squares."""
        model, data, joints = self._env.model, self._env.data, self._env.hand_qvel
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mju_sparse2dense(
            self._moment, data.actuator_moment.ravel(), data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
        active, passive = _forces(model, data)
        damping, arms = model.dof_damping[joints], self._moment[:, joints]
        by_activation = (arms * active[:, None]).T / damping[:, None]
        other_torques = (
            arms.T @ passive + data.qfrc_passive[joints] + damping * data.qvel[joints] - data.qfrc_bias[joints]
        )
        drift = other_torques / damping
        error, jacobian = self._error(self._env, self._detour)
        damping_weight, effort = self._settings.damping, self._settings.effort
        matrix = np.vstack([jacobian @ by_activation, damping_weight * by_activation, effort * np.eye(model.nu)])
        target = np.concatenate(
            [self._settings.rate * error - jacobian @ drift, -damping_weight * drift, np.zeros(model.nu)]
        )
        return np.minimum(nnls(matrix, target, maxiter=10 * model.nu)[0], 1.0)


def _forces(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Muscle forces in N: (M,) added by full activation, and (M,) at zero activation."""
    active, passive = np.empty(model.nu), np.empty(model.nu)
    for i, (length, velocity) in enumerate(zip(data.actuator_length, data.actuator_velocity)):
        span, strength = model.actuator_lengthrange[i], model.actuator_acc0[i]
        active[i] = mujoco.mju_muscleGain(length, velocity, span, strength, model.actuator_gainprm[i, :9].copy())
        passive[i] = mujoco.mju_muscleBias(length, span, strength, model.actuator_biasprm[i, :9].copy())
    return active, passive


def _pose_error(env: MyoDexTask, detour: Detour | None) -> tuple[np.ndarray, np.ndarray]:
    """Joint errors (23,) in rad, within the joints' ranges, and their Jacobian (23, 23)."""
    low, high = env.model.jnt_range.T
    error = (np.clip(env.base.target_jnt_value, low, high) - env.data.qpos)[env.hand_qpos]
    if detour and env.steps < detour.steps:
        goal = error + env.data.qpos[env.hand_qpos]
        error[CLENCHED] = detour.posture + detour.share * goal[CLENCHED] - env.data.qpos[env.hand_qpos][CLENCHED]
        error *= detour.gain
    return error, np.eye(len(error))


def _reach_error(env: MyoDexTask, _: Detour | None) -> tuple[np.ndarray, np.ndarray]:
    """Vectors from the five fingertips to their targets (15,), in units of TIP_UNIT, and their Jacobian (15, 23)."""
    tips, targets = env.base.tip_sids, env.base.target_sids
    jacobian = np.zeros((len(tips), 3, env.model.nv))
    for site, rows in zip(tips, jacobian):
        mujoco.mj_jacSite(env.model, env.data, rows, None, site)
    error = (env.data.site_xpos[targets] - env.data.site_xpos[tips]).ravel()
    return error / TIP_UNIT, jacobian[:, :, env.hand_qvel].reshape(error.size, -1) / TIP_UNIT


_ERRORS = {"pose": _pose_error, "reach": _reach_error}
