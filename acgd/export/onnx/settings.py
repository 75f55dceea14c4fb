"""Settings of the format `onnx`."""

from typing import ClassVar, Literal

from pydantic import Field

from acgd.settings import Section
from acgd.students.settings import ActingConfig


class OnnxSettings(Section):
    """A student as one ONNX file: images, proprioception and a task's number go in, actions come out."""

    stages: ClassVar[tuple[str, ...]] = ("student",)

    kind: Literal["onnx"] = "onnx"
    weights: Literal["best", "last"] = Field(
        "best", description="Weights of least validation loss, or of the last step."
    )
    acting: ActingConfig | None = Field(
        None, description="How chunks become actions; without it as in the student's evaluation, else the default."
    )
    goals: int = Field(64, ge=1, description="Goal images of each task that the model holds, at most.")
