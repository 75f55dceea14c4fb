"""Settings and requests of the stages `rollouts` and `onpolicy`."""

from typing import Any, Literal

from pydantic import Field, field_validator

from acgd.settings import Request, Section
from acgd.students.settings import ActingConfig, RoundEpisodes
from acgd.tasks.settings import ImageConfig, TaskConfig


class RolloutsConfig(Section):
    """Successful expert episodes of one task."""

    demonstrations: int = Field(
        50, ge=1, description="Number of successful episodes. Success is `final`: solved at the last step."
    )
    acting: Literal["stochastic", "mean"] = Field(
        "mean",
        description="Actions of the expert. stochastic: samples of its policy. mean: its mean action. The mean is "
        "stored in both cases.",
    )
    noise: float = Field(
        0.1,
        ge=0.0,
        description="Standard deviation of Gaussian noise added to every action, before clipping to [-1, 1].",
    )
    keep_failures: bool = Field(False, description="Also store the failed episodes, in the group `failures`.")
    seed_offset: int = Field(0, ge=0, description="Number of skipped seeds of the range for demonstrations.")
    attempts: int = Field(
        4,
        ge=1,
        description="The stage fails after attempts x demonstrations episodes, with an error that names the mend.",
    )
    lockstep: int = Field(
        10,
        ge=1,
        description="Episodes in lockstep, with one batched inference. Another value can change the last bit of an "
        "action.",
    )


class RolloutsRequest(Request):
    """Request of the demonstrations of one task."""

    task: TaskConfig
    image: ImageConfig = Field(ImageConfig(), description="Pictures of all tasks.")
    rollouts: RolloutsConfig = Field(RolloutsConfig(), description="Stage `rollouts`, one artifact per task.")


class OnPolicyRequest(Request):
    """Request of the on-policy episodes of one round and task."""

    task: TaskConfig
    image: ImageConfig
    acting: ActingConfig = Field(ActingConfig(), description="Actions of students, in rounds and in evaluations.")
    rounds: RoundEpisodes
    round: int = Field(ge=1, description="Number of the round. The student is that of the previous round.")
    seed: int = Field(ge=0, description="Student seed. It determines the seeds of the episodes.")

    @field_validator("rounds", mode="before")
    @classmethod
    def _episodes_alone(cls, rounds: RoundEpisodes | dict[str, Any]) -> dict[str, Any]:
        """Without what the student alone reads, such as its optimiser steps."""
        content = rounds if isinstance(rounds, dict) else rounds.model_dump()
        return {name: content[name] for name in RoundEpisodes.model_fields if name in content}
