"""Settings of imitation, students, on-policy rounds and acting; the requests of the stages codebook and student."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from acgd.guidance.critic.settings import CriticGuidanceConfig
from acgd.guidance.settings import GuidanceConfig
from acgd.settings import OUTSIDE_KEY, Request, Section, one_of
from acgd.students.acgd.settings import ACGDConfig
from acgd.students.kinds import STUDENTS
from acgd.students.training_settings import TrainingConfig
from acgd.tasks.settings import TaskConfig

StudentConfig = one_of(STUDENTS, default="acgd")
"""Settings of one kind. needs: optional stages that the kind reads. chunk, history: actions and states in a window.
recurrent: whether a window has an observation for each of its actions.
"""


class ImitationConfig(Section):
    """Labels, goals and frames of imitation."""

    label: Literal["mean", "executed"] = Field(
        "mean", description="Label of a step. mean: the expert's mean action. executed: the action that was executed."
    )
    action_space: Literal["raw", "excitation"] = Field(
        "raw",
        description="Space of the imitation losses. raw: actions. excitation: the muscle excitation that MyoSuite "
        "computes from an action.",
    )
    goal: Literal["own", "any", "vector", "off"] = Field(
        "any",
        description="Goal in training. any: goal image o_T of any training episode of the task, for an evaluation with "
        "goal `training`. own: goal image of the same episode (the paper), for goal `oracle`. vector: commanded goal "
        "of the environment (docs/tasks.md). off: no goal.",
    )
    frames: int = Field(
        1, ge=1, description="Frames whose features the student reads: the current one and earlier ones, oldest first."
    )
    frame_stride: int = Field(
        1,
        ge=1,
        description="Steps between two of these frames. An episode's first frame repeats before its start.",
    )


class ActingConfig(Section):
    """How overlapping chunks become one action per step (Section III-A)."""

    mode: Literal["ensemble-paper", "ensemble-act", "first", "open-loop"] = Field(
        "ensemble-paper",
        description="Action of a step. ensemble-paper, ensemble-act: mean of all chunks that cover the step, with the "
        "greatest weight on the newest (paper) or the oldest (ACT). first: first action of a new chunk. open-loop: "
        "every chunk is executed to its end.",
    )
    eta: Annotated[float, Field(ge=0)] = Field(2.0, description="Decay rate eta of the ensembling weights exp(-eta i).")


class RoundEpisodes(Section):
    """The episodes of one on-policy round."""

    episodes: int = Field(10, ge=1, le=10_000, description="Episodes of each task in each round.")
    beta: Annotated[float, Field(ge=0, le=1)] = Field(
        0.5, description="In round r the expert acts in place of the student with probability beta ** r, in each step."
    )
    labels: Literal["expert", "none"] = Field(
        "expert",
        description="expert: the student imitates the expert's mean in visited states (DAgger). none: guidance alone "
        "trains the student on these states.",
    )


class RoundsConfig(RoundEpisodes):
    """On-policy rounds: the student acts, and goes on learning from the states that it visits."""

    count: int = Field(0, ge=0, le=100, description="Rounds after the demonstrations.", json_schema_extra=OUTSIDE_KEY)
    steps: int = Field(1000, ge=1, description="Optimiser steps of each round, in place of training.steps.")


class CodebookRequest(Request):
    """Request of one codebook."""

    tasks: list[TaskConfig]
    imitation: ImitationConfig = Field(ImitationConfig(), description="The same for every kind of student.")
    student: StudentConfig = ACGDConfig()
    seed: Annotated[int, Field(ge=0)]

    @model_validator(mode="after")
    def _a_batch_holds_every_task(self) -> "CodebookRequest":
        if "codebook" not in self.student.needs:
            raise ValueError(f"a student of kind {self.student.kind} has no codebook. Set student.kind to acgd.")
        _check_batch("student.codebook.training.batch", self.student.codebook.training, self.tasks)
        return self


class StudentRequest(Request):
    """Request of the student of one round."""

    tasks: list[TaskConfig]
    imitation: ImitationConfig = ImitationConfig()
    student: StudentConfig = Field(
        ACGDConfig(),
        description="Architecture of the student. Stage `student`, one artifact per student seed and round.",
    )
    training: TrainingConfig = Field(TrainingConfig(), description="Optimisation of a student of any kind.")
    guidance: GuidanceConfig = Field(CriticGuidanceConfig(), description="Loss besides imitation.")
    rounds: RoundsConfig | None = None
    """None in round 0, which trains on demonstrations only."""
    round: Annotated[int, Field(ge=0)] = 0
    seed: Annotated[int, Field(ge=0)]

    def uses(self, stage: str) -> bool:
        """True for stages that the kinds of student and guidance need. From round 1 on: also for stages of rounds."""
        if stage in ("student", "onpolicy", "onpolicy_features"):
            return self.round > 0
        return stage == "features" or stage in (*self.student.needs, *self.guidance.needs)

    @model_validator(mode="after")
    def _a_batch_holds_every_task(self) -> "StudentRequest":
        _check_batch("training.batch", self.training, self.tasks)
        return self

    @model_validator(mode="after")
    def _rounds_of_a_later_round(self) -> "StudentRequest":
        if (self.round > 0) != (self.rounds is not None):
            raise ValueError(
                f"round {self.round} does not go with rounds {self.rounds}: rounds is for round 1 and later ones. Set "
                "rounds to null in round 0, and only there."
            )
        return self


def _check_batch(field: str, training: TrainingConfig, tasks: list[TaskConfig]) -> None:
    """Raises ValueError where a batch has fewer windows than there are tasks: it would lack the last tasks."""
    if training.batch < len(tasks):
        raise ValueError(f"{field} is {training.batch} for {len(tasks)} tasks: set it to {len(tasks)} or more.")
