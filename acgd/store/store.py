"""The store: every artifact in it is complete.

    results/store/<stage>/<name>/<key>/   payload, checksums.json, run.json, and manifest.json, which is written last
    results/work/<stage>/<name>/<key>/    an unfinished artifact: payload/, state/ (checkpoints), metrics.jsonl, lock

A stage fills `payload/`. The store then syncs every file to the disk, writes the checksums to `checksums.json`, renames
the folder into the store, and writes the manifest. A folder with a manifest is an artifact. After a kill the next maker
resumes from the checkpoints. If only the manifest is missing, the next maker verifies the checksums and writes it.
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
"""File of an artifact that was restored from kept results. It names the payload's files that were not kept."""
NOT_PAYLOAD = (MANIFEST, CHECKSUMS, RUN, KEPT)
IGNORED = (".snakemake_timestamp",)


class ArtifactError(Exception):
    """An artifact is missing, damaged or cannot be made. The user sees the text unchanged."""


@dataclass(frozen=True)
class Workspace:
    """Folders and metrics file of an artifact while it is made."""

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
        """Directory in which the artifact is made."""
        return self.results / "work" / place

    def lock(self, place: str) -> Path:
        """The lock file. The process that makes or removes the artifact holds the lock."""
        return self.work(place) / "lock"

    def has(self, place: str) -> bool:
        """Whether the store has the artifact. The check reads no file."""
        return (self.path(place) / MANIFEST).is_file()

    def places(self) -> list[str]:
        """Places `<stage>/<name>/<key>` of all artifacts, sorted."""
        return sorted(str(manifest.parent.relative_to(self.root)) for manifest in self.root.glob(f"*/*/*/{MANIFEST}"))

    def unfinished(self) -> list[str]:
        """Places of the folders in the store without a manifest, sorted."""
        return sorted(
            str(folder.relative_to(self.root))
            for folder in self.root.glob("*/*/*/")
            if not (folder / MANIFEST).is_file()
        )

    def in_work(self) -> list[str]:
        """Places that have a work folder with a lock file, sorted. A process may hold the lock or not."""
        work = self.results / "work"
        return sorted(str(lock.parent.relative_to(work)) for lock in work.glob("*/*/*/lock"))

    def manifest(self, place: str) -> dict[str, Any]:
        """The manifest. Raises ArtifactError where it is missing or damaged."""
        return _manifest(self.path(place))

    def make(
        self,
        place: str,
        identity: Mapping[str, Any],
        fill: Callable[[Workspace], Mapping[str, Any]],
        again: bool = False,
    ) -> bool:
        """Calls `fill` to make the payload and publishes it. Returns False where the store has the artifact already.

        `fill` returns the content of run.json. again: replaces a payload without manifest, even an undamaged one (the
        workflow removes the manifest of an artifact that it makes again). Raises ArtifactError on a full disk, and
        whatever `fill` raises.
        """
        path, work = self.path(place), self.work(place)
        try:
            with held(self.lock(place), place):
                if self.has(place):
                    return False
                if path.exists():
                    if not again and (path / CHECKSUMS).is_file() and not damages(path, _checksums(path)):
                        self._declare(path, place, identity)
                        return True
                    shutil.rmtree(path)
                space = _workspace(work)
                run = fill(space)
                self._publish(space, path, run)
                self._declare(path, place, identity)
                for folder in (space.payload, space.state):
                    shutil.rmtree(folder, ignore_errors=True)
                return True
        except Exception as error:
            if is_disk_full(error):
                raise disk_full(place, self.results) from error
            raise

    def remove(self, place: str) -> None:
        """Removes an artifact. Waits while another process makes the artifact."""
        with held(self.lock(place), place):
            self._remove(place)

    def free(self, place: str) -> bool:
        """Removes an artifact and its work folder. Returns False at once where another process makes the artifact."""
        with held(self.lock(place), place, wait=False) as locked:
            if locked:
                self._remove(place)
                remove_with_lock(self.lock(place))
            return locked

    def _remove(self, place: str) -> None:
        """Removes the manifest first, so that a partly removed folder is no artifact."""
        path = self.path(place)
        (path / MANIFEST).unlink(missing_ok=True)
        shutil.rmtree(path, ignore_errors=True)
        _drop_empty(path.parent, self.root)

    def _publish(self, space: Workspace, path: Path, run: Mapping[str, Any]) -> None:
        """Syncs the payload, writes checksums and run.json, and renames the folder to `path`."""
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
    """Names of the files that a restored artifact lacks. Empty for an artifact that a stage has made."""
    file = path / KEPT
    return json.loads(file.read_text(encoding="utf-8"))["absent"] if file.is_file() else []


def check(path: Path, restored: bool = False) -> None:
    """Checks the manifest, and name and size of every file, before an artifact is read.

    restored: whether the reader accepts a restored artifact, which has the small files only. Raises ArtifactError.
    """
    manifest = _manifest(path)
    missing = absent(path)
    if missing and not restored:
        raise ArtifactError(
            f"{path} was restored from kept results and lacks {len(missing)} of its files, such as {missing[0]}. "
            "Only a report can read it. Type: python -m acgd restore --discard. Then run the workflow, which makes it."
        )
    differences = damages(path, manifest["payload"], read=False)
    if differences:
        raise ArtifactError(
            f"{path} is damaged: {'; '.join(differences[:5])}. "
            "Type: python -m acgd verify --repair, then run the workflow again."
        )


def damages(path: Path, payload: Mapping[str, Mapping[str, Any]], read: bool = True) -> list[str]:
    """Differences between the files and their checksums, one text each. Without `read`, names and sizes only."""
    differences, not_kept = [], set(absent(path))
    for name, known in payload.items():
        file = path / name
        if name in not_kept and not file.exists():
            continue
        if not file.is_file():
            differences.append(f"{name} is missing")
        elif file.stat().st_size != known["bytes"]:
            differences.append(f"{name} has {file.stat().st_size} bytes instead of {known['bytes']}")
        elif read and file_digest(file) != known["sha256"]:
            differences.append(f"{name} has other content than was written")
    present = {file.relative_to(path).as_posix() for file in _files(path)}
    differences.extend(f"{name} does not belong to it" for name in sorted(present - set(payload)))
    return differences


def is_disk_full(error: BaseException | None) -> bool:
    """Whether the error, or an error that caused it, is a full disk or an exceeded quota."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return True
        error = error.__cause__ or error.__context__
    return False


def disk_full(place: str, results: Path) -> ArtifactError:
    """The error for the user."""
    free = shutil.disk_usage(results).free / 2**20
    return ArtifactError(
        f"{place}: the disk of {results.resolve()} is full ({free:.0f} MiB free). Nothing published is lost, "
        "and checkpoints are kept. Make room (python -m acgd gc frees artifacts that no study names), "
        "then run the workflow again."
    )


def _manifest(path: Path) -> dict[str, Any]:
    try:
        manifest = json.loads((path / MANIFEST).read_text(encoding="utf-8"))
        assert manifest["key"] == path.name and manifest["payload"]
    except FileNotFoundError:
        raise ArtifactError(f"{path}: no such artifact. Run the workflow, which makes it.") from None
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
    """Keeps the last maker's checkpoints. Removes its incomplete payload, and its metrics if it has no checkpoint."""
    space = Workspace(work / "payload", work / "state", work / METRICS)
    shutil.rmtree(space.payload, ignore_errors=True)
    space.payload.mkdir(parents=True)
    space.state.mkdir(exist_ok=True)
    if not any(space.state.iterdir()):
        space.metrics.unlink(missing_ok=True)
    return space


def _files(folder: Path) -> Iterator[Path]:
    """Files of the payload, sorted."""
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
    """Renames `folder` to `path`, from another disk by a copy.

    Makes the parent again if a concurrent removal of another artifact has removed it.
    """
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.rename(folder, path)
            return
        except FileNotFoundError:
            if not folder.exists():
                raise
        except OSError as error:
            if error.errno != errno.EXDEV:
                raise
            folder = _copied_beside(folder, path)


def _copied_beside(folder: Path, path: Path) -> Path:
    """A synced copy of `folder` on the disk of `path`, which may be another one than that of the work."""
    draft = path.with_name(path.name + ".draft")
    shutil.rmtree(draft, ignore_errors=True)
    shutil.copytree(folder, draft)
    for entry in (draft, *draft.rglob("*")):
        if entry.is_dir():
            _sync_folder(entry)
        else:
            with open(entry, "rb") as file:
                os.fsync(file.fileno())
    return draft


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
