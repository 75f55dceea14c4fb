"""Kept results: the small files of a study's artifacts, which are restored into an empty store.

    docs/results/<study>/kept/<stage>/<name>/<key>/   manifest.json, checksums.json, run.json, and files such as
                                                      episodes.jsonl, summary.json, quality.json, card.json

Weights, pictures, films and zarr stores are not kept. The file kept.json of a restored artifact names the missing
files. The report reads a restored artifact; every other stage refuses it.
"""

import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from acgd.store.lock import held
from acgd.store.store import KEPT, MANIFEST, NOT_PAYLOAD, ArtifactError, Store, absent, check, damages
from acgd.study.plan import Plan

SUFFIXES = (".json", ".jsonl", ".csv")
LIMIT = 200_000
"""Greatest size in bytes of a kept file. Files named in ALWAYS have no limit."""
ALWAYS = ("episodes.jsonl",)
"""Files that are kept at any size. The success rates need the episodes."""


@dataclass
class Outcome:
    """Result of keeping or restoring a study. Each list holds places `<stage>/<name>/<key>`."""

    done: list[str] = field(default_factory=list)
    """Artifacts that were kept or restored."""
    missing: list[str] = field(default_factory=list)
    """Artifacts that the store (when keeping) or the kept results (when restoring) lack."""
    present: list[str] = field(default_factory=list)
    """Artifacts that the store had before restoring."""
    too_large: list[str] = field(default_factory=list)
    """Files `<place>/<file>` with a kept suffix that were left out, since they are larger than LIMIT."""


def folder_of(study: str) -> Path:
    """Default folder of a study's kept results, relative to the root of the checkout."""
    return Path("docs/results") / study / "kept"


def keep(store: Store, plan: Plan, folder: Path) -> Outcome:
    """Copies the small files of every finished artifact of the plan into `folder`. The report is left out.

    Removes artifacts with other keys from `folder`, since a report is built from one plan. Raises ArtifactError of a
    damaged artifact.
    """
    outcome = Outcome()
    for place in _places(plan):
        if not store.has(place):
            outcome.missing.append(place)
            continue
        path = store.path(place)
        check(path, restored=True)
        draft = folder / f"{place}.draft"
        shutil.rmtree(draft, ignore_errors=True)
        for name in _small(path, outcome.too_large, place):
            _copy(path / name, draft / name)
        shutil.rmtree(folder / place, ignore_errors=True)
        os.rename(draft, folder / place)
        outcome.done.append(place)
    wanted = set(_places(plan))
    for manifest in list(folder.glob(f"*/*/*/{MANIFEST}")):
        if str(manifest.parent.relative_to(folder)) not in wanted:
            shutil.rmtree(manifest.parent)
    return outcome


def restore(store: Store, plan: Plan, folder: Path) -> Outcome:
    """Publishes the kept artifacts of the plan that the store lacks. A kill leaves no incomplete artifact.

    Raises ArtifactError where `folder` is missing, or a kept file differs from its checksum.
    """
    if not folder.is_dir():
        raise ArtifactError(
            f"{folder}: no results are kept there. Type: python -m acgd keep, on the machine that has the results."
        )
    outcome = Outcome()
    for place in _places(plan):
        source = folder / place
        if store.has(place):
            outcome.present.append(place)
        elif (source / MANIFEST).is_file():
            _publish(store, place, source)
            outcome.done.append(place)
        else:
            outcome.missing.append(place)
    return outcome


def discard(store: Store) -> list[str]:
    """Removes every restored artifact, so that the workflow makes it completely. Returns their places."""
    restored = [place for place in store.places() if absent(store.path(place))]
    for place in restored:
        store.remove(place)
    return restored


def _publish(store: Store, place: str, source: Path) -> None:
    payload = json.loads((source / MANIFEST).read_text(encoding="utf-8"))["payload"]
    with held(store.work(place) / "lock", place):
        path, draft = store.path(place), store.work(place) / "restored"
        if store.has(place):
            return
        shutil.rmtree(draft, ignore_errors=True)
        shutil.copytree(source, draft)
        missing = [name for name in sorted(payload) if not (draft / name).is_file()]
        (draft / KEPT).write_text(json.dumps({"absent": missing}, indent=1) + "\n", encoding="utf-8")
        differences = damages(draft, payload)
        if differences:
            shutil.rmtree(draft)
            raise ArtifactError(
                f"{source}: {'; '.join(differences[:5])}. The kept files were changed. "
                f"Type: git checkout -- {source}, then restore again."
            )
        shutil.rmtree(path, ignore_errors=True)
        path.parent.mkdir(parents=True, exist_ok=True)
        os.rename(draft, path)


def _places(plan: Plan) -> list[str]:
    """Places of all artifacts but the report."""
    return [place for place, artifact in plan.artifacts.items() if artifact is not plan.report]


def _small(path: Path, too_large: list[str], place: str) -> Iterator[str]:
    """Names of the files to keep: the artifact's description, and text files up to LIMIT bytes outside zarr stores."""
    for file in sorted(path.rglob("*")):
        name = file.relative_to(path)
        if not file.is_file() or any(part.endswith(".zarr") for part in name.parts):
            continue
        if file.parent == path and file.name in NOT_PAYLOAD:
            if file.name != KEPT:
                yield name.as_posix()
        elif file.suffix in SUFFIXES:
            if file.name in ALWAYS or file.stat().st_size <= LIMIT:
                yield name.as_posix()
            else:
                too_large.append(f"{place}/{name.as_posix()}")


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)
