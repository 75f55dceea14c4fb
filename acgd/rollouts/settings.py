"""On-policy rounds: read by the students that learn from them as well as by the stage that collects them."""

from typing import Literal

from pydantic import Field

from acgd.settings import OUTSIDE_KEY, Section


class RoundsConfig(Section):
    """Rounds in which a student goes on learning from episodes that it has acted in itself."""

    count: int = Field(
        0, ge=0, le=100, description="Rounds after the first training. 0: none.", json_schema_extra=OUTSIDE_KEY
    )
    episodes: int = Field(20, ge=1, le=10_000, description="Episodes per task and round. Failures are kept.")
    beta: float = Field(
        0.5,
        ge=0.0,
        le=1.0,
        description="In round r the expert's mean acts in a step with probability beta ** r, else the student.",
    )
    labels: Literal["expert", "none"] = Field(
        "expert",
        description="expert: the expert's mean is stored for every visited state, and imitated (DAgger). none: "
        "episodes are stored without labels.",
    )
    steps: int = Field(1000, ge=1, description="Optimiser steps of the student in a later round.")
