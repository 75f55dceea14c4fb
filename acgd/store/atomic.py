"""The project's one writer of files that are either whole or not there."""

import os
from collections.abc import Callable
from pathlib import Path


def replace_file(path: Path, write: Callable[[Path], object]) -> None:
    """Lets `write` fill a draft beside `path`, brings it onto the disk, and only then gives it the name.

    A kill leaves the old file, and perhaps the draft, which the next writer overwrites. A file has one writer at a
    time.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(path.name + ".draft")
    try:
        write(draft)
        with open(draft, "rb") as file:
            os.fsync(file.fileno())
    except BaseException:
        draft.unlink(missing_ok=True)  # on a full disk it would keep others from writing
        raise
    os.replace(draft, path)


def replace_text(path: Path, text: str) -> None:
    """The same for a text in UTF-8."""
    replace_file(path, lambda draft: draft.write_text(text, encoding="utf-8"))
