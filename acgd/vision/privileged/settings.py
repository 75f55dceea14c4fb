"""Settings of the privileged backbone."""

from typing import ClassVar, Literal

from pydantic import Field

from acgd.settings import OUTSIDE_KEY, Section


class PrivilegedConfig(Section):
    """A small CNN that is trained to regress object and goal from frames, and is then frozen."""

    needs: ClassVar[tuple[str, ...]] = ("rollouts",)
    gives_features: ClassVar[bool] = True

    kind: Literal["privileged"] = "privileged"
    dim: int = Field(64, ge=8, description="Width of the CNN's output.")
    steps: int = Field(1500, ge=1, description="Optimiser steps.")
    batch: int = Field(64, ge=1, description="Frames per step, spread evenly over the tasks.")
    learning_rate: float = Field(2e-3, gt=0, description="Peak learning rate of a one-cycle cosine schedule.")
    weight_decay: float = Field(1e-3, ge=0, description="Weight decay of AdamW.")
    shift: int = Field(
        3, ge=0, description="Augmentation: greatest shift in pixels. The centroids are corrected for it."
    )
    brightness: float = Field(
        0.1, ge=0, lt=1, description="Augmentation: the gain of each channel is uniform in 1 +- brightness."
    )
    frames: int = Field(4000, ge=1, description="Greatest number of training frames per task, evenly spaced.")
    precision: Literal["float32", "bfloat16"] = Field(
        "bfloat16",
        description="Arithmetic of the convolutions in training. bfloat16 falls back to float32 on hardware without "
        "it.",
    )
    seed: int = Field(0, ge=0, description="Seed of initialisation, order of frames and augmentation.")
    checkpoint_every: int = Field(
        500, ge=1, description="Steps between two checkpoints.", json_schema_extra=OUTSIDE_KEY
    )
