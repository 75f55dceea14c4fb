"""The project's one writer of files. A file that it writes is whole or absent."""

import os
from collections.abc import Callable
from pathlib import Path


def replace_file(path: Path, write: Callable[[Path], object]) -> None:
    """Lets `write` fill a draft beside `path`, syncs the draft to the disk, and renames it to `path`.

    A kill leaves the old file. It may leave the draft too, which the next writer overwrites. A file must have one
    writer at a time. Raises OSError of a full disk, and whatever `write` raises; the draft is removed then.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(path.name + ".draft")
    try:
        write(draft)
        with open(draft, "rb") as file:
            os.fsync(file.fileno())
    except BaseException:
        draft.unlink(missing_ok=True)  # on a full disk the draft would block other writers
        raise
    os.replace(draft, path)


def replace_text(path: Path, text: str) -> None:
    """Replaces the file at `path` by a text in UTF-8."""
    replace_file(path, lambda draft: draft.write_text(text, encoding="utf-8"))
