"""Several episodes of one task side by side, so that a policy is asked once for all of them."""

import numpy as np

from acgd.tasks import registry
from acgd.tasks.settings import TaskConfig


class Lockstep:
    """`n` environments of one task.

    After `reset(seeds)` with m <= n seeds, arrays have m rows. An environment whose episode has ended is
    not stepped any more: its last observation repeats and its reward is 0.
    """

    def __init__(self, task: TaskConfig, n: int, *, image: bool, reward_weights: dict[str, float] | None = None):
        self.envs = [registry.make(task, image=image, reward_weights=reward_weights) for _ in range(n)]
        self.active = np.zeros(0, bool)

    def reset(self, seeds: list[int]) -> dict[str, np.ndarray]:
        """Start one episode per seed; returns stacked observations."""
        if not 0 < len(seeds) <= len(self.envs):
            raise ValueError(f"{len(seeds)} seeds for {len(self.envs)} environments: give 1 to {len(self.envs)}")
        self._obs = [env.reset(seed=seed)[0] for env, seed in zip(self.envs, seeds)]
        self._info: list[dict] = [{} for _ in seeds]
        self.active = np.ones(len(seeds), bool)
        self.terminated = np.zeros(len(seeds), bool)
        return self._stack()

    def step(self, actions: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, list[dict]]:
        """Step the active environments with their rows of `actions` (m, A).

        Returns observations, rewards (m,), which episodes ended in this step (m,) bool, and the infos.
        """
        reward, done = np.zeros(len(self.active)), np.zeros(len(self.active), bool)
        for i in np.flatnonzero(self.active):
            self._obs[i], reward[i], terminated, truncated, self._info[i] = self.envs[i].step(actions[i])
            done[i], self.terminated[i] = terminated or truncated, terminated
        self.active = self.active & ~done
        return self._stack(), reward, done, list(self._info)

    def _stack(self) -> dict[str, np.ndarray]:
        return {key: np.stack([obs[key] for obs in self._obs]) for key in self._obs[0]}
