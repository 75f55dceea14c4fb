"""The folder of an export. It appears when it is complete, and nothing is overwritten."""

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from acgd.store.key import file_digest
from acgd.store.store import ArtifactError

SUMS = "SHA256SUMS"


def check(folder: Path) -> None:
    """Raises ArtifactError where the folder is not empty."""
    if folder.is_file() or (folder.is_dir() and any(folder.iterdir())):
        raise ArtifactError(f"{folder} holds something already: name a folder that is empty or absent")


@contextlib.contextmanager
def filled(folder: Path) -> Iterator[Path]:
    """A draft beside the folder. It is renamed to the folder at the end of the context."""
    check(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        yield draft
        draft.chmod(0o755)
        check(folder)
        draft.replace(folder)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def write_sums(folder: Path) -> str:
    """Writes SHA256SUMS of all files in the form of sha256sum. Returns the SHA-256 of that file."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != SUMS)
    lines = [f"{file_digest(file)}  {file.relative_to(folder).as_posix()}\n" for file in files]
    (folder / SUMS).write_text("".join(lines), encoding="utf-8")
    return file_digest(folder / SUMS)
