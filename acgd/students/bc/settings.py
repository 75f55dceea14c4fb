"""Settings of the plain behaviour-cloning student."""

from typing import ClassVar, Literal

from pydantic import Field

from acgd.settings import Section


class BCConfig(Section):
    """The floor of what a method must beat: two hidden layers, one action a step, without memory."""

    needs: ClassVar[tuple[str, ...]] = ()
    recurrent: ClassVar[bool] = False
    chunk: ClassVar[int] = 1
    history: ClassVar[int] = 1

    kind: Literal["bc"] = "bc"
    width: int = Field(256, ge=1, description="units of each hidden layer")
