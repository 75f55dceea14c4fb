"""Recorders: how episodes ended, and whole episodes with all that is needed to see, score or replay them again."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from acgd.simulate.lockstep import Lockstep
from acgd.simulate.roll import Recorder, Step

Episode = dict[str, np.ndarray]
"""Name -> array: with a time axis (T, ...), or one per episode (names in ONCE, `final_*`, `model_fields/*`)."""

ONCE = ("seed", "goal", "terminated", "success_final", "success_held", "success_once")
FINAL = "final_"
FIELDS = "model_fields/"
TERMS = "reward_terms/"
"""Terms of the reward before weighting, each (T,), as the environment reports them."""


class Outcomes(Recorder):
    """How n episodes ended, and what was done in them."""

    def start(self, lock: Lockstep, seeds: Sequence[int]) -> None:
        self.reward = np.zeros(len(seeds))
        """(n,) sum over the episode"""
        self.steps = np.zeros(len(seeds), np.int64)
        """(n,)"""
        self.success: list[dict[str, bool]] = [{} for _ in seeds]
        """final, held and once of each"""
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
        """(T, n, A) float32; rows beyond an episode's steps were not executed."""
        return np.stack(self._actions)


class Episodes(Recorder):
    """Whole episodes, step by step."""

    def __init__(self, beside: Callable[[Step], Mapping[str, np.ndarray]] | None = None) -> None:
        """beside: further arrays (n, ...) of a step, by name, computed before it is taken."""
        self.beside = beside

    def start(self, lock: Lockstep, seeds: Sequence[int]) -> None:
        self._recordings = [_Recording() for _ in seeds]
        for env, seed, recording in zip(lock.envs, seeds, self._recordings):
            recording.once |= {"seed": np.int64(seed), "goal": env.goal_vector()}
            recording.once |= {FIELDS + name: value for name, value in env.snapshot().model_fields.items()}

    def before(self, lock: Lockstep, step: Step) -> None:
        seen = {**step.observations, "action": step.actions, **(self.beside(step) if self.beside else {})}
        for i in step.running:
            self._recordings[i].add(**{name: rows[i] for name, rows in seen.items()}, **_physics(lock.envs[i]))

    def after(self, lock: Lockstep, step: Step) -> None:
        for i in step.running:
            info = step.infos[i]
            terms = {TERMS + name: np.float32(value) for name, value in info["reward_terms"].items()}
            self._recordings[i].add(reward=np.float32(step.reward[i]), solved=np.bool_(info["solved"]), **terms)
        for i in np.flatnonzero(step.done):
            once = self._recordings[i].once
            last = {name: rows[i] for name, rows in step.arrived.items()}
            last["integration"] = _physics(lock.envs[i])["integration"]
            once |= {FINAL + name: value for name, value in last.items()}
            once |= {f"success_{rule}": np.bool_(met) for rule, met in step.infos[i]["success"].items()}
            once["terminated"] = np.bool_(lock.terminated[i])

    def episodes(self) -> list[Episode]:
        """The finished episodes, in the order of their seeds."""
        return [recording.episode() for recording in self._recordings]


def _physics(env) -> Episode:
    """The full simulation state (N,) float64, and the part of it that people read."""
    integration = np.empty(mujoco.mj_stateSize(env.model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(env.model, env.data, integration, mujoco.mjtState.mjSTATE_INTEGRATION)
    return {"integration": integration, "qpos": env.data.qpos.copy(), "qvel": env.data.qvel.copy()}


@dataclass
class _Recording:
    """What has been seen of a running episode."""

    steps: dict[str, list] = field(default_factory=dict)
    once: Episode = field(default_factory=dict)

    def add(self, **values: np.ndarray) -> None:
        for name, value in values.items():
            self.steps.setdefault(name, []).append(value)

    def episode(self) -> Episode:
        return {name: np.stack(rows) for name, rows in self.steps.items()} | self.once
