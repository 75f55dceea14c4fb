"""The key of an artifact: a hash of everything that its content depends on, and of nothing else."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic_core import to_jsonable_python

from acgd.settings import OUTSIDE_KEY, Request
from acgd.store.stage import Stage

KEY_LENGTH = 16

InputKeys = Mapping[str, "str | list[str]"]
"""Role -> key, or keys, of the upstream artifacts."""


def canonical(value: Any) -> str:
    """JSON text, the same for equal values: sorted keys, no spaces. Raises ValueError for NaN and infinity."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def identity(stage: Stage, request: Request, inputs: InputKeys, world: Mapping[str, Any]) -> dict[str, Any]:
    """The content that the key hashes.

    world: digests of the task definitions; empty for a stage that neither simulates nor draws.
    """
    return {
        "stage": stage.name,
        "version": stage.version,
        "world": dict(world),
        "request": in_key(request),
        "files": {path.name: file_digest(path) for path in request.files()},
        "inputs": dict(inputs),
    }


def key_of(identity: Mapping[str, Any]) -> str:
    """The first 16 hex digits of the identity's SHA-256.

    With 10^8 artifacts in a store, the probability of a collision is 3e-4.
    """
    return hashlib.sha256(canonical(identity).encode()).hexdigest()[:KEY_LENGTH]


def in_key(value: Any) -> Any:
    """`value` as JSON, without the fields that are declared with `json_schema_extra=OUTSIDE_KEY`.

    A path is replaced by the digest of its file's or folder's content. A section with a method `files_of(field)` names
    the files of a folder that count.
    """
    if isinstance(value, BaseModel):
        fields = type(value).model_fields
        return {
            name: _field(value, name) for name, field in fields.items() if not _outside_key(field.json_schema_extra)
        }
    if isinstance(value, Path):
        return content_digest(value)
    if isinstance(value, Mapping):
        return {str(name): in_key(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [in_key(item) for item in value]
    return to_jsonable_python(value)


def content_digest(path: Path) -> str | dict[str, str]:
    """SHA-256 of a file. For a folder: relative path -> SHA-256 of each file.

    Hidden files and folders are left out: they belong to git, to a download's cache or to a file browser.
    """
    if path.is_dir():
        files = sorted(file for file in path.rglob("*") if file.is_file())
        return _digests(path, [file for file in files if not _hidden(file.relative_to(path))])
    return file_digest(path)


def _field(section: BaseModel, name: str) -> Any:
    value = getattr(section, name)
    if isinstance(value, Path) and hasattr(section, "files_of"):
        return _digests(value, section.files_of(name))
    return in_key(value)


def _digests(folder: Path, files: Iterable[Path]) -> dict[str, str]:
    """Relative path -> SHA-256."""
    return {file.relative_to(folder).as_posix(): file_digest(file) for file in files}


def _hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)


def file_digest(path: Path) -> str:
    """SHA-256 of a file. A process reads a file again only if its inode, size or modification time has changed."""
    stat = path.stat()
    return _digest(path, stat.st_ino, stat.st_size, stat.st_mtime_ns)


@cache
def _digest(path: Path, inode: int, size: int, mtime_ns: int) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _outside_key(extra: Any) -> bool:
    return isinstance(extra, dict) and OUTSIDE_KEY.items() <= extra.items()
