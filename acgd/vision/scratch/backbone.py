"""No frozen backbone: the student owns a SmallCNN and trains it with everything else."""

import json
from pathlib import Path
from typing import NoReturn

from acgd.store.stage import Context, Inputs
from acgd.vision.scratch.settings import ScratchConfig


class Scratch:
    """The artifact of this kind holds the width of the student's CNN, and no network."""

    @classmethod
    def make(cls, settings: ScratchConfig, inputs: Inputs, ctx: Context) -> None:
        """Write backbone.json."""
        meta = {"kind": "scratch", "dim": settings.dim}
        (ctx.out / "backbone.json").write_text(json.dumps(meta, sort_keys=True) + "\n")

    @classmethod
    def load(cls, folder: Path) -> NoReturn:
        """There is nothing to load."""
        raise ValueError(
            f"{folder} is of kind scratch: its CNN is part of the student, read images instead of features"
        )
