"""A stage: one row of the table in acgd/chain.py, and what its function is given."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import torch

    from acgd.store.metrics import Metrics
    from acgd.store.progress import Progress

Inputs = dict[str, "Path | list[Path]"]
"""Role -> directory of a published artifact. A list where the stage reads one artifact per task (in the order of the
study's tasks), or per round and task (round by round)."""

Axis = Literal["seed", "round", "condition", "task"]


@dataclass(frozen=True)
class Read:
    """One input of a stage."""

    stage: str
    """The stage upstream. An axis `task` or `seed` that it has and the reader lacks makes the input a list; of several
    conditions the first, which is the headline, is read."""
    role: str = ""
    """Name of the input; without one, that of the stage."""
    optional: bool = False
    """Read only where `Request.uses(stage)`, and where the variant has such artifacts."""
    rounds: Literal["same", "previous", "so far", "last"] = "same"
    """Which on-policy rounds of a stage upstream that has rounds, seen from the reader's round."""


@dataclass(frozen=True)
class Stage:
    """One row of the table of stages."""

    name: str
    version: int
    """Raised when the same request would give another artifact: it and everything downstream is then made anew."""
    request: str
    """Import string of its Request."""
    function: str
    """Import string of `function(request, inputs, context) -> None`, which writes into `context.out`."""
    per: tuple[Axis, ...] = ()
    """There is one artifact for each value of these axes. Without an axis there is one for all tasks and seeds."""
    reads: tuple[Read, ...] = ()
    wanted: bool = False
    """Every variant has it. Otherwise it is made only where another stage reads it."""
    beside: str = ""
    """A stage: wherever a variant has that one, it has this one, too."""
    first_round: int = 0
    """Of a stage per round."""
    simulates: bool = False
    """It steps the simulator: its key holds what defines an episode of its tasks."""
    draws: bool = False
    """It draws pictures: its key holds what defines a picture of its tasks."""
    priority: int = 0
    """The workflow starts jobs of a higher priority first."""
    results: tuple[str, ...] = ()
    """JSON files of its payload whose numbers MLflow shows."""


@dataclass(frozen=True)
class Context:
    """Where a stage writes, and what it reports to."""

    out: Path
    """The payload. Published by the caller when the stage returns."""
    state: Path
    """Checkpoints. Survives a kill, is not published."""
    metrics: "Metrics"
    progress: "Progress"
    device: "torch.device"
