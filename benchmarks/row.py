"""One line of the benchmark table."""

from typing import TypedDict


class Row(TypedDict):
    """Name, value and target of one measurement. `met` is None without a target."""

    name: str
    value: float
    unit: str
    ratio: float | None
    """Ratio to the reference that `run` of the benchmark names, measured in the same run."""
    target: str
    met: bool | None
