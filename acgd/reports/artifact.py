"""A published artifact as the report reads it. A missing file gives an empty result, and a table without its row."""

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from acgd.settings import values_of
from acgd.store.metrics import read


class Artifact:
    """One directory of the store."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """Content of manifest.json."""
        return self.json("manifest.json")

    @cached_property
    def run(self) -> dict[str, Any]:
        """Content of run.json: wall time, peak memory and machine of the run that made the artifact."""
        return self.json("run.json")

    @property
    def key(self) -> str:
        """Key of the artifact."""
        return str(self.manifest.get("key", self.path.name))

    @property
    def request(self) -> dict[str, Any]:
        """Settings that the artifact was made from."""
        return self.manifest.get("request", {})

    @cached_property
    def upstream(self) -> list[str]:
        """Keys of the inputs."""
        keys = self.manifest.get("inputs", {}).values()
        return [key for role_keys in keys for key in (role_keys if isinstance(role_keys, list) else [role_keys])]

    @property
    def precision(self) -> str | None:
        """Precision of the computation, `float32` or `bfloat16`; None for settings without bfloat16."""
        if "bfloat16" not in values_of("precision", self.request):
            return None
        return self.run.get("precision_used", "bfloat16" if self.run.get("bfloat16", True) else "float32")

    @property
    def size(self) -> int:
        """Bytes of the payload. The manifest also counts files that a restored artifact lacks."""
        if "payload" in self.manifest:
            return sum(file["bytes"] for file in self.manifest["payload"].values())
        return sum(file.stat().st_size for file in self.path.rglob("*") if file.is_file())

    def json(self, name: str) -> dict[str, Any]:
        """Content of a JSON file; empty if the file is missing."""
        path = self.path / name
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}

    def json_lines(self, name: str) -> list[dict[str, Any]]:
        """Objects of a file with one JSON object per line; empty if the file is missing."""
        path = self.path / name
        if not path.exists():
            return []
        return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line]

    def csv(self, name: str) -> pd.DataFrame:
        """Content of a csv file; empty if the file is missing."""
        path = self.path / name
        return pd.read_csv(path) if path.exists() else pd.DataFrame()

    def curves(self) -> pd.DataFrame:
        """Content of metrics.jsonl, one row per logged step. A value that was not logged at a step is NaN."""
        return pd.DataFrame(read(self.path / "metrics.jsonl"))


Artifacts = Mapping[str, Sequence[Artifact]]
"""Stage name -> artifacts, in the order of the report's inputs. `ReportEntry.places` holds indices of these lists."""


def load(inputs: Mapping[str, Iterable[Path]]) -> dict[str, list[Artifact]]:
    """The artifacts of every stage. Stages are sorted by the depth of their first artifact in the graph."""
    artifacts = {stage: [Artifact(path) for path in paths] for stage, paths in inputs.items()}
    by_key = {artifact.key: artifact for stage_artifacts in artifacts.values() for artifact in stage_artifacts}
    depths: dict[str, int] = {}

    def depth(key: str) -> int:
        if key not in depths:
            depths[key] = 1 + max((depth(parent) for parent in by_key[key].upstream if parent in by_key), default=-1)
        return depths[key]

    stage_depths = {
        stage: min((depth(artifact.key) for artifact in each), default=0) for stage, each in artifacts.items()
    }
    return {stage: artifacts[stage] for stage in sorted(artifacts, key=stage_depths.__getitem__)}
