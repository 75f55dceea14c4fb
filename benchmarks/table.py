"""Runs benchmarks and writes results/bench.json: `make bench`, or `python -m benchmarks.table rendering student`."""

import json
import multiprocessing
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from pathlib import Path
from typing import Any

BENCHMARKS = (
    "rendering",
    "dexterous",
    "experts",
    "collecting",
    "student",
    "ranking",
    "evaluation",
    "verdict",
    "onnx",
    "study",
)
"""Modules with `run() -> list[Row]`."""
RESULT = Path("results/bench.json")
FIELDS = ("value", "unit", "ratio", "target", "met")


def main(names: Sequence[str]) -> int:
    """Runs the named benchmarks, each in a separate process. Returns 1 for an unknown name or a failed benchmark."""
    unknown = [name for name in names if name not in BENCHMARKS]
    if unknown:
        print(f"error: no benchmark {', '.join(unknown)}. There are: {', '.join(BENCHMARKS)}", file=sys.stderr)
        return 1
    rows, failures = [], {}
    for name in names or BENCHMARKS:
        print(f"measuring {name} ...", file=sys.stderr, flush=True)
        try:
            rows += _measured(name)
        except Exception as error:  # other benchmarks still run
            failures[name] = f"{type(error).__name__}: {error}"
    print(table(rows))
    for name, failure in failures.items():
        print(f"{name}: not measured. {failure}")
    write(rows, RESULT)
    print(f"\nwritten to {RESULT}")
    return 1 if failures else 0


def _measured(name: str) -> list[dict[str, Any]]:
    """Rows of one benchmark, from a new process, so that benchmarks share no threads, memory or OpenGL context."""
    with ProcessPoolExecutor(max_workers=1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_run, name).result()


def _run(name: str) -> list[dict[str, Any]]:
    return [dict(row) for row in import_module(f"benchmarks.{name}").run()]


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The rows as aligned text."""
    cells = [("what", "value", "unit", "ratio", "met", "target")]
    for row in rows:
        ratio = "" if row["ratio"] is None else f"{row['ratio']:.3g}"
        met = {True: "yes", False: "NO", None: ""}[None if row["met"] is None else bool(row["met"])]
        cells.append((row["name"], f"{row['value']:.4g}", row["unit"], ratio, met, row["target"]))
    widths = [max(len(row[i]) for row in cells) for i in range(len(cells[0]))]
    numbers = (1, 3)
    return "\n".join(
        "  ".join(
            cell.rjust(w) if i in numbers else cell.ljust(w) for i, (cell, w) in enumerate(zip(row, widths))
        ).rstrip()
        for row in cells
    )


def write(rows: Sequence[dict[str, Any]], file: Path) -> None:
    """Updates `file`: name -> value, unit, ratio, target, met. Entries of other benchmarks stay."""
    stored = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    stored.update({row["name"]: {field: row[field] for field in FIELDS} for row in rows})
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(stored, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
