"""What a stage is given: its typed request, its inputs, and a context to write into."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch

    from acgd.tracking.metrics import Metrics
    from acgd.tracking.progress import Progress

Inputs = dict[str, "Path | list[Path]"]
"""Role -> directory of a published artifact; a list, in the order of the study's tasks, for per-task roles."""


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
