"""Settings and request of the stage `report`."""

from typing import Literal

from pydantic import Field, JsonValue

from acgd.settings import Request, Section


class ReportConfig(Section):
    """Headline rule, baseline and clips of the report."""

    success: Literal["final", "held", "once"] = Field(
        "final",
        description="Success rule of the headline, the differences and the controls. success.csv has all three rules.",
    )
    baseline: str | None = Field(
        None,
        description="Variant that the others are compared with, episode by episode. "
        "Without it: the first variant without guidance.",
    )
    clips: bool = Field(
        True,
        description="Embed the clips of a success and a failure per task, some megabytes.",
    )


class ReportEntry(Section):
    """One student and the artifacts that it depends on."""

    variant: str = Field(description="Name of the variant.")
    seed: int = Field(description="Student seed.")
    artifacts: dict[str, tuple[int, ...]] = Field(
        description="Stage -> indices in the report's inputs of that stage. A stage per task has one index per task, "
        "`evaluation` one per condition with the headline first, `student` one per round."
    )

    def places(self, stage: str) -> tuple[int, ...]:
        """Indices in inputs[stage]; empty for a student without that stage."""
        return self.artifacts.get(stage, ())


class ReportRequest(Request):
    """Request of the report.

    The inputs are lists of artifact directories, by stage. Each artifact is listed once, for any number of entries.
    """

    study: str = Field(description="Name of the study.")
    tasks: tuple[str, ...] = Field(description="Task names in the study's order, which is the order of the task ids.")
    entries: tuple[ReportEntry, ...] = Field(
        description="One entry per variant and student seed, in the study's order."
    )
    report: ReportConfig = ReportConfig()
    configuration: dict[str, JsonValue] = Field(
        default_factory=dict, description="The study's validated configuration, printed on the page."
    )

    def variants(self) -> list[str]:
        """Names of the variants in the study's order."""
        return list(dict.fromkeys(entry.variant for entry in self.entries))
