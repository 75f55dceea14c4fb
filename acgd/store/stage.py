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

Axis = Literal["task", "seed", "round", "condition"]


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
    """There is one artifact for each value of these axes. Without an axis there is one for all tasks."""
    reads: tuple[str, ...] = ()
    """Stages upstream: `name`, or `role=name` where the input has another name; with `?` at the end, only where
    `Request.uses(name)`. An axis that the stage upstream has and this one lacks makes the input a list."""
    wanted: bool | str = False
    """True: every variant has it. A stage's name: every variant that has that stage has it. False: made where it is read."""
    simulates: bool = False
    """Steps the simulator: its key holds what defines an episode of its tasks, and the simulator's version."""
    draws: bool = False
    """Draws pictures: its key holds what defines a picture of its tasks."""
    priority: int = 0
    """The workflow starts jobs of higher priority first."""
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
