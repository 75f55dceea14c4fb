"""Results that outlast a machine: the small files of a study's artifacts, and the way back into an empty store.

    docs/results/<study>/kept/<stage>/<name>/<key>/   manifest.json, checksums.json, run.json, and files such as
                                                      episodes.jsonl, summary.json, quality.json, card.json

Weights, pictures, films and zarr stores are not kept. A restored artifact lists in kept.json what it lacks: a report
reads it, any other stage refuses it.
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
"""Bytes of a file that is kept, but for those in ALWAYS."""
ALWAYS = ("episodes.jsonl",)
"""Without the episodes there is no success rate."""


@dataclass
class Outcome:
    """What was done with the artifacts of a study. Each list holds places `<stage>/<name>/<key>`."""

    done: list[str] = field(default_factory=list)
    """Kept, or restored."""
    missing: list[str] = field(default_factory=list)
    """Not finished in the store, or not among the kept results."""
    present: list[str] = field(default_factory=list)
    """Restoring: in the store already."""
    too_large: list[str] = field(default_factory=list)
    """Keeping: files of a kept kind above LIMIT, which were left out, as `<place>/<file>`."""


def folder_of(study: str) -> Path:
    """Where a study's results are kept by default, from the root of the checkout."""
    return Path("docs/results") / study / "kept"


def keep(store: Store, plan: Plan, folder: Path) -> Outcome:
    """Copies the small files of every finished artifact of the plan into `folder`, all but those of the report.

    What `folder` holds of other keys is removed: the report is built again from one plan.
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
    """Publishes the kept artifacts of the plan that the store lacks. Each appears whole, or not at all."""
    if not folder.is_dir():
        raise ArtifactError(f"{folder}: no results are kept there. Type: python -m acgd keep, where they were made.")
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
    """Removes every restored artifact, so that the workflow makes it whole."""
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
        lacks = [name for name in sorted(payload) if not (draft / name).is_file()]
        (draft / KEPT).write_text(json.dumps({"absent": lacks}, indent=1) + "\n", encoding="utf-8")
        differs = damages(draft, payload)
        if differs:
            shutil.rmtree(draft)
            raise ArtifactError(
                f"{source}: {'; '.join(differs[:5])}. The kept files were changed. "
                f"Type: git checkout -- {source}, then restore again."
            )
        shutil.rmtree(path, ignore_errors=True)
        path.parent.mkdir(parents=True, exist_ok=True)
        os.rename(draft, path)


def _places(plan: Plan) -> list[str]:
    return [place for place, artifact in plan.artifacts.items() if artifact is not plan.report]


def _small(path: Path, too_large: list[str], place: str) -> Iterator[str]:
    """Names of the files to keep: what describes the artifact, and text below the limit outside of zarr stores."""
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
