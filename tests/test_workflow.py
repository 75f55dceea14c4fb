"""The workflow under Snakemake: the jobs that an edit reruns, in dry runs."""

import contextlib
import io
import json
import os
import re
from pathlib import Path

import pytest
from snakemake.cli import main

from acgd.store.store import Store
from acgd.study import names
from acgd.study.load import merge
from acgd.study.plan import plan
from acgd.study.study import load_study

ROOT = Path(__file__).parents[1]
STUDY = {
    "name": "t",
    "tasks": ["myo/reach", "myo/pose"],
    "seeds": [0, 1],
    "expert": {"kind": "ppo"},
    "variants": {"acgd": {"guidance": {"kind": "critic"}}, "no-guidance": {"guidance": {"kind": "none"}}},
}
PUBLISHING = {"publish": 1, "mlflow": 1}


def dry_run(folder, *arguments):
    """Exit code and text of `snakemake -n`."""
    return run(folder, "-n", *arguments)


def run(folder, *arguments, root=ROOT):
    """Exit code and text of snakemake, in this process: starting one costs seconds."""
    before, said = Path.cwd(), io.StringIO()
    base = ["--snakefile", str(root / "workflow/Snakefile"), "--directory", str(folder), "--cores", "1"]
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            main([*base, *map(str, arguments)])
    except SystemExit as end:
        return end.code, said.getvalue()
    finally:
        os.chdir(before)
    raise AssertionError("snakemake ends with an exit code")


def jobs(folder, edit, *targets):
    """Rule -> number of its jobs in a dry run of the study with that edit."""
    file = folder / "study.json"
    file.write_text(json.dumps(merge(STUDY, edit)))
    code, said = dry_run(folder, *targets, "--configfile", file)
    assert code == 0, said
    table = re.search(r"job +count\n[- ]+\n(.*?)\ntotal", said, re.DOTALL)
    rows = dict(line.split() for line in table[1].splitlines()) if table else {}
    return {rule: int(count) for rule, count in rows.items() if rule != "all"}


def published(folder, content):
    """A store in which every artifact of the study is there, as far as the workflow can see."""
    store, planned = Store(folder / "results"), plan(load_study(content))

    def fill(space):
        (space.payload / "report.html").write_text("page")
        return {}

    for place, artifact in planned.artifacts.items():
        store.make(place, {"request": {}, "inputs": artifact.input_keys}, fill)
    with_relative_paths = Store(Path("results"))
    before = Path.cwd()
    os.chdir(folder)
    try:
        names.publish(with_relative_paths, planned)
        names.mark(with_relative_paths, "mirrored", planned.study, names.fingerprint(planned))
    finally:
        os.chdir(before)
    return store, planned


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    published(folder, STUDY)
    return folder


def test_a_fresh_study_makes_each_artifact_once(tmp_path):
    per_task = dict(expert=2, card=2, critic=2, quality=2, rollouts=2, features=2)
    of_students = dict(codebook=2, student=4, evaluation=4, clips=4)
    assert jobs(tmp_path, {}) == {**per_task, **of_students, "backbone": 1, "controls": 1, "report": 1, **PUBLISHING}


def test_a_finished_study_does_nothing(finished):
    assert jobs(finished, {}) == {}


@pytest.mark.parametrize(
    "edit, expected",
    [
        ({"training": {"learning_rate": 3e-4}}, dict(student=4, evaluation=4, clips=4, report=1)),
        ({"variants": {"gated": {"guidance": {"gate": "reliable"}}}}, dict(student=2, evaluation=2, clips=2, report=1)),
        (
            {"overrides": {"myo/pose": {"critic": {"width": 64}}}},
            dict(critic=1, quality=1, student=2, evaluation=2, clips=2, report=1),
        ),
        ({"report": {"clips": False}}, dict(report=1)),
    ],
    ids=str,
)
def test_an_edit_reruns_exactly_these_jobs_and_its_reversal_none(finished, edit, expected):
    assert jobs(finished, edit) == {**expected, **PUBLISHING}


def test_cadence_and_device_rerun_nothing(finished):
    assert jobs(finished, {"device": "cpu", "critic": {"checkpoint_every": 7}}) == {}


def test_one_artifact_can_be_asked_for_by_name(tmp_path):
    expected = dict(expert=2, rollouts=2, backbone=1, features=2, codebook=1, student=1, name=1)
    assert jobs(tmp_path, {}, "results/t/no-guidance/seed-1/student") == expected
    assert jobs(tmp_path, {}, "results/t/acgd/myo-pose/expert") == dict(expert=1, name=1)


def test_a_lost_artifact_is_made_again_and_no_other(tmp_path):
    store, planned = published(tmp_path, STUDY)
    lost = planned.names["acgd/seed-0/codebook"][0]
    store.remove(lost.place)
    assert jobs(tmp_path, {}, "results/t/acgd/seed-0/student") == {}
    assert jobs(tmp_path, {}, "results/t/acgd/seed-0/codebook") == dict(codebook=1, name=1)
    assert jobs(tmp_path, {}) == dict(codebook=1)


def test_neither_newer_manifests_nor_lost_metadata_rerun_anything(tmp_path):
    store, planned = published(tmp_path, STUDY)
    manifest = store.path(planned.names["acgd/myo-pose/expert"][0].place) / "manifest.json"
    manifest.write_text(manifest.read_text() + " ")
    os.utime(manifest, (4e9, 4e9))
    assert jobs(tmp_path, {}) == {}


def test_a_faulty_configuration_stops_everything_without_a_trace(tmp_path):
    (tmp_path / "study.json").write_text(json.dumps({**STUDY, "studnet": {}}))
    code, said = dry_run(tmp_path, "--configfile", tmp_path / "study.json")
    assert code != 0 and "studnet: unknown key. Nearest: student." in said and "Traceback" not in said


def test_a_study_takes_the_place_of_the_default_and_the_command_line_changes_it(tmp_path):
    """Without --configfile config.yaml counts; with it, it counts for nothing."""
    (tmp_path / "config.yaml").write_text(json.dumps(STUDY))
    assert "results/t/acgd/seed-5/student" in dry_run(tmp_path, "--config", "seeds=[5]")[1]
    (tmp_path / "study.json").write_text(json.dumps({"name": "u", "tasks": ["myo/reach"], "expert": {"kind": "ppo"}}))
    said = dry_run(tmp_path, "--configfile", tmp_path / "study.json")[1]
    assert "results/u/base/seed-0/student" in said and "results/t/" not in said and "results/u/acgd/" not in said


def test_the_text_of_the_file_counts_and_not_what_snakemake_reads(tmp_path):
    """Snakemake takes `off` for false and the last of two equal keys."""
    file = tmp_path / "study.yaml"
    file.write_text("tasks: [myo/reach]\nexpert: {kind: ppo}\nname: off\nimitation: {goal: off}\n")
    code, said = dry_run(tmp_path, "--configfile", file)
    assert code == 0 and "results/off/base/seed-0/student" in said
    file.write_text(file.read_text() + "name: u\n")
    code, said = dry_run(tmp_path, "--configfile", file)
    assert code != 0 and "study.yaml, line 5: name is there twice, first in line 3" in said and "Traceback" not in said
