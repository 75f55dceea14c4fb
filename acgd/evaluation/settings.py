"""Settings and requests of the stages `evaluation`, `clips` and `controls`."""

from typing import Literal

from pydantic import Field, model_validator

from acgd.settings import Request, Section
from acgd.students.settings import ActingConfig
from acgd.tasks.settings import ImageConfig, TaskConfig

Split = Literal["evaluation", "validation"]


class Condition(Section):
    """Condition of an evaluation. Each condition of a student gives one artifact."""

    goal: Literal["training", "oracle", "commanded", "none"] = Field(
        "training",
        description="Goal. training: last frame of a demonstration of the task, chosen by the episode's seed; "
        "misleading where the goal varies. oracle: last frame of the expert's episode from the same seed, solved or "
        "not. commanded: commanded goal of the environment. none: no goal. A student with imitation.goal `vector` "
        "always gets `commanded`, one with `off` always `none`.",
    )
    image_features: Literal["own", "shuffled"] = Field(
        "own",
        description="Images of the policy. own: of the episode. shuffled: in each step the image of another episode at "
        "the same step. The loss of success measures how much the student uses its images.",
    )
    start: Literal["perturbed", "nominal"] | None = Field(
        None,
        description="Start of the episodes; without it, the task's start. nominal: the suite's start. Seeds that would "
        "repeat an episode are left out, so that a Fixed task has one episode.",
    )


class EvaluationConfig(Section):
    """Episodes on held-out seeds, in lockstep with batched inference."""

    episodes: int = Field(25, ge=1, le=1000, description="Episodes per task and condition.")
    split: Split = Field(
        "evaluation",
        description="Held-out seeds. validation: for choosing settings. evaluation: for reported numbers.",
    )
    seed_offset: int = Field(
        0, ge=0, description="Number of skipped seeds of the split. It gives a published result unused episodes."
    )
    weights: Literal["best", "last"] = Field(
        "best", description="Weights of the student. best: of least validation error. last: of the last step."
    )
    lockstep: int = Field(
        9,
        ge=1,
        le=256,
        description="Environments in lockstep, some 0.1 GB each, and rows of every computation of the student. The "
        "rows are constant, so that an episode does not depend on the number of others. Another value can change the "
        "last bit of an action.",
    )


class EvaluationRequest(Request):
    """Request of one evaluation: one student under one condition."""

    tasks: tuple[TaskConfig, ...] = Field(min_length=1)
    image: ImageConfig = ImageConfig()
    evaluation: EvaluationConfig = Field(
        EvaluationConfig(), description="Stage `evaluation`, one artifact per student and condition."
    )
    condition: Condition
    acting: ActingConfig = ActingConfig()
    seed: int = Field(description="Student seed, recorded in the summary.")

    @model_validator(mode="after")
    def _shuffling_needs_another(self) -> "EvaluationRequest":
        episodes, lockstep = self.evaluation.episodes, self.evaluation.lockstep
        if self.condition.image_features == "shuffled" and 1 in (lockstep, episodes % lockstep):
            raise ValueError(
                f"{episodes} episodes in lockstep batches of {lockstep} leave one alone, and image_features: shuffled "
                "needs two episodes in each batch. Change evaluation.episodes or evaluation.lockstep."
            )
        return self

    def uses(self, stage: str) -> bool:
        """True for rollouts with goal `training`, and for experts with goal `oracle`."""
        if stage == "rollouts":
            return self.condition.goal == "training"
        if stage == "expert":
            return self.condition.goal == "oracle"
        return True


class ClipsRequest(Request):
    """Request of the films of an evaluation."""

    tasks: tuple[TaskConfig, ...] = Field(min_length=1)


class ControlsConfig(Section):
    """Control policies from a student's starts. They read nothing, the first state only, or the privileged state."""

    episodes: int = Field(
        25,
        ge=1,
        le=1000,
        description="Episodes per task and control. Set it like evaluation.episodes, so that episodes can be paired.",
    )
    split: Split = Field("evaluation", description="Held-out seeds. Set it like evaluation.split.")
    seed_offset: int = Field(
        0, ge=0, description="Number of skipped seeds of the split. Set it like evaluation.seed_offset."
    )
    lockstep: int = Field(9, ge=1, le=256, description="Environments in lockstep, some 0.1 GB each.")


class ControlsRequest(Request):
    """Request of the controls of all tasks."""

    tasks: tuple[TaskConfig, ...] = Field(min_length=1)
    controls: ControlsConfig = Field(ControlsConfig(), description="Stage `controls`, one artifact.")
