"""Recorders: outcomes of episodes, and whole episodes with all data for rendering, scoring and replay."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from acgd.simulate.lockstep import Lockstep
from acgd.simulate.roll import Recorder, Step
from acgd.tasks.simulator import mujoco

Episode = dict[str, np.ndarray]
"""Name -> array (T, ...) per step, or one value per episode (names in ONCE, `final_*`, `model_fields/*`)."""

ONCE = ("seed", "goal", "terminated", "success_final", "success_held", "success_once")
FINAL = "final_"
FIELDS = "model_fields/"
TERMS = "reward_terms/"
"""Prefix of the reward terms (T,) before weighting."""


class Outcomes(Recorder):
    """Outcomes and actions of n episodes."""

    def start(self, lock: Lockstep, seeds: Sequence[int]) -> None:
        self.reward = np.zeros(len(seeds))
        """(n,) sum of rewards"""
        self.steps = np.zeros(len(seeds), np.int64)
        """(n,) number of steps"""
        self.success: list[dict[str, bool]] = [{} for _ in seeds]
        """final, held and once of each episode"""
        self._actions: list[np.ndarray] = []

    def before(self, lock: Lockstep, step: Step) -> None:
        self._actions.append(step.actions)

    def after(self, lock: Lockstep, step: Step) -> None:
        self.reward += step.reward
        self.steps[step.running] += 1
        for i in step.running:
            self.success[i] = step.infos[i]["success"]

    @property
    def actions(self) -> np.ndarray:
        """(T, n, A) float32. Actions after the end of an episode were not executed."""
        return np.stack(self._actions)


class Episodes(Recorder):
    """Records whole episodes."""

    def __init__(self, extra_arrays: Callable[[Step], Mapping[str, np.ndarray]] | None = None) -> None:
        """extra_arrays: step -> name -> further arrays (n, ...), computed before the step is executed."""
        self.extra_arrays = extra_arrays

    def start(self, lock: Lockstep, seeds: Sequence[int]) -> None:
        self._recordings = [_Recording() for _ in seeds]
        for env, seed, recording in zip(lock.envs, seeds, self._recordings):
            recording.once |= {"seed": np.int64(seed), "goal": env.goal_vector()}
            recording.once |= {FIELDS + name: value for name, value in env.snapshot().model_fields.items()}

    def before(self, lock: Lockstep, step: Step) -> None:
        arrays = {**step.observations, "action": step.actions, **(self.extra_arrays(step) if self.extra_arrays else {})}
        for i in step.running:
            self._recordings[i].add(**{name: rows[i] for name, rows in arrays.items()}, **_physics(lock.envs[i]))

    def after(self, lock: Lockstep, step: Step) -> None:
        for i in step.running:
            info = step.infos[i]
            terms = {TERMS + name: np.float32(value) for name, value in info["reward_terms"].items()}
            self._recordings[i].add(reward=np.float32(step.reward[i]), solved=np.bool_(info["solved"]), **terms)
        for i in np.flatnonzero(step.done):
            once = self._recordings[i].once
            final = {name: rows[i] for name, rows in step.next_observations.items()}
            final["integration"] = _physics(lock.envs[i])["integration"]
            once |= {FINAL + name: value for name, value in final.items()}
            once |= {f"success_{rule}": np.bool_(met) for rule, met in step.infos[i]["success"].items()}
            once["terminated"] = np.bool_(lock.terminated[i])

    def episodes(self) -> list[Episode]:
        """The finished episodes, in the order of the seeds."""
        return [recording.episode() for recording in self._recordings]


def _physics(env) -> Episode:
    """The full simulation state (N,) float64, and qpos and qvel for readers."""
    integration = np.empty(mujoco.mj_stateSize(env.model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(env.model, env.data, integration, mujoco.mjtState.mjSTATE_INTEGRATION)
    return {"integration": integration, "qpos": env.data.qpos.copy(), "qvel": env.data.qvel.copy()}


@dataclass
class _Recording:
    """The data of a running episode."""

    steps: dict[str, list] = field(default_factory=dict)
    once: Episode = field(default_factory=dict)

    def add(self, **values: np.ndarray) -> None:
        for name, value in values.items():
            self.steps.setdefault(name, []).append(value)

    def episode(self) -> Episode:
        return {name: np.stack(rows) for name, rows in self.steps.items()} | self.once
