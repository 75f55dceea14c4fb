"""Single-task RL experts."""

from typing import Literal

from pydantic import Field

from acgd.config.section import Section
from acgd.config.task import TaskConfig


class PPOConfig(Section):
    """Proximal policy optimisation, by stable-baselines3, on normalised privileged states."""

    steps: int = Field(default=1_000_000, ge=1, description="Environment steps in all.")
    envs: int = Field(default=8, ge=1, description="Environments in one process.")
    rollout_steps: int = Field(default=256, ge=1, description="Steps of each environment between updates.")
    batch: int = Field(default=256, ge=2, description="Minibatch size.")
    epochs: int = Field(default=8, ge=1, description="Passes over each rollout.")
    width: int = Field(default=256, ge=8, description="Units of the two hidden layers of policy and value function.")
    learning_rate: float = Field(default=1e-4, gt=0, description="Adam's step size at the start.")
    learning_rate_end: float = Field(default=1e-4, gt=0, description="Adam's step size at the end; linear between.")
    gamma: float = Field(default=0.97, gt=0, lt=1, description="Discount.")
    gae_lambda: float = Field(default=0.95, gt=0, le=1, description="Lambda of the advantage estimate.")
    clip: float = Field(default=0.2, gt=0, description="Clip range of the probability ratio.")
    initial_std: float = Field(default=0.37, gt=0, description="Standard deviation of the first policy.")
    entropy: float = Field(default=0.0, ge=0, description="Weight of the entropy bonus.")
    reward_weights: dict[str, float] = Field(
        default_factory=dict, description="Weights of the task's reward terms that differ from the suite's."
    )


class ExpertSettings(Section):
    """Where an expert comes from, and how it is trained."""

    source: Literal["zoo", "train"] = Field(
        default="zoo", description="zoo: the trained expert in zoo/; train: rebuilt from nothing."
    )
    ppo: PPOConfig = Field(default_factory=PPOConfig, description="Training settings; used where source is train.")
    seed: int = Field(default=0, ge=0, description="Seed of training.")
    evaluate_every: int = Field(default=50_000, ge=1, description="Steps between points of the learning curve.")
    evaluation_episodes: int = Field(default=20, ge=1, description="Validation episodes of a learning-curve point.")
    card_episodes: int = Field(default=200, ge=1, description="Held-out episodes behind the success on the card.")
    checkpoint_every: int = Field(
        default=20_000, ge=1, description="Steps between checkpoints.", json_schema_extra={"key": False}
    )


class ExpertRequest(Section):
    """All that an expert artifact depends on."""

    task: TaskConfig
    expert: ExpertSettings = Field(default_factory=ExpertSettings)
