"""Settings of the backbone R3M."""

from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from acgd.settings import Section
from acgd.vision.weights import check_torch


class R3MConfig(Section):
    """R3M (Nair et al. 2022), the paper's backbone, from a local checkpoint."""

    needs: ClassVar[tuple[str, ...]] = ()
    gives_features: ClassVar[bool] = True

    kind: Literal["r3m"] = "r3m"
    path: Path | None = Field(None, description="Checkpoint (model.pt). Required.")
    size: int = Field(224, ge=16, description="Images are resized to this many pixels a side.")

    @model_validator(mode="after")
    def _checkpoint_exists(self) -> "R3MConfig":
        if self.path is None or not self.path.is_file():
            fault = "no path is set" if self.path is None else f"there is no file {self.path}"
            raise ValueError(f"{fault}, and backbone.kind is r3m: set backbone.path to the checkpoint (model.pt).")
        try:
            check_torch(self.path)
        except ValueError as error:
            raise ValueError(
                f"{self.path} is no R3M checkpoint: {error} Set backbone.path to the published model.pt."
            ) from error
        return self
