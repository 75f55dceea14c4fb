"""Settings of SAC."""

from typing import ClassVar, Literal

from pydantic import Field

from acgd.experts.reinforcement import ReinforcementSettings


class SACSettings(ReinforcementSettings):
    """Soft actor-critic with LayerNorm critics, n-step returns and held exploration noise, on normalised privileged
    states."""

    algorithm: ClassVar[str] = "SAC"
    learns_critics: ClassVar[bool] = True

    kind: Literal["sac"] = "sac"
    steps: int = Field(default=1_000_000, ge=1, description="Environment steps in total.")
    random_steps: int = Field(default=5_000, ge=1, description="Steps of random actions before learning begins.")
    updates_per_step: float = Field(default=0.25, gt=0, description="Critic updates per environment step.")
    actor_every: int = Field(default=2, ge=1, description="Critic updates to one update of policy and temperature.")
    batch: int = Field(default=256, ge=2, description="Transitions in an update.")
    replay: int = Field(default=1_000_000, ge=1, description="Updates draw from this many of the newest transitions.")
    n_step: int = Field(default=3, ge=1, description="Rewards summed before bootstrapping.")
    action_space: Literal["raw", "excitation"] = Field(
        default="raw",
        description="Input of the critics: raw actions, or the muscle excitation that MyoSuite computes.",
    )
    learning_rate: float = Field(default=3e-4, gt=0, description="Adam's step size at the start.")
    learning_rate_end: float = Field(default=3e-5, gt=0, description="Adam's step size at the end; linear between.")
    tau: float = Field(
        default=0.005, gt=0, le=1, description="Share of the critics that enters their targets at an update."
    )
    temperature: float = Field(default=0.01, gt=0, description="Initial weight of the entropy, which is then tuned.")
    target_entropy: float = Field(default=-0.5, description="Target of the policy's entropy, per action dimension.")
    hold: float = Field(
        default=2.0,
        gt=1,
        description="Exponent of the Zipf law of the length in steps of held exploration noise. Higher is shorter.",
    )
    precision: Literal["float32", "bfloat16"] = Field(
        default="bfloat16",
        description="Precision of matrix products in an update. bfloat16 is float32 where the hardware lacks it.",
    )
