"""Settings of PPO."""

from typing import ClassVar, Literal

from pydantic import Field, model_validator

from acgd.experts.learner import LearnerSettings
from acgd.experts.muscle.settings import ControllerSettings, ImitationSettings, MuscleSettings
from acgd.experts.reinforcement import ReinforcementSettings


class PPOSettings(ReinforcementSettings):
    """Proximal policy optimisation, by stable-baselines3, on normalised privileged states."""

    algorithm: ClassVar[str] = "PPO (stable-baselines3)"
    muscle_settings: ClassVar[type[ControllerSettings]] = ImitationSettings

    kind: Literal["ppo"] = "ppo"
    steps: int = Field(default=1_000_000, ge=1, description="Environment steps in total.")
    rollout_steps: int = Field(default=256, ge=1, description="Steps of each environment between updates.")
    batch: int = Field(default=256, ge=2, description="Minibatch size.")
    epochs: int = Field(default=8, ge=1, description="Passes over each rollout.")
    learning_rate: float = Field(default=1e-4, gt=0, description="Adam's step size at the start.")
    learning_rate_end: float = Field(default=1e-4, gt=0, description="Adam's step size at the end; linear between.")
    gae_lambda: float = Field(default=0.95, gt=0, le=1, description="Lambda of the advantage estimate.")
    clip: float = Field(default=0.2, gt=0, description="Clip range of the probability ratio.")
    initial_std: float = Field(default=0.37, gt=0, description="Standard deviation of the first policy.")
    entropy: float = Field(default=0.0, ge=0, description="Weight of the entropy bonus.")
    muscle: ImitationSettings | None = Field(
        default=None,
        description="Settings of the muscle controller and of its imitation. Only with warm_start: muscle. "
        "The imitation uses the width, the environments and the seed of PPO.",
    )

    @model_validator(mode="after")
    def _usable(self) -> "PPOSettings":
        if self.envs * self.rollout_steps < 2:
            raise ValueError("one environment and one step between updates: raise envs or rollout_steps.")
        if self.warm_start == "muscle":
            self.imitation()
        return self

    def imitation(self) -> MuscleSettings:
        """Settings of the imitation that precedes PPO, with warm_start: muscle."""
        shared = {name: getattr(self, name) for name in LearnerSettings.model_fields}
        return MuscleSettings(**shared, **self.muscle.model_dump())
