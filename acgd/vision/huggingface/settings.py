"""Settings of a backbone from `transformers`."""

from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from acgd.settings import Section
from acgd.vision.weights import model_files


class HuggingFaceConfig(Section):
    """A vision model of `transformers` from a local folder."""

    needs: ClassVar[tuple[str, ...]] = ()
    gives_features: ClassVar[bool] = True

    kind: Literal["huggingface"] = "huggingface"
    path: Path | None = Field(None, description="Folder with config.json and *.safetensors. Required.")
    size: int = Field(224, ge=16, description="Images are resized to this many pixels a side.")

    @model_validator(mode="after")
    def _model_exists(self) -> "HuggingFaceConfig":
        if self.path is None or not (self.path / "config.json").is_file():
            fault = "no path is set" if self.path is None else f"{self.path} has no config.json"
            if self.path is not None and (snapshots := sorted(self.path.glob("snapshots/*/config.json"))):
                raise ValueError(
                    f"{self.path} is a folder of the hub's cache: set backbone.path to its snapshot "
                    f"{snapshots[-1].parent}."
                )
            raise ValueError(
                f"{fault}, and backbone.kind is huggingface: set backbone.path to a local folder with config.json and "
                "*.safetensors, as save_pretrained writes it."
            )
        model_files(self.path)
        return self

    def files_of(self, field: str) -> list[Path]:
        """Files of the folder `path` that define the model. Others, such as those of git, do not enter the key."""
        return model_files(getattr(self, field))
