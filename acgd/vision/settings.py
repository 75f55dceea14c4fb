"""Settings and requests of the stages `backbone` and `features`."""

from typing import Literal

from pydantic import Field

from acgd.settings import Request, Section, one_of
from acgd.vision.kinds import BACKBONES
from acgd.vision.privileged.settings import PrivilegedConfig

BackboneConfig = one_of(BACKBONES, default="privileged")
"""Settings of one kind. needs: optional stages that the kind reads. gives_features: whether it encodes frames."""


class BackboneRequest(Request):
    """Request of the stage `backbone`."""

    backbone: BackboneConfig = Field(PrivilegedConfig(), description="Stage `backbone`, one artifact.")

    def uses(self, stage: str) -> bool:
        """True for rollouts if the backbone is trained on them."""
        return stage in self.backbone.needs

    def artifact_name(self, default: str) -> str:
        """The kind of the backbone."""
        return self.backbone.kind


class FeaturesConfig(Section):
    """Encoding of frames by a frozen backbone."""

    precision: Literal["float32", "bfloat16"] = Field(
        "float32",
        description="Arithmetic of the backbone. bfloat16 falls back to float32 on hardware without it. Features are "
        "stored as float32.",
    )
    batch: int = Field(256, ge=1, description="Frames in a batch.")


class FeaturesRequest(Request):
    """Request of the stage `features`."""

    features: FeaturesConfig = Field(FeaturesConfig(), description="Stage `features`, one artifact per task.")
    backbone: BackboneConfig = PrivilegedConfig()

    def exists(self) -> bool:
        """True if the backbone is frozen and encodes frames."""
        return self.backbone.gives_features
