"""A published artifact, as the report reads it. Every file may be missing; the table it feeds then has no row."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
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

    @property
    def request(self) -> dict[str, Any]:
        """The part of the configuration that it was made from."""
        return self.manifest.get("request", {})

    @cached_property
    def upstream(self) -> list[str]:
        """Keys of the artifacts that it was made from."""
        keys = self.manifest.get("inputs", {}).values()
        return [key for given in keys for key in (given if isinstance(given, list) else [given])]

    @property
    def precision(self) -> str | None:
        """`float32` or `bfloat16`, as it was computed; None where its settings do not ask for bfloat16."""
        if "bfloat16" not in _values(self.request, "precision"):
            return None
        return self.run.get("precision_used", "bfloat16" if self.run.get("bfloat16", True) else "float32")

    @property
    def size(self) -> int:
        """Bytes of its payload by the manifest, which counts what a restored artifact lacks; else of its files."""
        if "payload" in self.manifest:
            return sum(file["bytes"] for file in self.manifest["payload"].values())
        return sum(file.stat().st_size for file in self.path.rglob("*") if file.is_file())

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


Artifacts = Mapping[str, Sequence[Artifact]]
"""Stage name -> its artifacts, in the order that the places of the request's entries count in."""


def load(inputs: Mapping[str, Iterable[Path]]) -> dict[str, list[Artifact]]:
    """The artifacts of every stage, upstream before downstream: a stage comes where its first artifact can be made."""
    artifacts = {stage: [Artifact(path) for path in paths] for stage, paths in inputs.items()}
    by_key = {artifact.key: artifact for each in artifacts.values() for artifact in each}
    depths: dict[str, int] = {}

    def depth(key: str) -> int:
        if key not in depths:
            depths[key] = 1 + max((depth(one) for one in by_key[key].upstream if one in by_key), default=-1)
        return depths[key]

    first = {stage: min((depth(artifact.key) for artifact in each), default=0) for stage, each in artifacts.items()}
    return {stage: artifacts[stage] for stage in sorted(artifacts, key=first.__getitem__)}


def _values(content: object, name: str) -> Iterator[object]:
    """Every value under that name, at any depth of a JSON document."""
    if isinstance(content, dict):
        for key, value in content.items():
            if key == name:
                yield value
            yield from _values(value, name)
    elif isinstance(content, list):
        for value in content:
            yield from _values(value, name)
