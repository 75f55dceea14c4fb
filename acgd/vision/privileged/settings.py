"""Settings of the privileged backbone."""

from typing import ClassVar, Literal

from pydantic import Field

from acgd.settings import OUTSIDE_KEY, Section


class PrivilegedConfig(Section):
    """A small CNN that regresses object and goal from training frames and is then frozen."""

    needs: ClassVar[tuple[str, ...]] = ("rollouts",)
    gives_features: ClassVar[bool] = True

    kind: Literal["privileged"] = "privileged"
    dim: int = Field(64, ge=8, description="Width of the CNN's output.")
    steps: int = Field(1500, ge=1, description="Optimiser steps.")
    batch: int = Field(64, ge=1, description="Frames a step, shared evenly among the tasks.")
    learning_rate: float = Field(2e-3, gt=0, description="Peak of a one-cycle cosine schedule.")
    weight_decay: float = Field(1e-3, ge=0, description="AdamW's weight decay.")
    shift: int = Field(3, ge=0, description="Augmentation by up to so many pixels, which are taken off the centroids.")
    brightness: float = Field(0.1, ge=0, lt=1, description="Augmentation: each channel's gain is uniform in 1 +- this.")
    frames: int = Field(4000, ge=1, description="At most so many training frames a task, evenly spaced.")
    precision: Literal["float32", "bfloat16"] = Field(
        "bfloat16",
        description="Arithmetic of the convolutions in training; bfloat16 is float32 where the hardware lacks it.",
    )
    seed: int = Field(0, ge=0, description="Initialisation, order of frames and augmentation.")
    checkpoint_every: int = Field(
        500, ge=1, description="Steps between two checkpoints.", json_schema_extra=OUTSIDE_KEY
    )
