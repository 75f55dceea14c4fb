"""What both learners train in: environments of one task with the privileged state alone."""

import gymnasium
import numpy as np

from acgd.config.task import TaskConfig
from acgd.tasks import registry
from acgd.tasks.seeds import SEEDS


class StateOnly(gymnasium.ObservationWrapper):
    """The privileged state as the whole observation, and seeds from the training range."""

    def __init__(self, task: TaskConfig, reward_weights: dict[str, float], stream: int) -> None:
        super().__init__(registry.make(task, image=False, reward_weights=reward_weights))
        self.observation_space = self.env.observation_space["state"]
        self._rng = np.random.default_rng(stream)

    def reseed(self, entropy: list[int]) -> None:
        """Start a new stream of episode seeds."""
        self._rng = np.random.default_rng(entropy)

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Ignores `seed`: the stream decides."""
        first, last = SEEDS.expert_training.start, SEEDS.expert_training.stop
        obs, info = self.env.reset(seed=int(self._rng.integers(first, last)))
        return self.observation(obs), info

    def observation(self, observation: dict) -> np.ndarray:
        """The state alone."""
        return observation["state"]
