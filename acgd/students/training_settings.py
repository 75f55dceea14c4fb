"""Settings of an optimisation run. settings.py imports the settings of each kind, which may import this file."""

from typing import Annotated, Literal

from pydantic import Field

from acgd.settings import OUTSIDE_KEY, Section

NonNegative = Annotated[float, Field(ge=0)]


class TrainingConfig(Section):
    """Settings of one optimisation run, of a codebook or a student."""

    steps: int = Field(3000, ge=1, description="Optimiser steps.")
    batch: int = Field(64, ge=2, description="Windows in a batch, spread evenly over the tasks.")
    learning_rate: Annotated[float, Field(gt=0)] = Field(2e-3, description="Peak learning rate of AdamW.")
    schedule: Literal["cosine", "constant"] = Field("cosine", description="Learning rate after the warm-up.")
    warmup: int = Field(100, ge=0, description="Steps of linear warm-up.")
    weight_decay: NonNegative = Field(0.01, description="Decoupled weight decay of the weight matrices.")
    clip_norm: Annotated[float, Field(gt=0)] = Field(
        10.0, description="Global gradient norm above which gradients are scaled down."
    )
    input_noise: NonNegative = Field(
        0.03,
        description="Standard deviation of Gaussian noise on normalised image features and proprioception in training.",
    )
    precision: Literal["float32", "bfloat16"] = Field(
        "float32",
        description="Arithmetic of the matrix products in training. bfloat16 falls back to float32 on hardware without "
        "it.",
    )
    validate_every: int = Field(250, ge=1, description="Steps between validations. The best weights are kept.")
    checkpoint_every: int = Field(500, ge=1, description="Steps between checkpoints.", json_schema_extra=OUTSIDE_KEY)
