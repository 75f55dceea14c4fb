"""Settings that all learners share. They are not in settings.py, because that file imports every learner's settings."""

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

from pydantic import Field

from acgd.settings import OUTSIDE_KEY, Section


class LearnerSettings(Section):
    """Base of the settings of learners. A learner is a subclass with `kind`, `algorithm`, `steps` and other fields."""

    algorithm: ClassVar[str]
    """Name of the algorithm on the expert's card."""
    learns_critics: ClassVar[bool] = False
    """Whether the artifact includes critics that the learner trains with its policy."""

    gamma: float = Field(default=0.97, gt=0, lt=1, description="Discount of the returns that training and critics use.")
    envs: int = Field(default=8, ge=1, description="Environments in one process.")
    width: int = Field(default=256, ge=8, description="Units of each of the two hidden layers of the networks.")
    reward_weights: dict[str, float] = Field(
        default_factory=dict, description="Weights of the task's reward terms that differ from the suite's."
    )
    seed: int = Field(default=0, ge=0, description="Seed of training.")
    evaluate_every: int = Field(default=50_000, ge=1, description="Steps between points of the learning curve.")
    evaluation_episodes: int = Field(default=20, ge=1, description="Validation episodes of a learning-curve point.")
    checkpoint_every: int = Field(
        default=20_000, ge=1, description="Steps between checkpoints.", json_schema_extra=OUTSIDE_KEY
    )

    def files(self, task: str) -> tuple[Path, ...]:
        """Files outside the store that training for `task` reads."""
        return ()

    def faults(self, task: str) -> Iterator[str]:
        """Messages on settings that do not fit `task`, each with its mend."""
        return iter(())

    def has_critics(self, task: str) -> bool:
        """Whether the expert of `task` has critics that were trained with its policy."""
        return self.learns_critics
