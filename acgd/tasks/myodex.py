"""The MyoDex suite: ten MyoSuite hand tasks with image, proprio and privileged state.

MyoSuite's control step clips the action to [-1, 1], maps it to a muscle excitation, steps the physics and computes the
reward. This file adds dict observations in one joint order for the whole suite, perturbed starts, three rules of
success, and snapshots that continue bit for bit.
"""

import contextlib
import io
import warnings

import gymnasium
import numpy as np

from acgd.tasks import starts
from acgd.tasks.arguments import RENDER_MODES, checked_action, checked_advance, checked_render_mode
from acgd.tasks.myo_kind import MyoKind
from acgd.tasks.observation import DEFAULT_SIZE, layout, space
from acgd.tasks.settings import TaskConfig
from acgd.tasks.simulator import mujoco
from acgd.tasks.snapshot import STATE, Snapshot
from acgd.tasks.spec import TaskSpec
from acgd.tasks.success import SuccessCounter
from acgd.tasks.weights import merge_weights

HAND_JOINTS = (
    "pro_sup", "deviation", "flexion",
    "cmc_abduction", "cmc_flexion", "mp_flexion", "ip_flexion",
    "mcp2_flexion", "mcp2_abduction", "pm2_flexion", "md2_flexion",
    "mcp3_flexion", "mcp3_abduction", "pm3_flexion", "md3_flexion",
    "mcp4_flexion", "mcp4_abduction", "pm4_flexion", "md4_flexion",
    "mcp5_flexion", "mcp5_abduction", "pm5_flexion", "md5_flexion",
)  # fmt: skip
"""Order of the hand's 23 joints in `proprio`. The suite's models differ in the order of the thumb's joints."""

FAR = 100.0
"""Largest joint position, m or rad. Beyond it the episode terminates unsolved, with a reward of 0 in that step."""


class MyoDexTask(gymnasium.Env):
    """A MyoDex task.

    Observations:
    - `image` (H, W, 3) uint8, absent with `image_size=None`;
    - `proprio` (85,) float32: hand joint positions (rad), velocities times the control step (rad), muscle activations;
    - `state` (S,) float32: proprio, and the entries of object and goal. `state_layout` names its columns.

    Actions: (39,) in [-1, 1], mapped by the suite to excitations 1 / (1 + exp(-5 (a - 0.5))).
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 50}

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
        self.kind: MyoKind = spec.code().KIND
        self.base = _make_base(spec.gym_id)
        self.render_mode = checked_render_mode(spec.name, render_mode)
        self._changed_weights = reward_weights
        self.model, self.data = self.base.model, self.base.data
        self.control_step = float(self.model.opt.timestep * self.base.frame_skip)
        self.reward_weights = merge_weights(spec.name, dict(self.base.rwd_keys_wt), reward_weights)
        self.base.rwd_keys_wt = self.reward_weights
        self.ignore_time_limit = False
        self.steps = 0
        self.success = SuccessCounter()
        self._state_size = mujoco.mj_stateSize(self.model, STATE)
        self._suite_draws_goal = spec.name.endswith("-hard")
        self.hand_qpos, self.hand_qvel = _hand_addresses(self.model)
        """Addresses of HAND_JOINTS in qpos and qvel."""
        if self.kind.nominal_goal and not self._suite_draws_goal:
            self.base.nominal_goal = self.kind.nominal_goal(self.base)
        self._nominal_fields = {f: getattr(self.model, f).copy() for f in self.kind.model_fields}

        self._renderers = {}
        self._image_size = image_size
        if spec.name != "myo/obj-hold-hard":  # that task refreshes geoms from the spec at every reset
            self.base._mj_spec = None  # frees 40 to 70 MB per environment
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (self.model.nu,), np.float32)
        self.base.reset(seed=0)
        entries = self._state_entries()
        self.state_layout = layout(entries)
        state = sum(value.size for value in entries.values())
        self.observation_space = space(46 + self.model.na, state, image_size)

    # -- episode ---------------------------------------------------------------------------------

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Starts an episode. The start is a function of `seed` and `options`.

        `options={"advance": x}` moves the start by a share x of the way to the goal, for tasks of ADVANCED_KINDS.
        """
        advance = checked_advance(self.task.name, options, advances=self.kind.advance is not None)
        super().reset(seed=seed)
        if seed is None:
            seed = int(self.np_random.integers(2**31))
        for name, value in self._nominal_fields.items():
            getattr(self.model, name)[:] = value
        self.base.reset(seed=seed)
        if self.config.start == "perturbed":
            rng = np.random.default_rng([seed, 1])
            starts.perturb(self.kind, self.base, self.hand_qpos, rng, goal=not self._suite_draws_goal)
        if advance:
            self.kind.advance(self.base, advance)
        mujoco.mj_forward(self.model, self.data)
        self.steps, self.success = 0, SuccessCounter()
        return self._observe(), {"solved": False, "success": self.success.outcome(), "reward_terms": {}}

    def step(self, action: np.ndarray):
        """Executes one control step.

        `truncated` at the time limit, unless `ignore_time_limit` is set. `terminated` where the simulation is unstable.
        """
        action = checked_action(self.task.name, action, self.model.nu, np.float32)
        _, reward, terminated, _, info = self.base.step(action)
        self.steps += 1
        if self._unstable():
            terminated, reward, terms = True, 0.0, dict.fromkeys(self.reward_weights, 0.0)
            self.success.update(False)
        else:
            terms = {k: float(np.asarray(info["rwd_dict"][k]).item()) for k in self.reward_weights}
            self.success.update(bool(info["solved"]))
        truncated = self.steps >= self.task.horizon and not terminated and not self.ignore_time_limit
        out = {"solved": self.success.last, "success": self.success.outcome(), "reward_terms": terms}
        return self._observe(), reward, terminated, truncated, out

    def _unstable(self) -> bool:
        """Whether the simulation is unstable. A pen at a distance of kilometres would give a reward of -46,000."""
        return self.base._check_mj_instability_termination() or np.abs(self.data.qpos).max() > FAR

    def goal_vector(self) -> np.ndarray:
        """The commanded goal (G,) float32, not the place of the object. Empty for tasks with a fixed goal."""
        goal = self.kind.goal(self.base, self.data) if self.kind.goal else ()
        return np.array(goal, np.float32)

    def snapshot(self) -> Snapshot:
        """The current state. A restored episode continues bit for bit."""
        integration = np.empty(self._state_size)
        mujoco.mj_getState(self.model, self.data, integration, STATE)
        fields = {f: getattr(self.model, f).copy() for f in self.kind.model_fields}
        if self.task.kind == "pose":
            fields["target_angles"] = np.asarray(self.base.target_jnt_value, np.float64).copy()
        return Snapshot(integration, fields, self.steps, self.success.solved_steps, self.success.last)

    def restore(self, snapshot: Snapshot) -> dict[str, np.ndarray]:
        """Restores a snapshot of the same task, and returns its observation."""
        self._restore(snapshot)
        return self._observe()

    def _restore(self, snapshot: Snapshot) -> None:
        for name, value in snapshot.model_fields.items():
            if name == "target_angles":
                self.base.target_jnt_value = value.copy()
            else:
                getattr(self.model, name)[:] = value
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, snapshot.integration, STATE)
        mujoco.mj_forward(self.model, self.data)
        # the forward pass changes the solver's warm start, which this line restores
        mujoco.mj_setState(self.model, self.data, snapshot.integration, STATE)
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
        entries = self._state_entries()
        state = np.concatenate(list(entries.values())).astype(np.float32)
        obs = {"proprio": state[: 46 + self.model.na].copy(), "state": state}
        if self._image_size is not None:
            obs["image"] = self.render()
        return obs

    def _state_entries(self) -> dict[str, np.ndarray]:
        """Name -> entries of the privileged state, those of proprio first."""
        data, step = self.data, self.control_step
        entries = {
            "hand_qpos": data.qpos[self.hand_qpos],
            "hand_qvel": data.qvel[self.hand_qvel] * step,
            "act": data.act.copy(),
        }
        return entries | self.kind.entries(self.base, data, step)


def _make_base(gym_id: str):
    """MyoSuite's environment without wrappers. Warnings of its import and its models are suppressed."""
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        import myosuite  # noqa: F401  (registers the environments)

        return gymnasium.make(gym_id).unwrapped


def _hand_addresses(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Addresses of HAND_JOINTS in qpos and qvel."""
    ids = {model.joint(i).name.removesuffix("_r"): i for i in range(model.njnt)}
    joints = [ids[name] for name in HAND_JOINTS]
    return model.jnt_qposadr[joints].copy(), model.jnt_dofadr[joints].copy()
