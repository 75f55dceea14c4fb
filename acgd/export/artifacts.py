"""Which artifacts an export reads: named by their folder, or by a name of a study."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from acgd.store.store import MANIFEST, ArtifactError, damages


def manifest(folder: Path) -> dict[str, Any]:
    """What the artifact was made of, and its checksums. ArtifactError where the folder holds none."""
    try:
        return json.loads((Path(folder) / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ArtifactError(f"{folder} is no finished artifact: {MANIFEST} cannot be read ({error})") from error


def named(name: Path, stages: Sequence[str]) -> list[Path]:
    """Folders of the whole artifacts of one of the `stages` that a folder or a name of a study stands for.

    A name is a small file such as results/<study>/<variant>/<task>/rollouts, which lists folders.
    """
    if (name / MANIFEST).is_file():
        folders = [name]
    elif name.is_file():
        try:
            lines = name.read_text(encoding="utf-8").split()
        except UnicodeDecodeError as error:
            raise ArtifactError(f"{name} is no name of a study: it is no text") from error
        folders = [_listed(name, line) for line in lines]
    else:
        raise ArtifactError(
            f"there is no artifact and no name {name}. "
            "Give a folder of results/store, or a name such as results/<study>/<variant>/rollouts."
        )
    for folder in folders:
        _check(folder, stages)
    return folders


def _listed(name: Path, line: str) -> Path:
    """A folder as a name's file lists it: relative to where the workflow ran, which is above the file."""
    for above in (Path(), *name.resolve().parents):
        if (above / line / MANIFEST).is_file():
            return above / line
    raise ArtifactError(f"{name} lists {line}, where there is no artifact: run the workflow, which makes it anew")


def _check(folder: Path, stages: Sequence[str]) -> None:
    said = manifest(folder)
    if said["stage"] not in stages:
        raise ArtifactError(f"{folder} is of the stage {said['stage']}; this format takes {' or '.join(stages)}")
    if faults := damages(folder, said["payload"]):
        raise ArtifactError(f"{folder} is damaged: {'; '.join(faults[:3])}. Type: python -m acgd verify --repair")


def upstream(folder: Path, role: str) -> list[Path]:
    """Folders of the artifacts that one was made from; those that are no longer in the store are left out."""
    keys = manifest(folder)["inputs"].get(role, [])
    found = [_with_key(folder, key) for key in ([keys] if isinstance(keys, str) else keys)]
    return [path for path in found if path is not None]


def downstream(folder: Path, stage: str, role: str) -> Iterator[Path]:
    """Folders of the artifacts of a stage that were made from one."""
    key = Path(folder).resolve().name
    for path in sorted(_store(folder).glob(f"{stage}/*/*/{MANIFEST}")):
        inputs = manifest(path.parent)["inputs"].get(role, [])
        if key in ([inputs] if isinstance(inputs, str) else inputs):
            yield path.parent


def _with_key(folder: Path, key: str) -> Path | None:
    return next((path.parent for path in _store(folder).glob(f"*/*/{key}/{MANIFEST}")), None)


def _store(folder: Path) -> Path:
    return Path(folder).resolve().parents[2]
