"""Episodes of other projects' formats."""

from dataclasses import dataclass

import numpy as np


class UnreadableError(ValueError):
    """A file is damaged, or not of its format. The message names the file."""


@dataclass(frozen=True)
class Beginning:
    """The data that this project's exports add to an episode, for its replay."""

    task: dict[str, str]
    """Name and start, as in TaskConfig."""
    seed: int
    outcome: dict[str, bool]
    """`success_final`, `success_held`, `success_once`, `terminated`."""
    integration: np.ndarray
    """(N,) float64, MuJoCo's state before the first action."""
    model_fields: dict[str, np.ndarray]
    """Name -> field of the model that the reset wrote."""


@dataclass(frozen=True)
class OutsideEpisode:
    """One episode of T steps."""

    task: str
    """Name of the task in the format."""
    columns: dict[str, np.ndarray]
    """Name of a column in the format -> (T, ...), or (T + 1, ...) for Minari's observations."""
    beginning: Beginning | None
    """None in a file that another project wrote."""
