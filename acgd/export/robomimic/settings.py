"""Settings of the format `robomimic`."""

from typing import ClassVar, Literal

from acgd.settings import Section


class RobomimicSettings(Section):
    """HDF5 files of robomimic, one for each task, since a file names one environment."""

    stages: ClassVar[tuple[str, ...]] = ("rollouts", "onpolicy")

    kind: Literal["robomimic"] = "robomimic"
