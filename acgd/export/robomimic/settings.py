"""Settings of the format `robomimic`."""

from typing import ClassVar, Literal

from acgd.settings import Section


class RobomimicSettings(Section):
    """The HDF5 files of robomimic, one for each task: it names one environment for a file."""

    stages: ClassVar[tuple[str, ...]] = ("rollouts", "onpolicy")

    kind: Literal["robomimic"] = "robomimic"
