"""A published artifact, as the report reads it: every file may be missing, and then the table it feeds has no row."""

import json
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from acgd.store.metrics import read


class Artifact:
    """One directory of the store."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)

    @cached_property
    def manifest(self) -> dict[str, Any]:
        return self.json("manifest.json")

    @cached_property
    def run(self) -> dict[str, Any]:
        """Wall time, peak memory, machine: what differs between two runs that make the same artifact."""
        return self.json("run.json")

    @property
    def key(self) -> str:
        return str(self.manifest.get("key", self.path.name))

    def json(self, name: str) -> dict[str, Any]:
        path = self.path / name
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}

    def json_lines(self, name: str) -> list[dict[str, Any]]:
        path = self.path / name
        if not path.exists():
            return []
        return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line]

    def csv(self, name: str) -> pd.DataFrame:
        path = self.path / name
        return pd.read_csv(path) if path.exists() else pd.DataFrame()

    def curves(self) -> pd.DataFrame:
        """metrics.jsonl with `step` as a column; a value that was not logged at a step is NaN."""
        return pd.DataFrame(read(self.path / "metrics.jsonl"))
