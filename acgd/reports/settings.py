"""The report: which artifacts it reads, and what it puts first."""

from typing import Literal

from pydantic import Field, JsonValue

from acgd.settings import Request, Section


class ReportConfig(Section):
    """How the report tells the story of a study."""

    success: Literal["final", "held", "once"] = Field(
        "final",
        description="Success rule of the headline, the differences and the controls. success.csv has all three.",
    )
    baseline: str | None = Field(
        None,
        description="Variant that the others are compared with, episode by episode. "
        "Without one it is the first variant that learns without guidance.",
    )
    clips: bool = Field(
        True,
        description="Embed the clips of a success and a failure per task; they are some megabytes.",
    )


class ReportEntry(Section):
    """One trained student and the artifacts behind it."""

    variant: str = Field(description="Name of the variant.")
    seed: int = Field(description="Student seed.")
    artifacts: dict[str, tuple[int, ...]] = Field(
        description="Stage -> places in the report's inputs of that stage. A stage per task has one place per task, "
        "`evaluation` one per condition with the headline first, `student` one per round."
    )

    def places(self, stage: str) -> tuple[int, ...]:
        """Places in inputs[stage]; empty for a student without that stage."""
        return self.artifacts.get(stage, ())


class ReportRequest(Request):
    """What the report depends on.

    Its inputs are lists of artifact directories by the name of their stage. Each artifact is listed once, however many
    entries use it.
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

    def variants(self) -> list[str]:
        """Names of the variants in the study's order."""
        return list(dict.fromkeys(entry.variant for entry in self.entries))
