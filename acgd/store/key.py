"""The key of an artifact: a hash of everything its content depends on, and of nothing else."""

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic_core import to_jsonable_python

from acgd.settings import OUTSIDE_KEY, Request
from acgd.store.stage import Stage

KEY_LENGTH = 16

InputKeys = Mapping[str, "str | list[str]"]
"""Role -> key, or keys, of the artifacts upstream."""


def canonical(value: Any) -> str:
    """JSON that is the same text for equal values: sorted keys, no spaces, no NaN."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def identity(stage: Stage, request: Request, inputs: InputKeys, world: Mapping[str, Any]) -> dict[str, Any]:
    """What is hashed, as JSON. `world`: what defines the simulated tasks, where the stage simulates or draws them."""
    return {
        "stage": stage.name,
        "version": stage.version,
        "world": dict(world),
        "request": in_key(request),
        "files": {path.name: file_digest(path) for path in request.files()},
        "inputs": dict(inputs),
    }


def key_of(identity: Mapping[str, Any]) -> str:
    """The first 16 hex digits of the SHA-256 of the identity: one chance collision in a store of 10^8 artifacts is unlikely (3e-4)."""
    return hashlib.sha256(canonical(identity).encode()).hexdigest()[:KEY_LENGTH]


def in_key(value: Any) -> Any:
    """`value` as JSON without what must not change a key.

    Fields declared with `json_schema_extra=OUTSIDE_KEY` are left out. A path counts by the content of the file or folder
    that it names.
    """
    if isinstance(value, BaseModel):
        fields = type(value).model_fields
        return {
            name: in_key(getattr(value, name))
            for name, field in fields.items()
            if not _outside_key(field.json_schema_extra)
        }
    if isinstance(value, Path):
        return content_digest(value)
    if isinstance(value, Mapping):
        return {str(name): in_key(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [in_key(item) for item in value]
    return to_jsonable_python(value)


def content_digest(path: Path) -> str | dict[str, str]:
    """SHA-256 of a file; of each file, by its place in the folder, for a folder."""
    if path.is_dir():
        files = sorted(file for file in path.rglob("*") if file.is_file())
        return {file.relative_to(path).as_posix(): file_digest(file) for file in files}
    return file_digest(path)


def file_digest(path: Path) -> str:
    """SHA-256 of a file. Within one process a file that looks untouched (inode, size, time) is read once."""
    stat = path.stat()
    return _digest(path, stat.st_ino, stat.st_size, stat.st_mtime_ns)


@cache
def _digest(path: Path, inode: int, size: int, mtime_ns: int) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _outside_key(extra: Any) -> bool:
    return isinstance(extra, dict) and OUTSIDE_KEY.items() <= extra.items()
