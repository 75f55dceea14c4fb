"""The house: no folder imports upwards, and a new kind of student or a new stage is one file and one line."""

import ast
import shutil

import pytest
from workflow_runs import ROOT, workflow

from acgd import ORDER

PACKAGE = ROOT / "acgd"
LIGHT = {"torch", "numpy", "mujoco", "gymnasium", "scipy", "pandas", "zarr", "transformers", "safetensors"}


def imports(file):
    """Names of all imported modules of a source file, those inside of functions too."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{file} has a relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def part(file):
    """The folder or module of the package that a file belongs to."""
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


FILES = [file for file in sorted(PACKAGE.rglob("*.py")) if file != PACKAGE / "__init__.py"]


def test_the_order_names_every_folder_once():
    assert sorted(ORDER) == sorted({part(file) for file in FILES})


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_no_folder_imports_upwards(file):
    allowed = ORDER[: ORDER.index(part(file)) + 1]
    for name in imports(file):
        parts = name.split(".")
        if parts[0] == "acgd" and len(parts) > 1:
            below = parts[1] if parts[1] in ORDER else "__init__"
            assert below in (*allowed, "__init__"), f"{file.relative_to(ROOT)} imports {name}, which is above it"


@pytest.mark.parametrize(
    "file",
    [file for file in FILES if file.name in ("settings.py", "kinds.py", "zoo.py") or part(file) in ("chain", "study")],
    ids=lambda file: str(file.relative_to(PACKAGE)),
)
def test_settings_import_no_simulator_and_no_network_library(file):
    assert not {name.split(".")[0] for name in imports(file)} & LIGHT


@pytest.fixture
def copy(tmp_path):
    """A copy of the package and the workflow, to be extended."""
    for name in ("acgd", "workflow", "zoo"):
        shutil.copytree(ROOT / name, tmp_path / "copy" / name, ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "copy"


def insert_line(file, after, line):
    """Adds `line` below the first line that holds `after`."""
    lines = file.read_text().splitlines(keepends=True)
    at = next(i for i, text in enumerate(lines) if after in text)
    lines.insert(at + 1, line + "\n")
    file.write_text("".join(lines))


TOY_STAGE = '''"""Counts the steps of a task's demonstrations."""

import json

from acgd.settings import Request
from acgd.tasks.settings import TaskConfig


class CountRequest(Request):
    """What the count depends on."""

    task: TaskConfig


def count(request, inputs, ctx):
    summary = json.loads((inputs["rollouts"] / "summary.json").read_text())
    (ctx.out / "count.json").write_text(json.dumps({"task": request.task.name, "frames": summary["frames"]}))
'''


def test_a_toy_stage_is_one_file_and_one_line(copy, finished_miniature):
    shutil.copytree(finished_miniature / "results", copy / "results", ignore=shutil.ignore_patterns("work"))
    (copy / "acgd/collection/count.py").write_text(TOY_STAGE)
    place = "acgd.collection.count"
    insert_line(
        copy / "acgd/chain.py",
        "_TABLE = (",
        f'    Stage("count", 1, "{place}:CountRequest", "{place}:count", ("task",), (Read("rollouts"),), wanted=True),',
    )
    said = workflow(copy, "all", root=copy)
    assert said.count("started\n") == 3, "two counts and the report"
    for task in ("myo-obj-hold", "myo-reach"):
        folder = copy / (copy / f"results/miniature/acgd/{task}/count").read_text().strip()
        assert '"frames"' in (folder / "count.json").read_text()
