"""Settings of an optimisation run, apart from settings.py because the settings of a kind of student may hold one."""

from typing import Annotated, Literal

from pydantic import Field

from acgd.settings import OUTSIDE_KEY, Section

NonNegative = Annotated[float, Field(ge=0)]


class TrainingConfig(Section):
    """One optimisation run: the same fields for codebook and student."""

    steps: int = Field(3000, ge=1, description="optimiser steps")
    batch: int = Field(64, ge=2, description="windows in a batch, spread evenly over the tasks")
    learning_rate: Annotated[float, Field(gt=0)] = Field(2e-3, description="peak learning rate of AdamW")
    schedule: Literal["cosine", "constant"] = Field("cosine", description="learning rate after the warm-up")
    warmup: int = Field(100, ge=0, description="steps of linear warm-up")
    weight_decay: NonNegative = Field(0.01, description="decoupled weight decay of the weight matrices")
    clip_norm: Annotated[float, Field(gt=0)] = Field(
        10.0, description="global gradient norm above which gradients are scaled down"
    )
    input_noise: NonNegative = Field(
        0.03,
        description="standard deviation of Gaussian noise on normalised image features and proprioception in training",
    )
    precision: Literal["float32", "bfloat16"] = Field(
        "float32",
        description="arithmetic of the matrix products in training; bfloat16 is float32 where the hardware lacks it",
    )
    validate_every: int = Field(250, ge=1, description="steps between validations; the best of them is kept")
    checkpoint_every: int = Field(
        500, ge=1, description="steps between checkpoints for resumption", json_schema_extra=OUTSIDE_KEY
    )
