"""Settings of a student that trains its own CNN."""

from typing import ClassVar, Literal

from pydantic import Field

from acgd.settings import Section


class ScratchConfig(Section):
    """No frozen backbone: the student contains a small CNN that is trained with it."""

    needs: ClassVar[tuple[str, ...]] = ()
    gives_features: ClassVar[bool] = False

    kind: Literal["scratch"] = "scratch"
    dim: int = Field(64, ge=8, description="Width of the CNN's output.")
