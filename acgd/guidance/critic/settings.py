"""Settings of critic guidance (Section III-B)."""

from typing import Annotated, Literal

from pydantic import Field

from acgd.settings import Section


class CriticGuidanceConfig(Section):
    """The frozen critics of the experts evaluate the student's actions: alpha L_BC + gate_i L_distill, Eq. (1)."""

    kind: Literal["critic"] = "critic"
    gate: Literal["one", "reliable"] = Field(
        "one",
        description="Gate of a task, gate_i. one: guides every task (the paper). reliable: guides a task only if its "
        "critic ranks actions well, see reliable_rank.",
    )
    reliable_rank: float = Field(
        0.2,
        description="Gate `reliable` opens where the low end of the interval of the within-state rank correlation "
        "reaches this value.",
    )
    guided_steps: Literal["chunk", "first"] = Field(
        "chunk", description="Actions that the critic evaluates. chunk: every step of the chunk. first: its first step."
    )
    guided_fraction: Annotated[float, Field(gt=0, le=1)] = Field(
        0.25,
        description="Share of each batch that the critics evaluate, at least one window. The expectation of L_distill "
        "does not depend on it.",
    )
    alpha: Annotated[float, Field(gt=0)] = Field(
        10.0, description="Weight alpha of L_BC relative to L_distill, Eq. (1). The loss is divided by alpha."
    )
    pessimism: Annotated[float, Field(ge=0)] = Field(
        1.0, description="Number of standard deviations of the critic ensemble that are subtracted from its mean."
    )

    @property
    def needs(self) -> tuple[str, ...]:
        """Stages that guidance reads: the critics, and their measured quality if the gate depends on it."""
        return ("critic", "quality") if self.gate == "reliable" else ("critic",)
