"""Several episodes of one task in lockstep, so that a policy computes their actions in one batch."""

from collections.abc import Sequence

import numpy as np

from acgd.tasks import registry
from acgd.tasks.settings import TaskConfig
from acgd.tasks.snapshot import Snapshot


class Lockstep:
    """`n` environments of one task.

    After `reset(seeds)` or `restore(snapshots)` with m <= n episodes, arrays have m rows. An environment is not stepped
    after the end of its episode: its last observation repeats, and its reward is 0.
    """

    def __init__(
        self,
        task: TaskConfig,
        n: int,
        *,
        image_size: int | None,
        reward_weights: dict[str, float] | None = None,
    ) -> None:
        """image_size: height and width of the images in pixels; with None no images are rendered."""
        self.envs = [registry.make(task, image_size=image_size, reward_weights=reward_weights) for _ in range(n)]
        self.active = np.zeros(0, bool)

    def reset(self, seeds: Sequence[int]) -> dict[str, np.ndarray]:
        """Starts one episode per seed. Returns stacked observations."""
        self._check(len(seeds))
        return self._begin([env.reset(seed=seed)[0] for env, seed in zip(self.envs, seeds)])

    def restore(self, snapshots: Sequence[Snapshot]) -> dict[str, np.ndarray]:
        """Continues one episode per snapshot. Returns stacked observations."""
        self._check(len(snapshots))
        return self._begin([env.restore(snapshot) for env, snapshot in zip(self.envs, snapshots)])

    def step(self, actions: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, list[dict]]:
        """Steps the active environments with their rows of `actions` (m, A).

        Returns observations, rewards (m,), done (m,) bool for episodes that ended in this step, and infos.
        """
        reward, done = np.zeros(len(self.active)), np.zeros(len(self.active), bool)
        for i in np.flatnonzero(self.active):
            self._obs[i], reward[i], terminated, truncated, self._info[i] = self.envs[i].step(actions[i])
            done[i], self.terminated[i] = terminated or truncated, terminated
        self.active = self.active & ~done
        return self._stack(), reward, done, list(self._info)

    def goal_vectors(self) -> np.ndarray:
        """The commanded goals (m, G) float32 of the episodes that have begun."""
        return np.stack([env.goal_vector() for env in self.envs[: len(self.active)]])

    def _check(self, episodes: int) -> None:
        if not 0 < episodes <= len(self.envs):
            raise ValueError(f"{episodes} episodes for {len(self.envs)} environments: pass 1 to {len(self.envs)}")

    def _begin(self, observations: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        self._obs = observations
        self._info: list[dict] = [{} for _ in observations]
        self.active = np.ones(len(observations), bool)
        self.terminated = np.zeros(len(observations), bool)
        return self._stack()

    def _stack(self) -> dict[str, np.ndarray]:
        return {key: np.stack([obs[key] for obs in self._obs]) for key in self._obs[0]}
