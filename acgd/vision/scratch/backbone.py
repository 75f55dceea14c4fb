"""No frozen backbone: the student contains a SmallCNN that is trained with the rest of the student."""

import json
from pathlib import Path
from typing import NoReturn

from acgd.store.stage import Context, Inputs
from acgd.vision.scratch.settings import ScratchConfig


class Scratch:
    """The artifact holds the width of the student's CNN and no network."""

    @classmethod
    def make(cls, settings: ScratchConfig, inputs: Inputs, ctx: Context) -> None:
        """Writes backbone.json."""
        meta = {"kind": "scratch", "dim": settings.dim}
        (ctx.out / "backbone.json").write_text(json.dumps(meta, sort_keys=True) + "\n")

    @classmethod
    def load(cls, folder: Path) -> NoReturn:
        """Raises ValueError: the kind has no network."""
        raise ValueError(
            f"{folder} is of kind scratch and has no network: its CNN is part of the student. Read images."
        )
