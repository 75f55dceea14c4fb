"""The house: no folder imports upwards, and a new kind of student or a new stage is one file and one line."""

import ast
import json
import re
import shutil

import pytest
import yaml
from workflow_runs import ROOT, STUDY, workflow

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


def started(said):
    """Stages of the jobs that a workflow ran, sorted; publishing is none."""
    return sorted(re.findall(r"^(\w+)/\S+: started$", said, re.MULTILINE))


@pytest.fixture
def finished(copy, finished_miniature):
    """The copy, with all that the miniature has made."""
    shutil.copytree(finished_miniature / "results", copy / "results", ignore=shutil.ignore_patterns("work"))
    return copy


def artifact(folder, name):
    """Directory of the artifact of the miniature's name."""
    return folder / (folder / f"results/miniature/{name}").read_text().strip()


def test_a_toy_stage_is_one_file_and_one_line(finished):
    (finished / "acgd/collection/count.py").write_text(TOY_STAGE)
    place = "acgd.collection.count"
    insert_line(
        finished / "acgd/chain.py",
        "_TABLE = (",
        f'    Stage("count", 1, "{place}:CountRequest", "{place}:count", ("task",), (Read("rollouts"),), wanted=True),',
    )
    assert started(workflow(finished, "all", root=finished)) == ["count", "count", "report"]
    for task in ("myo-obj-hold", "myo-reach"):
        assert '"frames"' in (artifact(finished, f"acgd/{task}/count") / "count.json").read_text()


TOY_STUDENT = '''"""A student that sees nothing: one constant action for each task."""

from typing import ClassVar, Literal

from acgd.settings import Section


class ToySettings(Section):
    """No hyperparameters."""

    needs: ClassVar[tuple[str, ...]] = ()
    recurrent: ClassVar[bool] = False
    chunk: ClassVar[int] = 1
    history: ClassVar[int] = 1

    kind: Literal["toy"] = "toy"


def toy(settings, imitation, sizes):
    """The network. Defined in here, so that settings import no torch."""
    import torch
    from torch import nn

    from acgd.nn.losses import l1
    from acgd.students.student import Imitation

    class Toy(nn.Module):
        def __init__(self):
            super().__init__()
            self.settings, self.imitation, self.sizes = settings, imitation, sizes
            self.actions = nn.Embedding(sizes.tasks, sizes.actions)

        def initialise(self, data, inputs):
            pass

        def prepare(self, data, inputs):
            return {}

        def forward(self, task):
            return self.actions(task).tanh()[:, None]

        def imitate(self, batch, *, guided, noise, generators):
            action = self(batch.observation.task)
            error = l1(action, batch.chunk, batch.mask)
            return Imitation(error, action[:guided] if guided else None, {"l_act": error})

        def validate(self, batch):
            return {}

        @torch.no_grad()
        def plan(self, observation):
            return self(observation.task)

        def policy(self, acting):
            return ToyPolicy(self)

    return Toy()


class ToyPolicy:
    """Remembers its tasks."""

    def __init__(self, student):
        self.student = student.eval()

    def start(self, tasks, goals, seeds):
        import torch

        return torch.as_tensor(tasks)

    def act(self, observations, memory):
        return self.student(memory)[:, 0].detach().numpy(), memory
'''


def test_a_toy_student_kind_is_one_file_and_one_line(finished, tmp_path):
    (finished / "acgd/students/toy.py").write_text(TOY_STUDENT)
    insert_line(
        finished / "acgd/students/kinds.py",
        "STUDENTS: dict",
        '    "toy": Kind("acgd.students.toy:ToySettings", "acgd.students.toy:toy"),',
    )
    study = yaml.safe_load(STUDY.read_text())
    study["variants"]["toy"] = {"student": {"kind": "toy"}, "guidance": {"kind": "critic"}}
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(study))
    said = workflow(finished, "all", root=finished, study=tmp_path / "study.yaml")
    assert started(said) == ["clips", "evaluation", "report", "student"]
    student = json.loads((artifact(finished, "toy/seed-0/student") / "student.json").read_text())
    assert student["kind"] == "toy" and set(student["guidance"]) > {"kind"}
    rows = (artifact(finished, "toy/seed-0/evaluation") / "episodes.jsonl").read_text().splitlines()
    assert len(rows) == len(study["tasks"]) * study["evaluation"]["episodes"]
    assert "toy" in (finished / "results/miniature/success.csv").read_text()
