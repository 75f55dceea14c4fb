"""The training environment of all learners: one task with the privileged state as observation."""

import gymnasium
import numpy as np

from acgd.experts.settings import ExpertRequest
from acgd.simulate.seeds import SEEDS
from acgd.tasks import registry
from acgd.tasks.spec import ADVANCED_KINDS, TASKS


class StateOnly(gymnasium.ObservationWrapper):
    """Observations are the privileged state (S,). Episode seeds come from the training range."""

    def __init__(self, config: ExpertRequest, stream: int) -> None:
        super().__init__(registry.make(config.task, image_size=None, reward_weights=config.expert.reward_weights))
        self.observation_space = self.env.observation_space["state"]
        self._advanced = config.expert.advanced_starts
        if self._advanced and TASKS[config.task.name].kind not in ADVANCED_KINDS:
            raise ValueError(
                f"{config.task.name} has no start on the way to its goal, only {' and '.join(ADVANCED_KINDS)} tasks "
                "have: leave expert.advanced_starts at 0"
            )
        self._rng = np.random.default_rng(stream)

    def reseed(self, entropy: list[int]) -> None:
        """Starts a new stream of episode seeds."""
        self._rng = np.random.default_rng(entropy)

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Starts an episode with the next seed of the stream. `seed` and `options` are ignored."""
        first, last = SEEDS.expert_training.start, SEEDS.expert_training.stop
        seed = int(self._rng.integers(first, last))
        options = None
        if self._advanced:  # the stream advances by two numbers in both cases
            chance, share = self._rng.random(2)
            options = {"advance": share} if chance < self._advanced else None
        obs, info = self.env.reset(seed=seed, options=options)
        return self.observation(obs), info

    def observation(self, observation: dict) -> np.ndarray:
        """The privileged state (S,)."""
        return observation["state"]
