"""Settings of the format `lerobot`."""

from typing import ClassVar, Literal

from pydantic import Field

from acgd.settings import Section


class LeRobotSettings(Section):
    """LeRobotDataset v3.0: parquet, with images as PNG in it or as mp4 beside it. All tasks are one dataset."""

    stages: ClassVar[tuple[str, ...]] = ("rollouts", "onpolicy")

    kind: Literal["lerobot"] = "lerobot"
    images: Literal["png", "mp4"] = Field(
        "png",
        description="Images as lossless PNG in the parquet files, or as H.264 films: smaller and lossy.",
    )
    crf: int = Field(14, ge=0, le=51, description="With mp4: quality of the films; lower is better and larger.")
