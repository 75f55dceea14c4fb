"""Settings of the format `minari`."""

from typing import ClassVar, Literal

from pydantic import Field

from acgd.settings import Section


class MinariSettings(Section):
    """Minari's HDF5 datasets, one for each task. MINARI_DATASETS_PATH is the exported folder."""

    stages: ClassVar[tuple[str, ...]] = ("rollouts", "onpolicy")

    kind: Literal["minari"] = "minari"
    name: str = Field(
        "demonstrations", pattern=r"^[-\w]+$", description="A dataset is called acgd/<task>/<name>-v<version>."
    )
    version: int = Field(0, ge=0, description="Version in the names of the datasets.")
