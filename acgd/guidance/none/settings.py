"""Settings of a student without guidance: there are none."""

from typing import ClassVar, Literal

from acgd.settings import Section


class NoGuidanceConfig(Section):
    """Imitation alone."""

    needs: ClassVar[tuple[str, ...]] = ()

    kind: Literal["none"] = "none"
