"""Backbones, and the features that a frozen one gives."""

from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator, model_validator

from acgd.settings import Section
from acgd.tasks.settings import TaskConfig

FIELDS_OF_KIND: dict[str, frozenset[str]] = {
    "privileged": frozenset(
        {
            "dim",
            "steps",
            "batch",
            "learning_rate",
            "weight_decay",
            "shift",
            "brightness",
            "frames",
            "precision",
            "seed",
            "checkpoint_every",
        }
    ),
    "scratch": frozenset({"dim"}),
    "r3m": frozenset({"path", "size"}),
    "huggingface": frozenset({"path", "size"}),
}
"""The fields that each kind reads, besides `kind`."""


class BackboneConfig(Section):
    """The network that turns an image into a vector."""

    kind: Literal["privileged", "scratch", "r3m", "huggingface"] = Field(
        "privileged",
        description="privileged: a small CNN that regresses object and goal from training frames, then frozen. scratch: the same CNN, "
        "trained with the student. r3m: weights from the file `path`. huggingface: a vision model from the folder `path`.",
    )
    path: Path | None = Field(
        None, description="r3m: the checkpoint (model.pt). huggingface: a folder with config.json and *.safetensors."
    )
    size: int = Field(224, ge=16, description="r3m, huggingface: images are resized to this many pixels a side.")
    dim: int = Field(64, ge=8, description="privileged, scratch: width of the CNN's output.")
    steps: int = Field(1500, ge=1, description="privileged: optimiser steps.")
    batch: int = Field(64, ge=1, description="privileged: frames a step, shared evenly among the tasks.")
    learning_rate: float = Field(2e-3, gt=0, description="privileged: peak of a one-cycle cosine schedule.")
    weight_decay: float = Field(1e-3, ge=0, description="privileged: AdamW's weight decay.")
    shift: int = Field(
        3, ge=0, description="privileged: augmentation by up to so many pixels, which are taken off the centroids."
    )
    brightness: float = Field(
        0.1, ge=0, lt=1, description="privileged: augmentation: each channel's gain is uniform in 1 +- this."
    )
    frames: int = Field(4000, ge=1, description="privileged: at most so many training frames a task, evenly spaced.")
    precision: Literal["float32", "bfloat16"] = Field(
        "bfloat16",
        description="privileged: arithmetic of the convolutions in training; bfloat16 is float32 where the hardware lacks it.",
    )
    seed: int = Field(0, ge=0, description="privileged: initialisation, order of frames and augmentation.")
    checkpoint_every: int = Field(
        500, ge=1, description="privileged: steps between two checkpoints.", json_schema_extra={"key": False}
    )

    @model_validator(mode="after")
    def _path_where_needed(self) -> "BackboneConfig":
        if self.kind == "r3m" and not (self.path and self.path.is_file()):
            raise ValueError(
                f"backbone.kind is r3m: set backbone.path to the checkpoint (model.pt); {_given(self.path)}"
            )
        if self.kind == "huggingface" and not (self.path and (self.path / "config.json").is_file()):
            raise ValueError(
                "backbone.kind is huggingface: set backbone.path to a local folder with config.json and *.safetensors, "
                f"as save_pretrained writes it; {_given(self.path)}"
            )
        return self

    def used(self) -> "BackboneConfig":
        """The same, with every field that the kind does not read put back to its default, so that it cannot enter a key."""
        read = FIELDS_OF_KIND[self.kind]
        return BackboneConfig(kind=self.kind, **{name: getattr(self, name) for name in read})


def _given(path: Path | None) -> str:
    return "nothing is set" if path is None else f"there is none at {path}"


class BackboneRequest(Section):
    """What the stage `backbone` reads. `tasks` are those whose frames train a privileged backbone, in the order of the study."""

    tasks: list[TaskConfig]
    backbone: BackboneConfig

    @field_validator("backbone")
    @classmethod
    def _only_what_is_read(cls, backbone: BackboneConfig) -> BackboneConfig:
        return backbone.used()


class FeaturesConfig(Section):
    """The pass of a frozen backbone over every frame."""

    precision: Literal["float32", "bfloat16"] = Field(
        "float32",
        description="Arithmetic of the backbone, bfloat16 only where the hardware has it; features are stored as float32.",
    )
    batch: int = Field(256, ge=1, description="Frames in one pass.")


class FeaturesRequest(Section):
    """What the stage `features` reads."""

    features: FeaturesConfig
