"""Settings of the format `onnx`."""

from typing import ClassVar, Literal

from pydantic import Field

from acgd.settings import Section
from acgd.students.settings import ActingConfig


class OnnxSettings(Section):
    """A student as one ONNX file, from images, proprioception and a task's number to actions."""

    stages: ClassVar[tuple[str, ...]] = ("student",)

    kind: Literal["onnx"] = "onnx"
    weights: Literal["best", "last"] = Field(
        "best", description="Weights of least validation loss, or of the last step."
    )
    acting: ActingConfig | None = Field(
        None, description="How chunks become actions. Without it as in the student's evaluation, else the default."
    )
    goals: int = Field(64, ge=1, description="Most goal images of each task in the model.")
