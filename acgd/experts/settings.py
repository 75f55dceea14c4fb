"""Single-task RL experts."""

from typing import Literal

from pydantic import Field, model_validator

from acgd.settings import Section
from acgd.tasks.settings import TaskConfig


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


class SACConfig(Section):
    """Soft actor-critic with LayerNorm critics, n-step returns and held exploration noise, on normalised privileged states."""

    steps: int = Field(default=1_000_000, ge=1, description="Environment steps in all.")
    envs: int = Field(default=8, ge=1, description="Environments in one process.")
    random_steps: int = Field(default=5_000, ge=1, description="Steps of random actions before learning begins.")
    updates_per_step: float = Field(default=0.25, gt=0, description="Critic updates per environment step.")
    actor_every: int = Field(default=2, ge=1, description="Critic updates to one update of policy and temperature.")
    batch: int = Field(default=256, ge=2, description="Transitions in an update.")
    replay: int = Field(default=1_000_000, ge=1, description="Updates draw from this many of the newest transitions.")
    n_step: int = Field(default=3, ge=1, description="Rewards summed before bootstrapping.")
    width: int = Field(default=256, ge=8, description="Units of the two hidden layers of policy and critics.")
    action_space: Literal["raw", "excitation"] = Field(
        default="raw",
        description="Critics read actions as they are, or as the muscle excitation that MyoSuite makes of them.",
    )
    learning_rate: float = Field(default=3e-4, gt=0, description="Adam's step size at the start.")
    learning_rate_end: float = Field(default=3e-5, gt=0, description="Adam's step size at the end; linear between.")
    gamma: float = Field(default=0.97, gt=0, lt=1, description="Discount.")
    tau: float = Field(
        default=0.005, gt=0, le=1, description="Share of the critics that enters their targets at an update."
    )
    temperature: float = Field(default=0.01, gt=0, description="First weight of the entropy; tuned from there.")
    target_entropy: float = Field(default=-0.5, description="Entropy to keep, per action dimension.")
    hold: float = Field(
        default=2.0,
        gt=1,
        description="Exponent of the Zipf law of how many steps exploration noise is held; higher is shorter.",
    )
    precision: Literal["float32", "bfloat16"] = Field(
        default="bfloat16",
        description="Of the matrix products in an update; bfloat16 is float32 where the hardware lacks it.",
    )


class DaggerConfig(Section):
    """Imitation of the muscle controller, which knows the equations of motion, by dataset aggregation."""

    steps: int = Field(default=200_000, ge=1, description="Labelled environment steps in all.")
    rounds: int = Field(
        default=20, ge=1, description="Parts of equal size; the policy is fitted to all of them after each."
    )
    envs: int = Field(default=8, ge=1, description="Environments in one process.")
    epochs: int = Field(default=6, ge=1, description="Passes over all rounds so far after each round.")
    batch: int = Field(default=256, ge=2, description="Minibatch size.")
    width: int = Field(default=256, ge=8, description="Units of the two hidden layers of the policy.")
    learning_rate: float = Field(
        default=1e-3, gt=0, description="Adam's step size at the start; it falls linearly over the rounds."
    )
    exploration: float = Field(
        default=0.1, gt=0, description="Standard deviation of the noise on the policy's actions while it acts."
    )
    rate: float = Field(default=8.0, gt=0, description="Share of the error that the teacher would undo in a second.")
    damping: float = Field(default=1.5, ge=0, description="Weight of the joints' velocity beside the error's.")
    effort: float = Field(default=1.0, gt=0, description="Weight of muscle activations.")
    gamma: float = Field(
        default=0.97, gt=0, lt=1, description="Discount of the returns that a critic of this expert stands for."
    )


class ExpertSettings(Section):
    """Where an expert comes from, and how it is trained."""

    source: Literal["zoo", "train"] = Field(
        default="zoo", description="zoo: the trained expert in zoo/; train: rebuilt from nothing."
    )
    algorithm: Literal["ppo", "sac", "dagger"] = Field(
        default="ppo", description="What trains it; used where source is train. dagger: pose and reach tasks only."
    )
    ppo: PPOConfig = Field(default_factory=PPOConfig, description="Settings of PPO.")
    sac: SACConfig = Field(default_factory=SACConfig, description="Settings of SAC.")
    dagger: DaggerConfig = Field(default_factory=DaggerConfig, description="Settings of DAgger.")
    reward_weights: dict[str, float] = Field(
        default_factory=dict, description="Weights of the task's reward terms that differ from the suite's."
    )
    advanced_starts: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Share of training episodes that start anywhere on the straight way to the goal, a hand's pose or a key's angle; pose and key-turn tasks only.",
    )
    warm_start: str = Field(
        default="",
        description="What training by PPO or SAC starts from: a task whose expert by the same algorithm is in zoo/, such as myo/pen-twirl "
        "for myo/pen-twirl-hard, or dagger: the muscle controller, which PPO's policy imitates at first, and which acts in the place of "
        "SAC's random actions. Empty: from nothing.",
    )
    seed: int = Field(default=0, ge=0, description="Seed of training.")
    evaluate_every: int = Field(default=50_000, ge=1, description="Steps between points of the learning curve.")
    evaluation_episodes: int = Field(default=20, ge=1, description="Validation episodes of a learning-curve point.")
    card_episodes: int = Field(default=200, ge=1, description="Held-out episodes behind the success on the card.")
    checkpoint_every: int = Field(
        default=20_000, ge=1, description="Steps between checkpoints.", json_schema_extra={"key": False}
    )

    @model_validator(mode="after")
    def _warm_start_fits_the_algorithm(self) -> "ExpertSettings":
        if self.warm_start and self.algorithm == "dagger":
            raise ValueError(
                "expert.warm_start works with expert.algorithm ppo and sac: leave it empty, or choose one of these"
            )
        if (self.algorithm, self.warm_start) == ("ppo", "dagger") and self.ppo.width != self.dagger.width:
            raise ValueError(
                f"expert.warm_start: PPO goes on with the pupil's network: expert.ppo.width {self.ppo.width} "
                f"must be expert.dagger.width {self.dagger.width}"
            )
        return self

    @property
    def first_task(self) -> str:
        """The task whose expert in zoo/ training starts from; empty where there is none."""
        return "" if self.warm_start == "dagger" else self.warm_start

    @property
    def learner(self) -> PPOConfig | SACConfig | DaggerConfig:
        """The section of the chosen algorithm."""
        return getattr(self, self.algorithm)

    def only_used(self) -> "ExpertSettings":
        """Without the settings of the algorithm that is not used: they do not change the expert."""
        sections = {"ppo": PPOConfig(), "sac": SACConfig(), "dagger": DaggerConfig()}
        used = (self.algorithm, self.warm_start)
        return self.model_copy(update={name: default for name, default in sections.items() if name not in used})


class ExpertRequest(Section):
    """All that an expert artifact depends on."""

    task: TaskConfig
    expert: ExpertSettings = Field(default_factory=ExpertSettings)
