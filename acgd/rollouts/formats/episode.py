"""Episodes as other projects' formats hold them."""

from dataclasses import dataclass

import numpy as np


class UnreadableError(ValueError):
    """A file that is not of its format, or damaged. The message names it."""


@dataclass(frozen=True)
class Beginning:
    """What this project's exports add to an episode, so that it can be replayed."""

    task: dict[str, str]
    """Name and start, as in TaskConfig."""
    seed: int
    outcome: dict[str, bool]
    """`success_final`, `success_held`, `success_once`, `terminated`."""
    integration: np.ndarray
    """(N,) float64, MuJoCo's state before the first action."""
    model_fields: dict[str, np.ndarray]
    """Fields of the model that the reset wrote."""


@dataclass(frozen=True)
class OutsideEpisode:
    """One episode of T steps."""

    task: str
    """The task, as the format calls it."""
    columns: dict[str, np.ndarray]
    """The format's own name of a column -> (T, ...), or (T + 1, ...) for Minari's observations."""
    beginning: Beginning | None
    """None in a file that another project wrote."""
