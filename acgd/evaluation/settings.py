"""Evaluation of a student, the clips of it, and the controls it is read beside."""

from typing import Literal

from pydantic import Field, model_validator

from acgd.settings import Request, Section
from acgd.students.settings import ActingConfig
from acgd.tasks.settings import ImageConfig, TaskConfig

Split = Literal["evaluation", "validation"]


class Condition(Section):
    """One way of running the episodes. Each condition of a student is an artifact of its own."""

    goal: Literal["training", "oracle", "commanded", "none"] = Field(
        "training",
        description="training: the last frame of a demonstration of the task, chosen by the episode's seed; misleading "
        "where the goal varies. oracle: the last frame of the expert's own run from the same seed, solved or not. "
        "commanded: the environment's commanded goal as a vector. none: no goal. A student of imitation.goal: vector "
        "always gets commanded, one of imitation.goal: off always none.",
    )
    image_features: Literal["own", "shuffled"] = Field(
        "own",
        description="shuffled: each episode sees the image of another episode at the same time step. What a student "
        "loses by it, it had from the image.",
    )
    start: Literal["perturbed", "nominal"] | None = Field(
        None,
        description="Where episodes start, if not as the task says. nominal: the suite's own start; seeds that would "
        "repeat an episode are left out, so that a Fixed task has one.",
    )


class EvaluationConfig(Section):
    """Episodes on held-out seeds, in lockstep with batched inference."""

    episodes: int = Field(25, ge=1, le=1000, description="Episodes per task and condition.")
    split: Split = Field(
        "evaluation",
        description="Which held-out seeds. Choose settings on validation; evaluation is for the numbers that are "
        "reported.",
    )
    seed_offset: int = Field(
        0, ge=0, description="Skip so many seeds of the split, so that a published result has episodes of its own."
    )
    weights: Literal["best", "last"] = Field(
        "best", description="The student's weights of least validation loss, or of its last step."
    )
    lockstep: int = Field(
        9,
        ge=1,
        le=256,
        description="Environments stepped together, some 0.1 GB each, and the rows of every computation of the "
        "student: always that many, so that an episode does not depend on how many others there are. Another number "
        "can change the last bit of an action.",
    )


class EvaluationRequest(Request):
    """What the episodes of one student under one condition depend on, besides student and backbone."""

    tasks: tuple[TaskConfig, ...] = Field(min_length=1)
    image: ImageConfig = ImageConfig()
    evaluation: EvaluationConfig = Field(
        EvaluationConfig(), description="Stage `evaluation`, one artifact per student and condition."
    )
    condition: Condition
    acting: ActingConfig = ActingConfig()
    seed: int = Field(description="Seed of the student, recorded in the summary.")

    @model_validator(mode="after")
    def _shuffling_needs_another(self) -> "EvaluationRequest":
        episodes, lockstep = self.evaluation.episodes, self.evaluation.lockstep
        if self.condition.image_features == "shuffled" and 1 in (lockstep, episodes % lockstep):
            raise ValueError(
                f"image_features: shuffled needs at least two episodes in each lockstep batch; {episodes} episodes in "
                f"batches of {lockstep} leave one alone. Change evaluation.episodes or evaluation.lockstep."
            )
        return self

    def uses(self, stage: str) -> bool:
        """Demonstrations and experts are read for goal images alone."""
        if stage == "rollouts":
            return self.condition.goal == "training"
        if stage == "expert":
            return self.condition.goal == "oracle"
        return True


class ClipsRequest(Request):
    """What the films of an evaluation depend on, besides the evaluation."""

    tasks: tuple[TaskConfig, ...] = Field(min_length=1)


class ControlsConfig(Section):
    """Policies from the same starts as a student that see nothing, the start alone, or everything."""

    episodes: int = Field(
        25,
        ge=1,
        le=1000,
        description="Episodes per task and control; the same as evaluation.episodes, so that they can be paired.",
    )
    split: Split = Field("evaluation", description="Which held-out seeds; the same as evaluation.split.")
    seed_offset: int = Field(
        0, ge=0, description="Skip so many seeds of the split; the same as evaluation.seed_offset."
    )
    lockstep: int = Field(9, ge=1, le=256, description="Environments stepped together, some 0.1 GB each.")


class ControlsRequest(Request):
    """What the controls depend on, besides demonstrations and experts."""

    tasks: tuple[TaskConfig, ...] = Field(min_length=1)
    controls: ControlsConfig = Field(ControlsConfig(), description="Stage `controls`, one artifact.")
