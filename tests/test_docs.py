"""The pages written by hand do not drift: what they name exists, and their examples run."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from workflow_runs import workflow

import acgd
from acgd import chain
from acgd.study.load import validated
from acgd.study.study import Study

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
GENERATED = DOCS / "configuration.md"
PAGES = [ROOT / "README.md", ROOT / "zoo/README.md", *(page for page in sorted(DOCS.glob("*.md")) if page != GENERATED)]
SETTING = re.compile(r"`([a-z_]+(?:\.[a-z_]+)*): ([^`]+)`")
STUDY_CODE = re.compile(r"^```yaml\n(.*?)^```", re.M | re.S)
FOLDERS = "|".join(name for name in acgd.ORDER if (ROOT / "acgd" / name).is_dir())
TOP = "acgd|workflow|scripts|benchmarks|tests|studies|docs|zoo"
FILE = re.compile(rf"`((?:{TOP})/[\w./-]+\.\w+|[\w.-]+\.(?:toml|lock)|requirements\.txt)`")
CODE = re.compile(rf"`((?:{FOLDERS})/[\w/]*(?:\.py)?)`")
LINK = re.compile(r"\]\(([^)#:]+)(?:#[\w-]+)?\)")
VERB = re.compile(r"python -m acgd ([a-z-]+)")
BLOCK = re.compile(
    r"^`(acgd/[\w/]+\.py)`:\n\n```python\n(.*?)^```|, `(acgd/[\w/]+\.py)`:\n\n```python\n(.*?)^```", re.M | re.S
)
SECTIONS = set(Study.model_fields)
ADDED_BY_EXAMPLES = {"acgd/students/mlp/settings.py", "acgd/students/mlp/model.py", "acgd/tasks/kinds/key_turn_wide.py"}


def matches(pattern: re.Pattern[str]) -> list[tuple[str, ...]]:
    """(page, group, ...) for every place on the pages where the pattern matches."""
    named = [(str(page.relative_to(ROOT)), *m.groups()) for page in PAGES for m in pattern.finditer(page.read_text())]
    assert named, f"nothing on the pages matches {pattern.pattern}"
    return list(dict.fromkeys(named))


def is_setting(key: str, value: str) -> bool:
    """Whether `key: value` is of a study: its first name is a section. `mode: first` alone could be of any section."""
    return "." in key or (key in SECTIONS and value.startswith("{"))


SETTINGS = [found for found in matches(SETTING) if is_setting(*found[1:])]


def test_the_patterns_match_something() -> None:
    assert len(SETTINGS) > 20 and len(matches(FILE)) > 30 and len(matches(LINK)) > 10 and len(matches(VERB)) > 5


@pytest.mark.parametrize(("page", "key", "value"), SETTINGS)
def test_every_setting_can_be_set(
    page: str, key: str, value: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "model.pt").write_bytes(b"\x80")  # the checkpoint that an example names
    monkeypatch.chdir(tmp_path)
    content = yaml.safe_load(value)
    for name in reversed(key.split(".")):
        content = {name: content}
    validated(Study, content)


@pytest.mark.parametrize(("page", "file"), matches(FILE))
def test_every_file_is_there(page: str, file: str) -> None:
    assert (ROOT / file).exists() or file in ADDED_BY_EXAMPLES, f"{page} names {file}"


@pytest.mark.parametrize(("page", "target"), matches(LINK))
def test_every_link_leads_somewhere(page: str, target: str) -> None:
    assert ((ROOT / page).parent / target).exists(), f"{page} links to {target}"


@pytest.mark.parametrize(("page", "verb"), matches(VERB))
def test_every_verb_is_there(page: str, verb: str) -> None:
    from acgd.__main__ import _parser

    (verbs,) = (action.choices for action in _parser()._actions if action.choices)
    assert verb in verbs, f"{page} names the verb {verb}"


def test_the_code_column_of_the_deviations_names_files() -> None:
    rows = [row for row in (DOCS / "deviations.md").read_text().splitlines() if re.match(r"\| \d+ \|", row)]
    columns = [row.split(" | ")[-1] for row in rows]
    named = [CODE.findall(column) for column in columns]
    assert len(rows) > 10 and all(named), "every reading names its code"
    assert [name for names in named for name in names if not (ROOT / "acgd" / name).exists()] == []


def test_the_page_of_the_house_lists_every_folder_and_every_stage() -> None:
    page = (DOCS / "house.md").read_text()
    folders = re.findall(r"^\| `(\w+)(?:\.py|/)` \|", page, re.M)
    assert folders == list(acgd.ORDER)
    table = page.split("## Stages")[1].split("\n## ")[0]
    assert re.findall(r"^\| `(\w+)` \|", table, re.M) == chain.names()


def test_the_studies_of_the_pages_are_valid() -> None:
    known = {"myo/key-turn-wide": "myo/key-turn", "kind: mlp": "kind: bc"}
    checked = 0
    for page in PAGES:
        for code in STUDY_CODE.findall(page.read_text()):
            for name, stands_in in known.items():
                code = code.replace(name, stands_in)
            content = yaml.safe_load(code)
            if set(content) <= SECTIONS:
                for variant in validated(Study, content).resolved.values():
                    assert variant.tasks
                checked += 1
    assert checked > 2


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the project, to follow a page in."""
    for name in ("acgd", "workflow", "zoo"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def write_blocks(page: str, root: Path) -> list[str]:
    """Writes the Python files of a page into a copy, and gives their names."""
    written = []
    for match in BLOCK.finditer((DOCS / page).read_text()):
        name, code = (group for group in match.groups() if group is not None)
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).parent.joinpath("__init__.py").touch()
        (root / name).write_text(code)
        written.append(name)
    return written


def insert_above(file: Path, line: str, code: str) -> None:
    """Inserts code above the first place that begins with `line`."""
    text = file.read_text()
    assert line in text
    file.write_text(text.replace(line, code + line, 1))


def test_the_student_of_the_page_runs_through_the_miniature(copy: Path, finished_miniature: Path) -> None:
    assert len(write_blocks("adding-a-student.md", copy)) == 2
    (line,) = re.findall(r'^    "mlp": Kind\(.*\n', (DOCS / "adding-a-student.md").read_text(), re.M)
    insert_above(copy / "acgd/students/kinds.py", '    "bc": Kind(', line)
    study = yaml.safe_load((ROOT / "tests/miniature.yaml").read_text())
    study["variants"]["mlp"] = {"student": {"kind": "mlp"}, "guidance": {"kind": "critic"}}
    (copy / "miniature.yaml").write_text(yaml.safe_dump(study))
    shutil.copytree(finished_miniature / "results", copy / "results", ignore=shutil.ignore_patterns("work"))
    printed = workflow(copy, "all", root=copy, study=copy / "miniature.yaml")
    assert printed.count("started\n") == 4, "a student, its evaluation, its clips and the report"
    assert (
        '"kind": "mlp"'
        in Path(copy / (copy / "results/miniature/mlp/student").read_text().strip(), "student.json").read_text()
    )


def test_the_task_of_the_page_runs(copy: Path) -> None:
    page = (DOCS / "adding-a-task.md").read_text()
    assert len(write_blocks("adding-a-task.md", copy)) == 1
    (row,) = re.findall(r"^```python\n(    TaskSpec\(\n.*?)^```", page, re.M | re.S)
    insert_above(copy / "acgd/tasks/spec.py", '    TaskSpec(\n        "bidex/bottle",', row)
    (script,) = re.findall(r'^python -c "\n(.*?)"\n^```', page, re.M | re.S)
    environment = os.environ | {"PYTHONPATH": str(copy)}
    subprocess.run([sys.executable, "-c", script], cwd=copy, env=environment, check=True, capture_output=True)
    assert (copy / "task.png").exists()
