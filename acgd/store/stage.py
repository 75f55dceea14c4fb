"""A stage: one row of the table in acgd/chain.py, and the arguments of the stage's function."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import torch

    from acgd.store.metrics import Metrics
    from acgd.store.progress import Progress

Inputs = dict[str, "Path | list[Path]"]
"""Role -> directory of a published artifact.

The value is a list where the stage reads one artifact per task (in the order of the study's tasks), or per round and
task (round by round).
"""

Axis = Literal["seed", "round", "condition", "task"]


@dataclass(frozen=True)
class Read:
    """One input of a stage."""

    stage: str
    """The upstream stage. If it has an axis `task` or `seed` that the reader lacks, the input is a list.

    Of several conditions the first one, the headline, is read.
    """
    role: str = ""
    """Name of the input. Empty: the name of the stage."""
    optional: bool = False
    """Read only if `Request.uses(stage)` is true and the variant has artifacts of the stage."""
    rounds: Literal["same", "previous", "so far", "last"] = "same"
    """Which on-policy rounds of the upstream stage are read, relative to the reader's round."""


@dataclass(frozen=True)
class Stage:
    """One row of the table of stages."""

    name: str
    version: int
    """Increased when new code gives another artifact for the same request. All downstream artifacts are remade too."""
    request: str
    """Import string of the stage's Request class."""
    function: str
    """Import string of `function(request, inputs, context) -> None`, which writes into `context.out`."""
    per: tuple[Axis, ...] = ()
    """Axes: the stage has one artifact for each combination of their values. Without an axis it has one artifact."""
    reads: tuple[Read, ...] = ()
    wanted: bool = False
    """Every variant has this stage. Otherwise the stage is made only where another stage reads it."""
    beside: str = ""
    """Name of another stage. A variant that has that stage has this one too."""
    first_round: int = 0
    """First round of a stage with the axis `round`."""
    simulates: bool = False
    """The stage steps the simulator. Its key holds the digests that define an episode of its tasks."""
    draws: bool = False
    """The stage draws pictures. Its key holds the digests that define a picture of its tasks."""
    priority: int = 0
    """The workflow starts jobs of a higher priority first."""
    results: tuple[str, ...] = ()
    """JSON files of the payload whose numbers MLflow shows."""


@dataclass(frozen=True)
class Context:
    """Folders, metrics, progress and device of a running stage."""

    out: Path
    """Folder of the payload. The caller publishes it when the stage returns."""
    state: Path
    """Folder of the checkpoints. It survives a kill and is not published."""
    metrics: "Metrics"
    progress: "Progress"
    device: "torch.device"
