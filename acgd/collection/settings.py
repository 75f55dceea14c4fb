"""Demonstrations: how many, and how the expert acts while they are recorded. On-policy episodes of a student."""

from typing import Any, Literal

from pydantic import Field, field_validator

from acgd.settings import Request, Section
from acgd.students.settings import ActingConfig, RoundEpisodes
from acgd.tasks.settings import ImageConfig, TaskConfig


class RolloutsConfig(Section):
    """Successful expert episodes of one task."""

    demonstrations: int = Field(
        50, ge=1, description="Successful episodes to keep. Success is `final`: solved at the last step."
    )
    acting: Literal["stochastic", "mean"] = Field(
        "mean", description="The expert samples its own policy, or acts by the mean. The mean is stored beside either."
    )
    noise: float = Field(
        0.1,
        ge=0.0,
        description="Standard deviation of Gaussian noise added to every action, before clipping to [-1, 1].",
    )
    keep_failures: bool = Field(False, description="Store the failed episodes too, in the group `failures`.")
    seed_offset: int = Field(0, ge=0, description="Skip so many of the seeds set aside for demonstrations.")
    attempts: int = Field(
        4, ge=1, description="Give up after attempts x demonstrations episodes, with an error that names the mend."
    )
    lockstep: int = Field(
        10,
        ge=1,
        description="Episodes run side by side, with one batched inference. Batching can change the last bit of an "
        "action.",
    )


class RolloutsRequest(Request):
    """What the stage `rollouts` depends on, besides the expert."""

    task: TaskConfig
    image: ImageConfig = Field(ImageConfig(), description="Pictures of all tasks.")
    rollouts: RolloutsConfig = Field(RolloutsConfig(), description="Stage `rollouts`, one artifact per task.")


class OnPolicyRequest(Request):
    """What the episodes of one round and task depend on, besides student, expert and demonstrations."""

    task: TaskConfig
    image: ImageConfig
    acting: ActingConfig = Field(ActingConfig(), description="How students act, in rounds and in evaluations.")
    rounds: RoundEpisodes
    round: int = Field(ge=1, description="Number of the round. The student is that of the round before.")
    seed: int = Field(ge=0, description="Seed of the student. Students of different seeds begin at different episodes.")

    @field_validator("rounds", mode="before")
    @classmethod
    def _episodes_alone(cls, rounds: RoundEpisodes | dict[str, Any]) -> dict[str, Any]:
        """Without what the student alone reads, such as its optimiser steps."""
        content = rounds if isinstance(rounds, dict) else rounds.model_dump()
        return {name: content[name] for name in RoundEpisodes.model_fields if name in content}
