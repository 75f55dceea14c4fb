"""Settings of the muscle controller and of its imitation."""

from collections.abc import Iterator
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from acgd.experts.learner import LearnerSettings
from acgd.settings import Section
from acgd.tasks.spec import TASKS

CONTROLLED_KINDS = ("pose", "reach")
"""Kinds of tasks with a muscle controller. A test compares this list with acgd/experts/muscle/control.py."""


class ControllerSettings(Section):
    """The muscle controller: docs/method.md, "Muscle controller"."""

    rate: float = Field(default=8.0, gt=0, description="Share of the error that the controller corrects per second.")
    damping: float = Field(
        default=1.5, ge=0, description="Weight of joint velocities in least squares; the error has weight 1."
    )
    effort: float = Field(default=1.0, gt=0, description="Weight of muscle activations in least squares.")


class ImitationSettings(ControllerSettings):
    """Imitation of the muscle controller by dataset aggregation (DAgger)."""

    steps: int = Field(default=200_000, ge=1, description="Environment steps that the controller labels, in total.")
    rounds: int = Field(
        default=20,
        ge=1,
        description="Rounds of equal size. After each round the policy is fitted to all rounds so far.",
    )
    epochs: int = Field(default=6, ge=1, description="Passes over all rounds so far after each round.")
    batch: int = Field(default=256, ge=2, description="Minibatch size.")
    learning_rate: float = Field(
        default=1e-3, gt=0, description="Adam's step size at the start; it falls linearly over the rounds."
    )
    exploration: float = Field(
        default=0.1, gt=0, description="Standard deviation of the noise on the policy's actions while it acts."
    )


class MuscleSettings(ImitationSettings, LearnerSettings):
    """Imitation of the muscle controller, for pose and reach tasks."""

    algorithm: ClassVar[str] = "DAgger"
    advanced_starts: ClassVar[float] = 0.0
    """Share of episodes with advanced starts: none."""

    kind: Literal["muscle"] = "muscle"

    @model_validator(mode="after")
    def _a_round_has_states(self) -> "MuscleSettings":
        if self.steps // self.rounds < max(2, self.envs):
            raise ValueError(
                f"steps {self.steps} in {self.rounds} rounds are fewer than a step of each of {self.envs} "
                "environments, or fewer than two. Raise steps, or lower rounds or envs."
            )
        return self

    def faults(self, task: str) -> Iterator[str]:
        """A message where the task has no muscle controller."""
        yield from without_controller(task, "expert.kind", "Choose ppo or sac")


def without_controller(task: str, place: str, mend: str) -> Iterator[str]:
    """A message where the task has no muscle controller; `place` names the setting, `mend` the remedy."""
    if TASKS[task].kind not in CONTROLLED_KINDS:
        yield f"{place}: {task} has no muscle controller, only {' and '.join(CONTROLLED_KINDS)} tasks have. {mend}."
