"""Curves of a stage: a file with one JSON object per line, beside the stage's artifact.

The file is the source of truth; MLflow mirrors it. The file has no time stamps, so equal runs write equal bytes.
"""

import json
import math
import os
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from acgd.store.atomic import replace_text

Row = dict[str, Any]
"""{"step": int, name: float, ...}"""

FLUSH_EVERY = 200
"""Rows in memory at most. The limit lets a user watch the curves of a running stage."""

_NON_FINITE = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}


class Metrics:
    """Appends rows to `path`. A stage calls `flush` before each checkpoint, and `rewind(step)` when it resumes."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._pending: list[str] = []

    def log(self, step: int, **values: float) -> None:
        """Adds one row. Values are Python, numpy or torch scalars. Non-finite values become "nan", "inf" or "-inf"."""
        row: Row = {"step": int(step)}
        for name, value in values.items():
            row[name] = _encode(float(value))
        self._pending.append(json.dumps(row) + "\n")
        if len(self._pending) >= FLUSH_EVERY:
            self.flush()

    def flush(self) -> None:
        """Appends all pending rows to the file and syncs the file to the disk."""
        if not self._pending:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with open(self.path, "a", encoding="utf-8") as file:
            file.write("".join(self._pending))
            file.flush()
            os.fsync(file.fileno())
        self._pending.clear()

    def rewind(self, step: int) -> None:
        """Drops the rows after `step`, and an incomplete last line. The resumed stage logs these steps again."""
        self.flush()
        if not self.path.exists():
            return
        kept = [line for line in _whole_lines(self.path) if json.loads(line)["step"] <= step]
        replace_text(self.path, "".join(kept))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.flush()


def read(path: Path) -> list[Row]:
    """The rows of a metrics file in the order of logging; an empty list without a file."""
    path = Path(path)
    if not path.exists():
        return []
    return [{name: _decode(value) for name, value in json.loads(line).items()} for line in _whole_lines(path)]


def _whole_lines(path: Path) -> list[str]:
    """Lines that end in a newline. A kill can leave an incomplete last line."""
    with open(path, encoding="utf-8") as file:
        return [line for line in file if line.endswith("\n")]


def _encode(value: float) -> float | str:
    """A finite number, or a string for NaN and infinity, which JSON lacks. The curve of a diverged loss keeps them."""
    return value if math.isfinite(value) else str(value)


def _decode(value: float | str) -> float:
    return _NON_FINITE[value] if isinstance(value, str) else value
