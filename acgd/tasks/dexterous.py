"""Tasks of position-controlled robot hands: BiDex (two Shadow Hands) and OpDex (an Allegro hand).

An action a moves the targets q* of the servos through the smoothed action m:

    m <- SMOOTHING a + (1 - SMOOTHING) m,   q* <- clip(q* + stride m).

q* are MuJoCo's controls. m and the number of steps for which the goal has been met are MuJoCo's user data. The
simulator's state is therefore all that the continuation of an episode depends on.
"""

import gymnasium
import numpy as np

from acgd.tasks.arguments import RENDER_MODES, checked_action, checked_advance, checked_render_mode
from acgd.tasks.observation import DEFAULT_SIZE, layout, space
from acgd.tasks.scene import Scene
from acgd.tasks.settings import TaskConfig
from acgd.tasks.simulator import mujoco
from acgd.tasks.snapshot import STATE, Snapshot
from acgd.tasks.spec import TaskSpec
from acgd.tasks.success import SuccessCounter
from acgd.tasks.weights import merge_weights

SUBSTEPS = 8
"""Simulator steps of 5 ms in one control step: 25 control steps per second."""
SMOOTHING = 0.7
AFTERWARDS = 10
"""Control steps from success to the end of an episode, so that the last frame shows the goal. The episode is truncated:
with a termination, a policy that stays just short of success would earn more."""
WEIGHTS = {"solved": 2.0, "failed": -5.0, "effort": -1e-3, "change": -1e-2}
"""Weights of the common reward terms: solved, failed, squared norms of the action and of its change."""

_BAD = [
    int(kind)
    for kind in (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
]


class DexterousTask(gymnasium.Env):
    """A BiDex or OpDex task.

    Observations:
    - `image` (H, W, 3) uint8, absent with `image_size=None`;
    - `proprio` (P,) float32: joint positions, joint velocities times the control step, targets (all in m and rad), and
      the smoothed action;
    - `state` (S,) float32: proprio, the share of `hold_steps` for which the goal has been met, and the entries of
      the object. `state_layout` names its columns.

    Actions: (A,) in [-1, 1], in the order of the model's actuators.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 25}

    def __init__(
        self,
        spec: TaskSpec,
        config: TaskConfig,
        *,
        image_size: int | None = 84,
        reward_weights: dict[str, float] | None = None,
        render_mode: str | None = "rgb_array",
    ) -> None:
        self.task, self.config = spec, config
        scene: Scene = spec.code().SCENE()
        self.scene = scene
        self.render_mode = checked_render_mode(spec.name, render_mode)
        self._changed_weights = reward_weights
        self.model = scene.model
        self.data = mujoco.MjData(self.model)
        self.control_step = float(self.model.opt.timestep * SUBSTEPS)
        self.reward_weights = merge_weights(spec.name, WEIGHTS | scene.weights, reward_weights)
        self.ignore_time_limit = False
        self.steps = 0
        self.success = SuccessCounter()
        self.hand_qpos, self.hand_qvel = scene.robot.qpos, scene.robot.qvel
        self._low, self._high = self.model.actuator_ctrlrange.T
        self._moving, self._met_steps = self.data.userdata[:-1], self.data.userdata[-1:]  # views
        self._renderers = {}
        self._image_size = image_size
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (self.model.nu,), np.float32)
        self._start(None)
        observed = self._observe_state()
        self.state_layout = layout(self._proprio_entries() | self._scene_entries())
        self.observation_space = space(observed["proprio"].size, observed["state"].size, image_size)

    # -- episode ---------------------------------------------------------------------------------

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Starts an episode. The start is a function of `seed`."""
        checked_advance(self.task.name, options, advances=False)
        super().reset(seed=seed)
        if seed is None:
            seed = int(self.np_random.integers(2**31))
        self._start(np.random.default_rng([seed, 1]) if self.config.start == "perturbed" else None)
        self.steps, self.success = 0, SuccessCounter()
        return self._observe(), {"solved": False, "success": self.success.outcome(), "reward_terms": {}}

    def step(self, action: np.ndarray):
        """Executes one control step.

        `truncated` at the time limit or AFTERWARDS steps after success, unless `ignore_time_limit` is set.
        """
        action = checked_action(self.task.name, action, self.model.nu, np.float64)
        action = np.minimum(np.maximum(action, -1.0), 1.0)  # np.clip is slower
        change = action - self._moving
        self._moving += SMOOTHING * change
        self.data.ctrl[:] = np.minimum(
            np.maximum(self.data.ctrl + self.scene.robot.stride * self._moving, self._low), self._high
        )
        for _ in range(SUBSTEPS):  # step2 before step1, so that positions and contacts are current after the loop
            mujoco.mj_step2(self.model, self.data)
            mujoco.mj_step1(self.model, self.data)
        self._met_steps[:] = self._met_steps + 1 if self.scene.met(self.data) else 0
        self.steps += 1
        self.success.update(bool(self._met_steps[0] >= self.scene.hold_steps))
        failed = self.scene.failed(self.data)
        terminated = failed or self._unstable()
        over = self.steps >= self.task.horizon or self._met_steps[0] >= self.scene.hold_steps + AFTERWARDS
        truncated = bool(over) and not terminated and not self.ignore_time_limit
        terms = self.scene.terms(self.data) | {
            "solved": float(self.success.last),
            "failed": float(failed),
            "effort": float(action @ action),
            "change": float(change @ change),
        }
        reward = sum(weight * terms[name] for name, weight in self.reward_weights.items())
        out = {"solved": self.success.last, "success": self.success.outcome(), "reward_terms": terms}
        return self._observe(), float(reward), terminated, truncated, out

    def goal_vector(self) -> np.ndarray:
        """The commanded goal (0,) float32: these tasks have fixed goals."""
        return np.zeros(0, np.float32)

    def snapshot(self) -> Snapshot:
        """The current state. A restored episode continues bit for bit."""
        integration = np.empty(mujoco.mj_stateSize(self.model, STATE))
        mujoco.mj_getState(self.model, self.data, integration, STATE)
        return Snapshot(integration, {}, self.steps, self.success.solved_steps, self.success.last)

    def restore(self, snapshot: Snapshot) -> dict[str, np.ndarray]:
        """Restores a snapshot of the same task, and returns its observation. ValueError for another task's snapshot."""
        self._restore(snapshot)
        return self._observe()

    def _restore(self, snapshot: Snapshot) -> None:
        expected = mujoco.mj_stateSize(self.model, STATE)
        if snapshot.integration.shape != (expected,):
            raise ValueError(
                f"{self.task.name} has states of {expected} numbers, the snapshot {snapshot.integration.size}: "
                "it is of another task"
            )
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, snapshot.integration, STATE)
        mujoco.mj_step1(self.model, self.data)
        self.steps = snapshot.steps
        self.success = SuccessCounter(snapshot.solved_steps, snapshot.solved)

    def __reduce__(self):
        """A copy or a pickle is a new environment in the same state of the episode.

        It has the task's model: what a caller wrote into the model beyond a reset is left out.
        """
        arguments = (self.task, self.config, self._image_size, self._changed_weights, self.render_mode)
        kept = ("spec", "ignore_time_limit", "_np_random", "_np_random_seed")
        return type(self)._continued, (*arguments, self.snapshot()), {name: getattr(self, name) for name in kept}

    @classmethod
    def _continued(cls, spec, config, image_size, reward_weights, render_mode, snapshot: Snapshot):
        env = cls(spec, config, image_size=image_size, reward_weights=reward_weights, render_mode=render_mode)
        env._restore(snapshot)
        return env

    def _start(self, rng: np.random.Generator | None) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.scene.reset(self.data, rng)
        self._check_start()
        mujoco.mj_step1(self.model, self.data)

    def _check_start(self) -> None:
        """Raises ValueError where the scene starts a joint of the robot outside its range."""
        model, position = self.model, self.data.qpos[self.hand_qpos]
        joints = model.dof_jntid[self.hand_qvel]
        low, high = model.jnt_range[joints].T
        outside = (position < low - 1e-6) | (position > high + 1e-6)
        if outside.any():
            at = int(np.flatnonzero(outside)[0])
            name = model.joint(joints[at]).name
            raise ValueError(
                f"{self.task.name} starts joint {name} at {position[at]:.3f}, "
                f"outside [{low[at]:.3f}, {high[at]:.3f}]: narrow its starts"
            )

    def _unstable(self) -> bool:
        """Whether MuJoCo warned of a bad number, after which it resets its state."""
        return bool(self.data.warning.number[_BAD].any())

    # -- observation -----------------------------------------------------------------------------

    def render(self, size: int | None = None) -> np.ndarray:
        """The current picture (size, size, 3) uint8.

        The default of `size`, in pixels, is that of the observation's image, or 84 without such an image.
        """
        size = size or self._image_size or DEFAULT_SIZE
        if size not in self._renderers:
            from acgd.tasks.rendering.renderer import Renderer

            self._renderers[size] = Renderer(self.model, camera=self.task.code().CAMERA, size=size)
        return self._renderers[size].render(self.data)

    def _observe(self) -> dict[str, np.ndarray]:
        obs = self._observe_state()
        if self._image_size is not None:
            obs["image"] = self.render()
        return obs

    def _observe_state(self) -> dict[str, np.ndarray]:
        proprio = np.concatenate(list(self._proprio_entries().values())).astype(np.float32)
        scene = np.concatenate(list(self._scene_entries().values())).astype(np.float32)
        return {"proprio": proprio, "state": np.concatenate([proprio, scene])}

    def _proprio_entries(self) -> dict[str, np.ndarray]:
        return {
            "hand_qpos": self.data.qpos[self.hand_qpos],
            "hand_qvel": self.data.qvel[self.hand_qvel] * self.control_step,
            "targets": self.data.ctrl,
            "moving": self._moving,
        }

    def _scene_entries(self) -> dict[str, np.ndarray]:
        held = np.minimum(self._met_steps / self.scene.hold_steps, 1.0)
        return {"held": held} | self.scene.entries(self.data)
