"""Backbones, and the features that a frozen one gives."""

from typing import Literal

from pydantic import Field

from acgd.settings import Request, Section, one_of
from acgd.vision.kinds import BACKBONES
from acgd.vision.privileged.settings import PrivilegedConfig

BackboneConfig = one_of(BACKBONES, default="privileged")
"""Settings of one kind. `needs`: optional stages that it reads. `gives_features`: whether it encodes frames."""


class BackboneRequest(Request):
    """What the stage `backbone` depends on besides its inputs."""

    backbone: BackboneConfig = Field(PrivilegedConfig(), description="Stage `backbone`, one artifact.")

    def uses(self, stage: str) -> bool:
        """Rollouts, where the backbone is trained on them."""
        return stage in self.backbone.needs

    def artifact_name(self, default: str) -> str:
        """The kind."""
        return self.backbone.kind


class FeaturesConfig(Section):
    """The pass of a frozen backbone over every frame."""

    precision: Literal["float32", "bfloat16"] = Field(
        "float32",
        description="Arithmetic of the backbone; bfloat16 is float32 where the hardware lacks it. Stored as float32.",
    )
    batch: int = Field(256, ge=1, description="Frames in one pass.")


class FeaturesRequest(Request):
    """What the stage `features` depends on besides its inputs."""

    features: FeaturesConfig = Field(FeaturesConfig(), description="Stage `features`, one artifact per task.")
    backbone: BackboneConfig = PrivilegedConfig()

    def exists(self) -> bool:
        """Whether the backbone is frozen, so that it encodes frames."""
        return self.backbone.gives_features
