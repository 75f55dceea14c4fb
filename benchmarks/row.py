"""One line of the benchmark table."""

from typing import TypedDict


class Row(TypedDict):
    name: str
    value: float
    unit: str
    ratio: float | None
    """To the reference measured in the same run; each benchmark's `run` says which."""
    target: str
    met: bool | None
