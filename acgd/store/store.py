"""The store: artifacts that are whole, or not there.

    results/store/<stage>/<name>/<key>/   payload, checksums.json, run.json, and manifest.json, which is written last
    results/work/<stage>/<name>/<key>/    what is being made: payload/, state/ (checkpoints), metrics.jsonl, lock

A stage fills `payload/`. Then every file is brought onto the disk and its checksum written to `checksums.json`, the
folder is renamed into the store, and the manifest makes it an artifact. Killed in between, the next maker goes on from
what is there: from the checkpoints, or, where only the manifest is missing, from the checksums.
"""

import errno
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acgd.store.atomic import replace_text
from acgd.store.key import canonical, file_digest
from acgd.store.lock import held, remove_with_lock

MANIFEST, CHECKSUMS, RUN, METRICS = "manifest.json", "checksums.json", "run.json", "metrics.jsonl"
KEPT = "kept.json"
"""In an artifact that was restored from kept results: the names of its files that were not kept."""
NOT_PAYLOAD = (MANIFEST, CHECKSUMS, RUN, KEPT)
IGNORED = (".snakemake_timestamp",)


class ArtifactError(Exception):
    """An artifact is missing, damaged or cannot be made. The text is meant for the user as it stands."""


@dataclass(frozen=True)
class Workspace:
    """Where an artifact is made."""

    payload: Path
    state: Path
    metrics: Path


class Store:
    """The artifacts under one results folder."""

    def __init__(self, results: Path) -> None:
        self.results = Path(results)
        self.root = self.results / "store"

    def path(self, place: str) -> Path:
        """Directory of the artifact `<stage>/<name>/<key>`."""
        return self.root / place

    def work(self, place: str) -> Path:
        return self.results / "work" / place

    def lock(self, place: str) -> Path:
        """Held by whoever makes or removes the artifact."""
        return self.work(place) / "lock"

    def has(self, place: str) -> bool:
        return (self.path(place) / MANIFEST).is_file()

    def places(self) -> list[str]:
        """Every artifact, by stage, name and key."""
        return sorted(str(manifest.parent.relative_to(self.root)) for manifest in self.root.glob(f"*/*/*/{MANIFEST}"))

    def unfinished(self) -> list[str]:
        """Folders in the store without a manifest."""
        return sorted(
            str(folder.relative_to(self.root))
            for folder in self.root.glob("*/*/*/")
            if not (folder / MANIFEST).is_file()
        )

    def in_work(self) -> list[str]:
        """What has been in the making, and may be."""
        work = self.results / "work"
        return sorted(str(lock.parent.relative_to(work)) for lock in work.glob("*/*/*/lock"))

    def manifest(self, place: str) -> dict[str, Any]:
        return _manifest(self.path(place))

    def make(self, place: str, identity: Mapping[str, Any], fill: Callable[[Workspace], Mapping[str, Any]]) -> bool:
        """Has `fill` make the payload and publishes it; False where the artifact is there already.

        `fill` returns run.json.
        """
        path, work = self.path(place), self.work(place)
        try:
            with held(self.lock(place), place):
                if self.has(place):
                    return False
                if path.exists():
                    if not damages(path, _checksums(path)) and (path / CHECKSUMS).is_file():
                        self._declare(path, place, identity)
                        return True
                    shutil.rmtree(path)
                space = _workspace(work)
                run = fill(space)
                self._publish(space, path, run)
                self._declare(path, place, identity)
                for left in (space.payload, space.state):
                    shutil.rmtree(left, ignore_errors=True)
                return True
        except Exception as error:
            if is_disk_full(error):
                raise disk_full(place, self.results) from error
            raise

    def remove(self, place: str) -> None:
        """Removes an artifact; waits for whoever is making it."""
        with held(self.lock(place), place):
            self._remove(place)

    def free(self, place: str) -> bool:
        """Removes an artifact and what is left of its making; False, at once, where it is being made."""
        with held(self.lock(place), place, wait=False) as mine:
            if mine:
                self._remove(place)
                remove_with_lock(self.lock(place))
            return mine

    def _remove(self, place: str) -> None:
        """The manifest goes first: half removed, it is no artifact any more."""
        path = self.path(place)
        (path / MANIFEST).unlink(missing_ok=True)
        shutil.rmtree(path, ignore_errors=True)
        _drop_empty(path.parent, self.root)

    def _publish(self, space: Workspace, path: Path, run: Mapping[str, Any]) -> None:
        if space.metrics.exists():
            os.replace(space.metrics, space.payload / METRICS)
        files = {file.relative_to(space.payload).as_posix(): _synced_digest(file) for file in _files(space.payload)}
        if not files:
            raise ArtifactError(
                f"{path}: the stage wrote nothing. This is a fault of the stage, not of the configuration."
            )
        _write_json(space.payload / CHECKSUMS, files)
        _write_json(space.payload / RUN, run)
        for folder in (space.payload, *(entry for entry in space.payload.rglob("*") if entry.is_dir())):
            _sync_folder(folder)
        _move(space.payload, path)
        _sync_folder(path.parent)

    def _declare(self, path: Path, place: str, identity: Mapping[str, Any]) -> None:
        """Writes the manifest, with the precision that the payload was computed in where its settings name one."""
        stage, name, key = place.split("/")
        precision = json.loads((path / RUN).read_text(encoding="utf-8")).get("precision_used")
        named = {"stage": stage, "name": name, "key": key} | ({"precision": precision} if precision else {})
        _write_json(path / MANIFEST, {**identity, **named, "payload": _checksums(path)})
        _sync_folder(path)


def absent(path: Path) -> list[str]:
    """Files that a restored artifact lacks; none of an artifact that was made here."""
    file = path / KEPT
    return json.loads(file.read_text(encoding="utf-8"))["absent"] if file.is_file() else []


def check(path: Path, restored: bool = False) -> None:
    """Quick look at an artifact before it is read: manifest, and every file at its size.

    restored: whether the reader does with the small files that a restored artifact has.
    """
    manifest = _manifest(path)
    missing = absent(path)
    if missing and not restored:
        raise ArtifactError(
            f"{path} was restored from kept results and lacks {len(missing)} of its files, such as {missing[0]}. "
            "Only a report reads it. Type: python -m acgd restore --discard, then run the workflow again, which makes it."
        )
    found = damages(path, manifest["payload"], read=False)
    if found:
        raise ArtifactError(
            f"{path} is damaged: {'; '.join(found[:5])}. "
            "Type: python -m acgd verify --repair, then run the workflow again."
        )


def damages(path: Path, payload: Mapping[str, Mapping[str, Any]], read: bool = True) -> list[str]:
    """What differs from the checksums, file by file; only sizes are compared unless `read`."""
    found, not_kept = [], set(absent(path))
    for name, known in payload.items():
        file = path / name
        if name in not_kept and not file.exists():
            continue
        if not file.is_file():
            found.append(f"{name} is missing")
        elif file.stat().st_size != known["bytes"]:
            found.append(f"{name} has {file.stat().st_size} bytes instead of {known['bytes']}")
        elif read and file_digest(file) != known["sha256"]:
            found.append(f"{name} has other content than was written")
    present = {file.relative_to(path).as_posix() for file in _files(path)}
    found.extend(f"{name} does not belong to it" for name in sorted(present - set(payload)))
    return found


def is_disk_full(error: BaseException | None) -> bool:
    """Also where a library has wrapped the error in its own."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return True
        error = error.__cause__ or error.__context__
    return False


def disk_full(place: str, results: Path) -> ArtifactError:
    free = shutil.disk_usage(results).free / 2**20
    return ArtifactError(
        f"{place}: the disk of {results.resolve()} is full ({free:.0f} MiB free). Nothing published is lost, "
        "and checkpoints are kept. Make room (python -m acgd gc frees what no study names), "
        "then run the workflow again."
    )


def _manifest(path: Path) -> dict[str, Any]:
    try:
        manifest = json.loads((path / MANIFEST).read_text(encoding="utf-8"))
        assert manifest["key"] == path.name and manifest["payload"]
    except FileNotFoundError:
        raise ArtifactError(f"{path}: there is no such artifact. Run the workflow, which makes it.") from None
    except (ValueError, KeyError, TypeError, AssertionError):
        raise ArtifactError(
            f"{path}: {MANIFEST} is damaged. Type: python -m acgd verify --repair, then run the workflow again."
        ) from None
    return manifest


def _checksums(path: Path) -> dict[str, Any]:
    try:
        return json.loads((path / CHECKSUMS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}


def _workspace(work: Path) -> Workspace:
    """Keeps the last maker's checkpoints; removes its half-written payload, and curves without a checkpoint."""
    space = Workspace(work / "payload", work / "state", work / METRICS)
    shutil.rmtree(space.payload, ignore_errors=True)
    space.payload.mkdir(parents=True)
    space.state.mkdir(exist_ok=True)
    if not any(space.state.iterdir()):
        space.metrics.unlink(missing_ok=True)
    return space


def _files(folder: Path) -> Iterator[Path]:
    for file in sorted(folder.rglob("*")):
        if file.is_file() and file.name not in IGNORED and not (file.parent == folder and file.name in NOT_PAYLOAD):
            yield file


def _synced_digest(file: Path) -> dict[str, Any]:
    with open(file, "rb") as opened:
        os.fsync(opened.fileno())
    return {"sha256": file_digest(file), "bytes": file.stat().st_size}


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    text = json.dumps(json.loads(canonical(content)), indent=1, sort_keys=True, ensure_ascii=False) + "\n"
    replace_text(path, text)


def _move(folder: Path, path: Path) -> None:
    """Renames `folder`. Makes the parent of `path` again where the removal of another artifact has just taken it."""
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.rename(folder, path)
            return
        except FileNotFoundError:
            if not folder.exists():
                raise


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _drop_empty(folder: Path, root: Path) -> None:
    while folder != root and folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
        folder = folder.parent
