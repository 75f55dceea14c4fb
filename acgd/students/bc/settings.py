"""Settings of the plain behaviour-cloning student."""

from typing import ClassVar, Literal

from pydantic import Field

from acgd.settings import Section


class BCConfig(Section):
    """The simplest baseline: an MLP with two hidden layers, one action per step, no memory."""

    needs: ClassVar[tuple[str, ...]] = ()
    recurrent: ClassVar[bool] = False
    chunk: ClassVar[int] = 1
    history: ClassVar[int] = 1

    kind: Literal["bc"] = "bc"
    width: int = Field(256, ge=1, description="Units of each hidden layer.")
