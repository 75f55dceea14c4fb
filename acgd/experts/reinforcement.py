"""Settings that PPO and SAC share: the start of training and of its episodes."""

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

from pydantic import Field, model_validator

from acgd.experts import zoo
from acgd.experts.learner import LearnerSettings
from acgd.experts.muscle.settings import ControllerSettings, without_controller
from acgd.tasks.spec import TASKS

ADVANCED_KINDS = ("key-turn", "pose")
"""Kinds of tasks with starts on the way to the goal. A test compares this list with acgd/tasks/spec.py."""


class ReinforcementSettings(LearnerSettings):
    """Start of training and of its episodes, for PPO and SAC."""

    muscle_settings: ClassVar[type[ControllerSettings]] = ControllerSettings
    """Class of the field `muscle`."""

    advanced_starts: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Share of training episodes that start on the straight way to the goal, a hand's pose or a key's "
        "angle. Only pose and key-turn tasks have such starts.",
    )
    warm_start: str = Field(
        default="",
        description="Start of training. Empty: an untrained policy. A task, such as myo/pen-twirl for "
        "myo/pen-twirl-hard: the expert in zoo/ by the same algorithm. muscle: the muscle controller. PPO first trains "
        "its policy to imitate the controller. SAC replaces its first random actions by those of the controller.",
    )
    muscle: ControllerSettings | None = Field(
        default=None, description="Settings of the muscle controller. Only with warm_start: muscle."
    )

    @model_validator(mode="after")
    def _muscle_belongs_to_its_warm_start(self) -> "ReinforcementSettings":
        if self.warm_start == "muscle" and self.muscle is None:
            # The key includes the defaults. pydantic's setter would count the field as set by the user.
            self.__dict__["muscle"] = self.muscle_settings()
        if self.warm_start != "muscle" and self.muscle is not None:
            raise ValueError(
                "muscle is read with warm_start: muscle only. Set warm_start to muscle, or muscle to null."
            )
        return self

    @property
    def warm_start_task(self) -> str:
        """The task of the zoo expert that training starts from; empty where there is none."""
        return "" if self.warm_start == "muscle" else self.warm_start

    def files(self, task: str) -> tuple[Path, ...]:
        """The policy, and its critics if any, that training starts from."""
        return zoo.policy_files(self.warm_start_task) if self.warm_start_task else ()

    def faults(self, task: str) -> Iterator[str]:
        """Messages on starts that the task or the zoo does not have."""
        if self.warm_start_task and not zoo.has_expert(self.warm_start_task):
            yield (
                f"expert.warm_start: zoo/ has no expert for {self.warm_start_task}. "
                f"Leave it empty, or take one that it has: {zoo.tasks_with(zoo.has_expert)}."
            )
        elif self.warm_start_task and self.learns_critics and not zoo.has_learned_critics(self.warm_start_task):
            yield (
                f"expert.warm_start: the expert in zoo/ for {self.warm_start_task} has no critics for "
                f"{self.algorithm} to go on with. Leave it empty, or take: {zoo.tasks_with(zoo.has_learned_critics)}."
            )
        if self.warm_start == "muscle":
            yield from without_controller(task, "expert.warm_start", "Leave it empty")
        if self.advanced_starts and TASKS[task].kind not in ADVANCED_KINDS:
            yield (
                f"expert.advanced_starts: {task} has no start on the way to its goal, only "
                f"{' and '.join(ADVANCED_KINDS)} tasks have. Leave it at 0."
            )
