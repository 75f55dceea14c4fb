"""The report: which artifacts it reads, and what it puts first."""

from typing import Literal

from pydantic import Field, JsonValue

from acgd.settings import Section


class ReportConfig(Section):
    """How the report tells the story of a study."""

    success: Literal["final", "held", "once"] = Field(
        "final",
        description="Success rule of the headline, the paired differences and the controls. success.csv holds all three.",
    )
    baseline: str | None = Field(
        None,
        description="Variant that the others are compared with, episode by episode. Without one: the first variant that learns without guidance.",
    )
    clips: bool = Field(
        True,
        description="Embed the clips of a success and a failure per task. Without them the page is some megabytes smaller.",
    )


class ReportEntry(Section):
    """One trained student and the chain behind it. Each number is a place in the report's inputs of that stage's name."""

    variant: str = Field(description="Name of the variant.")
    seed: int = Field(description="Student seed.")
    student: int = Field(description="Place in inputs['student'].")
    evaluation: int = Field(description="Place in inputs['evaluation'].")
    codebook: int | None = Field(None, description="Place in inputs['codebook']; none for a student without one.")
    backbone: int | None = Field(None, description="Place in inputs['backbone'].")
    expert: tuple[int, ...] = Field((), description="Places in inputs['expert'], one per task of the study.")
    critic: tuple[int, ...] = Field(
        (), description="Places in inputs['critic'], one per task; empty for a student without guidance."
    )
    rollouts: tuple[int, ...] = Field((), description="Places in inputs['rollouts'], one per task.")
    features: tuple[int, ...] = Field(
        (), description="Places in inputs['features'], one per task; empty where the student learns its own."
    )
    controls: int | None = Field(None, description="Place in inputs['controls']; none for a study without controls.")


class ReportRequest(Section):
    """What the report stage is asked for.

    Its inputs are lists of artifact directories by stage name (`expert`, `critic`, `rollouts`, `backbone`, `features`,
    `codebook`, `student`, `evaluation`, `controls`), each artifact once, however many entries use it.
    """

    study: str = Field(description="Name of the study.")
    tasks: tuple[str, ...] = Field(description="Task names in the study's order, which is the order of the task ids.")
    entries: tuple[ReportEntry, ...] = Field(
        description="Variants in the study's order, and within one its student seeds."
    )
    report: ReportConfig = ReportConfig()
    configuration: dict[str, JsonValue] = Field(
        default_factory=dict, description="The study's validated configuration, printed on the page."
    )
