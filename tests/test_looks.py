"""What people ask of the workflow: looks, forced jobs, interrupted runs, and folders with any name.

The jobs of these runs are a shell script in place of Python, which declares an artifact at once.
"""

import json
import re
import shutil
import sys
from pathlib import Path

import pytest
from test_workflow import ROOT, STUDY, dry_run, jobs, published, run

from acgd.store.store import Store
from acgd.study import names
from acgd.study.plan import plan
from acgd.study.study import load_study
from acgd.tracking.mlflow_mirror import database_uri

STAND_IN = """#!/bin/bash
# $1 $2 $3 $4: -m acgd <stage> results/work/<stage>/<name>/<key>/request.json
set -e
case "$3" in
publish) exec "{python}" "$@" ;;
mlflow-sync) mkdir -p results/work/mirrored/t; touch "results/work/mirrored/t/$5" ;;
*)
    [ -e stop-at-"$3" ] && exit 1
    again=-; grep -q '"again":true' "$4" && again=again
    echo "$3 $again" >> made
    [ -d "$PYTHONPATH/acgd" ]
    folder=$(dirname "${{4/work/store}}")
    mkdir -p "$folder"; echo page > "$folder/report.html"; touch "$folder/manifest.json" ;;
esac
"""


@pytest.fixture
def stand_in(tmp_path_factory, monkeypatch):
    """A program in place of Python. It appends a line to `made` for each artifact."""
    file = tmp_path_factory.mktemp("l'étude [x] {y}") / "python #1?"
    file.write_text(STAND_IN.format(python=sys.executable))
    file.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(file))


@pytest.fixture(scope="module")
def finished_once(tmp_path_factory):
    folder = tmp_path_factory.mktemp("once")
    published(folder, STUDY)
    (folder / "study.json").write_text(json.dumps(STUDY))
    return folder


@pytest.fixture
def finished(finished_once, tmp_path):
    """A folder of its own with the finished study."""
    folder = tmp_path / "finished"
    shutil.copytree(finished_once, folder)
    return folder


def edited(folder, **edit):
    file = folder / "edited.json"
    file.write_text(json.dumps({**STUDY, **edit}))
    return file


def tree(folder):
    """Path -> content and time of everything but Snakemake's own folder."""
    files = [file for file in folder.rglob("*") if ".snakemake" not in file.parts]
    return {file: file.is_file() and (file.read_bytes(), file.stat().st_mtime_ns) for file in files}


def made(folder):
    file = folder / "made"
    lines = file.read_text().splitlines() if file.exists() else []
    file.unlink(missing_ok=True)
    return lines


@pytest.mark.parametrize(
    "look", ["-n", "--summary", "--list-rules", "--unlock", "--rulegraph", "--list-changes=code", "--lint"]
)
def test_looking_changes_nothing(finished, look):
    file = edited(finished, seeds=[7])
    before = tree(finished)
    run(finished, *look.split("="), "--configfile", file)
    assert tree(finished) == before


def test_looking_at_a_fresh_study_writes_nothing(tmp_path):
    file = edited(tmp_path)
    before = tree(tmp_path)
    for look in ("-n", "--summary", "--unlock"):
        run(tmp_path, look, "--configfile", file)
    assert tree(tmp_path) == before


def test_what_a_finished_study_lost_comes_back(finished, stand_in):
    before = tree(finished / "results/t")
    names_of_acgd = finished / "results/t/acgd"
    shutil.rmtree(names_of_acgd)
    (finished / "results/t/no-guidance/student").write_text("results/store/student/another/0\n")
    (finished / "results/t/report.html").unlink()
    assert jobs(finished, {}) == {"publish": 1}
    assert run(finished, "--configfile", finished / "study.json")[0] == 0
    assert {file: content and content[0] for file, content in tree(finished / "results/t").items()} == {
        file: content and content[0] for file, content in before.items()
    }
    assert made(finished) == [] and jobs(finished, {}) == {}


def test_an_outdated_name_is_written_again_if_asked_for(finished):
    name = "results/t/acgd/seed-0/student"
    (finished / name).write_text("results/store/student/another/0\n")
    assert jobs(finished, {}, name) == {"name": 1}
    assert jobs(finished, {}, "results/t/acgd/seed-1/student") == {}


def test_an_interrupted_run_of_an_edited_study_leaves_the_names(finished, stand_in):
    (finished / "stop-at-evaluation").touch()
    before = tree(finished / "results/t")
    edit = {"training": {"steps": 7}}
    code, said = run(finished, "--configfile", edited(finished, **edit))
    assert code != 0 and {*made(finished)} == {"student -"} and tree(finished / "results/t") == before
    assert jobs(finished, {}) == {}
    planned = plan(load_study({**STUDY, **edit}))
    with_request = {file.parent.parent.parent.name for file in finished.glob("results/work/*/*/*/request.json")}
    assert with_request == {"student", "evaluation", "clips", "report"}
    assert not Store(finished / "results").has(planned.report.place)


def test_two_studies_of_one_name_are_noticed(finished, stand_in):
    record = next((finished / "results/work/published/t").iterdir())
    record.write_text(str(finished / "study.json"))
    assert "Two studies" not in dry_run(finished, "--configfile", finished / "study.json")[1]
    said = dry_run(finished, "--configfile", edited(finished, seeds=[7]))[1]
    assert "Two studies have the name t" in said and "study.json has published it" in said and "another `name:`" in said


def order(lines):
    """The stages in the order in which they were made."""
    return list(dict.fromkeys(line.split()[0] for line in lines))


def test_a_forced_stage_is_made_again_with_what_depends_on_it_in_order(finished, stand_in):
    said = run(finished, "--configfile", finished / "study.json", "--forcerun", "student")
    lines = made(finished)
    assert said[0] == 0 and len(lines) == 4 + 4 + 4 + 1 and all(line.endswith(" again") for line in lines)
    students = [line.split()[0] for line in lines]
    assert max(i for i, stage in enumerate(students) if stage == "report") == len(lines) - 1
    assert students.index("evaluation") > students.index("student") and order(lines)[-1] == "report"
    assert jobs(finished, {}) == {}


def test_everything_is_made_again_in_order(finished, stand_in):
    shutil.rmtree(finished / "results/work")
    assert run(finished, "--configfile", finished / "study.json", "-F")[0] == 0
    lines, planned = made(finished), plan(load_study(STUDY))
    assert len(lines) == len(planned.artifacts) and all(line.endswith(" again") for line in lines)
    stages = [line.split()[0] for line in lines]
    for artifact in planned.artifacts.values():
        for other in artifact.upstream:
            assert stages.index(other.stage.name) < len(stages) - 1 - stages[::-1].index(artifact.stage.name)
    assert jobs(finished, {}) == {} and names.outdated(Store(Path("results")), planned) != []


def test_a_forced_name_is_made_again_and_nothing_beside_it(finished):
    name = "results/t/acgd/seed-0/student"
    file = finished / "study.json"

    def forced(*arguments):
        said = dry_run(finished, *arguments, "--configfile", file)
        assert said[0] == 0, said[1]
        return dict(re.findall(r"^(\w+) +(\d+)$", said[1], re.MULTILINE))

    assert {"student": "1", "name": "1"}.items() <= forced("-f", name).items()
    assert "evaluation" not in forced("-f", name)
    assert forced(name, "-R", "codebook").items() >= {"codebook": "1", "student": "1", "name": "1"}.items()
    assert "report" not in forced(name, "-R", "codebook")


def test_a_deleted_work_folder_loses_nothing(finished, stand_in):
    shutil.rmtree(finished / "results/work")
    assert jobs(finished, {}) == {"publish": 1, "mlflow": 1}
    assert run(finished, "--configfile", finished / "study.json", "--forcerun", "evaluation")[0] == 0
    assert set(made(finished)) == {"evaluation again", "clips again", "report again"}


def test_no_trigger_makes_a_finished_study_again(finished, stand_in):
    """Snakemake records inputs of its jobs, and a finished artifact has none."""
    file = edited(finished, training={"steps": 7})
    assert run(finished, "--configfile", file)[0] == 0 and made(finished)
    said = run(finished, "--configfile", file, "--rerun-triggers", "input", "code", "params", "mtime")
    assert said[0] == 0 and made(finished) == []


@pytest.mark.parametrize(
    "name", ["my projects", "acgd (2024) [x]", "l'étude & co", 'a"b', "what? #1", "{x} $HOME", "日本"]
)
def test_a_checkout_may_be_in_a_folder_with_any_name(tmp_path, stand_in, name):
    root = tmp_path / name / "acgd"
    root.mkdir(parents=True)
    shutil.copytree(ROOT / "workflow", root / "workflow")
    (root / "acgd").symlink_to(ROOT / "acgd")
    file = edited(root)
    assert "Error" not in (said := run(root, "results/t/acgd/myo-pose/expert", "--configfile", file, root=root)[1]), (
        said
    )
    assert made(root) == ["expert -"] and (root / "results/t/acgd/myo-pose/expert").exists()


def test_a_checkout_below_a_folder_with_a_colon_is_refused(tmp_path):
    root = tmp_path / "a:b"
    shutil.copytree(ROOT / "workflow", root / "workflow")
    code, said = run(tmp_path, "-n", "--configfile", edited(tmp_path), root=root)
    assert code != 0 and "PYTHONPATH cannot hold. Rename it." in said


def test_the_database_stays_in_a_folder_with_a_question_mark(tmp_path, monkeypatch):
    results = tmp_path / "what? #1" / "results"
    results.mkdir(parents=True)
    monkeypatch.chdir(results.parent)
    assert database_uri(results) == "sqlite:///results/mlflow.db"
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RuntimeError, match="question mark.*Rename"):
        database_uri(results)
    assert database_uri(tmp_path) == f"sqlite:///{tmp_path}/mlflow.db"


def test_results_and_store_may_be_behind_links(tmp_path, stand_in):
    (tmp_path / "far" / "store").mkdir(parents=True)
    (tmp_path / "disk").mkdir()
    (tmp_path / "far/store").rmdir()
    (tmp_path / "far/store").symlink_to(tmp_path / "disk")
    here = tmp_path / "here"
    here.mkdir()
    (here / "results").symlink_to(tmp_path / "far")
    file = edited(here)
    assert run(here, "results/t/acgd/seed-0/codebook", "--configfile", file)[0] == 0
    assert "codebook -" in made(here) and list((tmp_path / "disk/codebook").glob("*/*/manifest.json"))
    assert jobs(here, {}, "results/t/acgd/seed-0/codebook") == {}
