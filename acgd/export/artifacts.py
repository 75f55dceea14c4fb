"""The artifacts that an export reads, given by their folder or by a name of a study."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from acgd.store.store import MANIFEST, ArtifactError, damages


def manifest(folder: Path) -> dict[str, Any]:
    """Request, inputs and checksums of an artifact. ArtifactError where the folder holds none."""
    try:
        return json.loads((Path(folder) / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ArtifactError(f"{folder} is no finished artifact: {MANIFEST} cannot be read ({error})") from error


def named(name: Path, stages: Sequence[str]) -> list[Path]:
    """Folders of the artifacts that `name` stands for. ArtifactError for a damaged one, or one of another stage.

    name: the folder of an artifact; or a small file such as results/<study>/<variant>/<task>/rollouts, which lists
    folders.
    """
    if (name / MANIFEST).is_file():
        folders = [name]
    elif name.is_file():
        try:
            lines = name.read_text(encoding="utf-8").split()
        except UnicodeDecodeError as error:
            raise ArtifactError(f"{name} is no name of a study: it is not text") from error
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
    """The folder of a line in the file of a name. It is relative to the folder of the workflow, above the file."""
    for above in (Path(), *name.resolve().parents):
        if (above / line / MANIFEST).is_file():
            return above / line
    raise ArtifactError(f"{name} lists {line}, where there is no artifact: run the workflow, which makes it anew")


def _check(folder: Path, stages: Sequence[str]) -> None:
    content = manifest(folder)
    if content["stage"] not in stages:
        raise ArtifactError(f"{folder} is of the stage {content['stage']}; this format takes {' or '.join(stages)}")
    if faults := damages(folder, content["payload"]):
        raise ArtifactError(f"{folder} is damaged: {'; '.join(faults[:3])}. Type: python -m acgd verify --repair")


def upstream(folder: Path, role: str) -> list[Path]:
    """Folders of an artifact's inputs of one role, as far as they are still in the store."""
    keys = manifest(folder)["inputs"].get(role, [])
    paths = [_with_key(folder, key) for key in ([keys] if isinstance(keys, str) else keys)]
    return [path for path in paths if path is not None]


def downstream(folder: Path, stage: str, role: str) -> Iterator[Path]:
    """Folders of the artifacts of a stage that have an artifact as input."""
    key = Path(folder).resolve().name
    for path in sorted(_store(folder).glob(f"{stage}/*/*/{MANIFEST}")):
        inputs = manifest(path.parent)["inputs"].get(role, [])
        if key in ([inputs] if isinstance(inputs, str) else inputs):
            yield path.parent


def _with_key(folder: Path, key: str) -> Path | None:
    return next((path.parent for path in _store(folder).glob(f"*/*/{key}/{MANIFEST}")), None)


def _store(folder: Path) -> Path:
    return Path(folder).resolve().parents[2]
