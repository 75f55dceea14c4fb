"""Settings of a student without guidance. The kind has no fields."""

from typing import ClassVar, Literal

from acgd.settings import Section


class NoGuidanceConfig(Section):
    """Imitation is the only loss."""

    needs: ClassVar[tuple[str, ...]] = ()

    kind: Literal["none"] = "none"
