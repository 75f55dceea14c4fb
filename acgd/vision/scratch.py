"""No frozen backbone: the student owns a SmallCNN and trains it with everything else."""

import json
from pathlib import Path
from typing import NoReturn

from acgd.store.stage import Context, Inputs
from acgd.vision.settings import BackboneRequest


def make(config: BackboneRequest, inputs: Inputs, ctx: Context) -> None:
    """Write backbone.json, so that the choice has an artifact as the others have."""
    (ctx.out / "backbone.json").write_text(
        json.dumps({"kind": "scratch", "dim": config.backbone.dim}, sort_keys=True) + "\n"
    )


def load(folder: Path) -> NoReturn:
    """There is nothing to load."""
    raise ValueError(f"{folder} is of kind scratch: its CNN is part of the student, read images instead of features")
