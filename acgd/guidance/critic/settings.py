"""Settings of critic guidance (Section III-B)."""

from typing import Annotated, Literal

from pydantic import Field

from acgd.settings import Section


class CriticGuidanceConfig(Section):
    """The frozen critics of the experts judge the student's actions: alpha L_BC + gate_i L_distill, Eq. (1)."""

    kind: Literal["critic"] = "critic"
    gate: Literal["one", "reliable"] = Field(
        "one", description="one: every task is guided (the paper); reliable: only tasks whose critic ranks actions well"
    )
    reliable_rank: float = Field(
        0.2, description="gate reliable: least low end of the interval of the within-state rank correlation"
    )
    guided_steps: Literal["chunk", "first"] = Field(
        "chunk", description="actions the critic judges: every step of the chunk, or the first"
    )
    guided_fraction: Annotated[float, Field(gt=0, le=1)] = Field(
        0.25,
        description="share of each batch the critics see, at least one window; the expectation of L_distill does not "
        "depend on it",
    )
    alpha: Annotated[float, Field(gt=0)] = Field(
        10.0, description="alpha, weight of L_BC against L_distill, Eq. (1); the loss is divided by it"
    )
    pessimism: Annotated[float, Field(ge=0)] = Field(
        1.0, description="standard deviations of the critic ensemble taken off its mean"
    )

    @property
    def needs(self) -> tuple[str, ...]:
        """The critics; their measured quality too, where it closes gates."""
        return ("critic", "quality") if self.gate == "reliable" else ("critic",)
