"""Evaluation of a student, and the controls it is read beside."""

from typing import Literal

from pydantic import Field, model_validator

from acgd.settings import Section
from acgd.students.settings import ActingConfig
from acgd.tasks.settings import TaskConfig


class Condition(Section):
    """One way of running the episodes. A student takes part in every condition of its evaluation."""

    goal: Literal["training", "oracle"] = Field(
        "training",
        description="Goal image o_T. training: the last frame of a demonstration of the task, chosen by the episode's seed; misleading where the "
        "goal varies. oracle: the last frame of the expert's own run from the same seed, solved or not. A student trained without a goal gets none.",
    )
    image_features: Literal["own", "shuffled"] = Field(
        "own",
        description="shuffled: each episode sees the image of another episode at the same time step. What a student loses by it, it had from the image.",
    )
    start: Literal["perturbed", "nominal"] | None = Field(
        None,
        description="Where episodes start, if not as the task says. nominal: the suite's own start; seeds that would repeat an episode are left "
        "out, so that a Fixed task has one.",
    )


class EvaluationConfig(Section):
    """Episodes on held-out seeds, in lockstep with batched inference."""

    episodes: int = Field(25, ge=1, le=1000, description="Episodes per task and condition.")
    split: Literal["evaluation", "validation"] = Field(
        "evaluation",
        description="Which held-out seeds. Choose settings on validation; evaluation is for the numbers that are reported.",
    )
    conditions: tuple[Condition, ...] = Field(
        (Condition(),), min_length=1, description="The first one is the headline."
    )
    weights: Literal["best", "last"] = Field(
        "best", description="The student's weights of least validation loss, or of its last step."
    )
    acting: ActingConfig = Field(ActingConfig(), description="How chunks become actions.")
    lockstep: int = Field(
        9,
        ge=1,
        le=256,
        description="Environments stepped together, some 0.1 GB each, and the rows of every computation of the student: always that many, so that an "
        "episode does not depend on how many others there are. Another number can change the last bit of an action.",
    )
    clips: bool = Field(
        True, description="Film the first success and the first failure of each task in the headline condition."
    )

    @model_validator(mode="after")
    def _shuffling_needs_another(self) -> "EvaluationConfig":
        if any(c.image_features == "shuffled" for c in self.conditions) and 1 in (
            self.lockstep,
            self.episodes % self.lockstep,
        ):
            raise ValueError(
                f"image_features: shuffled needs at least two episodes in each lockstep batch; {self.episodes} episodes in batches of "
                f"{self.lockstep} leave one alone. Change evaluation.episodes or evaluation.lockstep."
            )
        return self


class EvaluationRequest(Section):
    """What the evaluation stage is asked for."""

    tasks: tuple[TaskConfig, ...] = Field(description="In the study's order, which is the order of the task ids.")
    evaluation: EvaluationConfig = EvaluationConfig()
    seed: int = Field(0, description="Seed of the student, recorded with each episode.")


class ControlsConfig(Section):
    """What a policy that sees little, or all, does from the same starts."""

    episodes: int = Field(
        25,
        ge=1,
        le=1000,
        description="Episodes per task and control; the same as evaluation.episodes, so that they can be paired.",
    )
    split: Literal["evaluation", "validation"] = Field(
        "evaluation", description="Which held-out seeds; the same as evaluation.split."
    )
    lockstep: int = Field(9, ge=1, le=256, description="Environments stepped together, some 0.1 GB each.")


class ControlsRequest(Section):
    """What the controls stage is asked for."""

    tasks: tuple[TaskConfig, ...] = Field(description="In the study's order.")
    controls: ControlsConfig = ControlsConfig()
