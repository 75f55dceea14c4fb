"""The store: an artifact is whole or not there, whatever happens while it is made."""

import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from acgd import chain
from acgd.store import job
from acgd.store.atomic import replace_text
from acgd.store.store import ArtifactError, Store, check, damages
from acgd.study import commands, names
from acgd.study.load import ConfigError
from acgd.study.plan import identity, plan
from acgd.study.study import load_study

ROOT = Path(__file__).parents[1]
PLACE = "critic/myo-reach/0123456789abcdef"
IDENTITY = {"version": 1, "request": {"b": 1, "a": 2}, "inputs": {}, "files": {}}
RUN = {"wall_s": 1.0}

MAKER = """
import sys, time, os, signal
from pathlib import Path
from acgd.store.store import Store
place, results, mode = sys.argv[1:]
def fill(space):
    print("filling", flush=True)
    (space.payload / "a.bin").write_bytes(b"a" * 100)
    if mode == "slow":
        while not Path(results, "go").exists():
            time.sleep(0.01)
    if mode == "killed in the stage":
        (space.state / "step").write_text("7")
        os.kill(os.getpid(), signal.SIGKILL)
    return {}
if mode == "killed before the manifest":
    Store._declare = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
if mode == "killed before the rename":
    os.rename = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
made = Store(Path(results)).make(place, {"version": 1}, fill)
print("made" if made else "found", flush=True)
"""


def maker(results, mode, **more):
    command = [sys.executable, "-c", MAKER, PLACE, str(results), mode]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **more)


def fill_with(**files):
    def fill(space):
        for name, content in files.items():
            file = space.payload / name.replace("__", "/")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
        return RUN

    return fill


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "results")


@pytest.fixture
def made(store):
    store.make(PLACE, IDENTITY, fill_with(weights=b"w" * 10, data__chunk=b"c"))
    return store.path(PLACE)


def make(described, store):
    job.make(described, chain.stage(described["stage"]), identity, store, threads=1, device="cpu")


def contents(folder):
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_an_artifact_holds_payload_manifest_and_run(store, made):
    manifest = store.manifest(PLACE)
    assert set(manifest["payload"]) == {"weights", "data/chunk"} and manifest["payload"]["weights"]["bytes"] == 10
    assert (manifest["stage"], manifest["name"], manifest["key"]) == tuple(PLACE.split("/"))
    assert json.loads((made / "run.json").read_text()) == RUN
    check(made)


def test_a_manifest_is_the_same_bytes_when_the_artifact_is_made_again(store, made):
    before = contents(made)
    store.remove(PLACE)
    assert not made.exists()
    store.make(PLACE, dict(reversed(IDENTITY.items())), fill_with(data__chunk=b"c", weights=b"w" * 10))
    assert contents(made) == before


def test_an_existing_artifact_is_not_made_again(store, made):
    def fill(space):
        raise AssertionError("made again")

    assert store.make(PLACE, IDENTITY, fill) is False


def test_a_stage_that_fails_publishes_nothing_and_keeps_its_checkpoints(store):
    def fails(space):
        (space.payload / "half").write_bytes(b"h")
        (space.state / "step").write_text("7")
        space.metrics.write_text('{"step": 7}\n')
        raise RuntimeError("stage")

    with pytest.raises(RuntimeError, match="stage"):
        store.make(PLACE, IDENTITY, fails)
    assert not store.path(PLACE).exists()

    def goes_on(space):
        assert (space.state / "step").read_text() == "7" and space.metrics.exists() and not any(space.payload.iterdir())
        (space.payload / "whole").write_bytes(b"w")
        return RUN

    store.make(PLACE, IDENTITY, goes_on)
    assert set(store.manifest(PLACE)["payload"]) == {"whole", "metrics.jsonl"}
    assert not (store.work(PLACE) / "state").exists()


def test_metrics_without_a_checkpoint_are_discarded(store):
    def fails(space):
        space.metrics.write_text('{"step": 1}\n')
        raise RuntimeError

    with pytest.raises(RuntimeError):
        store.make(PLACE, IDENTITY, fails)
    store.make(PLACE, IDENTITY, fill_with(a=b"a"))
    assert set(store.manifest(PLACE)["payload"]) == {"a"}


def test_a_stage_that_writes_nothing_is_refused(store):
    with pytest.raises(ArtifactError, match="wrote nothing"):
        store.make(PLACE, IDENTITY, lambda space: RUN)
    assert not store.has(PLACE)


@pytest.mark.parametrize("mode", ["killed in the stage", "killed before the rename", "killed before the manifest"])
def test_after_a_kill_there_is_no_artifact_and_the_next_maker_resumes(store, mode):
    process = maker(store.results, mode)
    process.communicate(timeout=60)
    assert process.returncode == -signal.SIGKILL
    assert not store.has(PLACE) and store.places() == []
    with pytest.raises(ArtifactError, match="no such artifact"):
        check(store.path(PLACE))
    process = maker(store.results, "fast")
    out, _ = process.communicate(timeout=60)
    assert out.split()[-1] == "made"
    assert ("filling" in out) == (mode != "killed before the manifest"), (
        "hours of work are not thrown away for a missing manifest"
    )
    check(store.path(PLACE))


def test_a_lost_manifest_is_written_again_only_for_an_intact_payload(store, made):
    before = (made / "manifest.json").read_bytes()
    (made / "manifest.json").unlink()
    store.make(PLACE, IDENTITY, fill_with(other=b"o"))
    assert (made / "manifest.json").read_bytes() == before
    (made / "manifest.json").unlink()
    (made / "weights").write_bytes(b"x" * 10)
    store.make(PLACE, IDENTITY, fill_with(weights=b"w" * 10, data__chunk=b"c"))
    assert (made / "manifest.json").read_bytes() == before and (made / "weights").read_bytes() == b"w" * 10


@pytest.mark.parametrize("wrapped", [False, True])
def test_a_full_disk_is_named_and_loses_nothing(store, made, wrapped):
    def full(space):
        (space.state / "step").write_text("7")
        try:
            raise OSError(errno.ENOSPC, "No space left on device")
        except OSError as error:
            raise (ValueError("codec") if wrapped else error) from error

    other = PLACE.replace("0", "f")
    with pytest.raises(ArtifactError, match=r"disk of .* is full .* acgd gc"):
        store.make(other, IDENTITY, full)
    assert not store.has(other) and (store.work(other) / "state" / "step").exists()
    check(made)


def damage_missing(path):
    (path / "data/chunk").unlink()


def damage_bytes(path):
    (path / "weights").write_bytes(b"x" * 10)


def damage_length(path):
    (path / "weights").write_bytes(b"x")


def damage_extra(path):
    (path / "stray").touch()


def damage_manifest(path):
    (path / "manifest.json").write_text("{")


DAMAGES = [
    (damage_missing, "data/chunk is missing"),
    (damage_bytes, "weights has other content"),
    (damage_length, "weights has 1 bytes instead of 10"),
    (damage_extra, "stray does not belong"),
    (damage_manifest, "manifest.json is damaged"),
]


@pytest.mark.parametrize("damage, said", DAMAGES)
def test_verify_finds_damage_and_repair_removes_it(store, made, capsys, damage, said):
    store.make(PLACE.replace("0", "f"), IDENTITY, fill_with(a=b"a"))
    commands.verify(store, repair=False)
    damage(made)
    with pytest.raises(ArtifactError, match="--repair"):
        commands.verify(store, repair=False)
    assert said in capsys.readouterr().out and made.exists()
    commands.verify(store, repair=True)
    assert not made.exists() and store.places() == [PLACE.replace("0", "f")]


@pytest.mark.parametrize("damage, said", [entry for entry in DAMAGES if entry[0] is not damage_bytes])
def test_a_damaged_artifact_is_not_read(store, made, damage, said):
    damage(made)
    with pytest.raises(ArtifactError, match="verify --repair") as caught:
        check(made)
    assert said in str(caught.value)


@pytest.fixture
def study(tmp_path, monkeypatch):
    """A plan of one task, in a folder with its configuration, with everything published."""
    monkeypatch.chdir(tmp_path)
    content = {"name": "t", "tasks": ["myo/reach"], "seeds": [0], "expert": {"kind": "ppo"}}
    Path("config.yaml").write_text(json.dumps(content))
    return plan(load_study(content))


def publish_all(store, plan):
    for place in plan.artifacts:
        store.make(place, IDENTITY, fill_with(**{"report.html": b"page"}))


def test_gc_frees_what_no_study_names(store, study, made, capsys):
    publish_all(store, study)
    commands.free(store, [], yes=False)
    assert made.exists() and f"would remove {PLACE}" in capsys.readouterr().out
    commands.free(store, [], yes=True)
    assert not made.exists() and store.places() == sorted(study.artifacts)
    assert not store.work(PLACE).exists()


def test_gc_frees_nothing_where_a_study_cannot_be_read(store, study, made):
    Path("config.yaml").write_text("nam: t")
    with pytest.raises(ConfigError, match="config.yaml, line 1: nam: unknown key"):
        commands.free(store, [], yes=True)
    assert made.exists()


def test_ls_names_stage_size_and_studies(store, study, made, capsys):
    publish_all(store, study)
    commands.list_store(store, [])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + 1 + len(study.artifacts) + 1
    assert [line.split()[-1] for line in lines if line.startswith("student ")] == ["t"]
    assert [line.split()[-1] for line in lines if "0123456789abcdef" in line] == ["-"]


def test_names_are_written_where_they_are_outdated_and_those_of_before_removed(store, study):
    publish_all(store, study)
    assert set(names.outdated(store, study)) == set(names.all_names(study))
    page = names.publish(store, study)
    student = page.parent / "base/student"
    assert page.read_text() == "page" and student.read_text() == f"{store.path(study.names['base/student'][0].place)}\n"
    assert names.outdated(store, study) == []
    student.unlink()
    (page.parent / "base/codebook").write_text("results/store/codebook/of/another\n")
    replace_text(page.parent / "other/student", student.parent.joinpath("expert").read_text())
    (page.parent / "notes").write_text("mine\n")
    assert set(names.outdated(store, study)) == {"base/codebook", "base/student"}
    names.publish(store, study)
    assert names.outdated(store, study) == [] and not (page.parent / "other/student").exists()
    assert (page.parent / "notes").exists()


def test_a_second_configuration_of_one_name_is_noticed(store, study):
    publish_all(store, study)
    first, second = Path("config.yaml").resolve(), Path("second.yaml").resolve()
    second.write_text(first.read_text())
    names.publish(store, study, str(first))
    assert names.other_source(store, "t", first) is None and names.other_source(store, "t", second) == first
    with pytest.raises(ConfigError, match="2 studies have the name t.*Give each its own"):
        commands.check(store, [first, second])
    first.write_text(first.read_text().replace('"t"', '"u"'))
    assert names.other_source(store, "t", second) is None


def test_an_artifact_is_made_again_only_if_asked(store):
    store.make(PLACE, IDENTITY, fill_with(a=b"1"))
    manifest = store.path(PLACE) / "manifest.json"
    for again, content in ((False, b"1"), (True, b"2")):
        assert not store.make(PLACE, IDENTITY, fill_with(a=b"2"), again)  # it is there
        manifest.unlink()  # Snakemake, before a job whose output is forced
        assert store.make(PLACE, IDENTITY, fill_with(a=b"2"), again)
        assert (store.path(PLACE) / "a").read_bytes() == content and not damages(
            store.path(PLACE), store.manifest(PLACE)["payload"]
        )


def test_the_store_may_be_on_another_disk(store, monkeypatch):
    rename = os.rename

    def across(source, target):
        if Path(source).parent != Path(target).parent:
            raise OSError(errno.EXDEV, "Invalid cross-device link")
        rename(source, target)

    monkeypatch.setattr(os, "rename", across)
    (store.path(PLACE).parent / f"{store.path(PLACE).name}.draft").mkdir(parents=True)  # of a kill
    assert store.make(PLACE, IDENTITY, fill_with(a=b"1"))
    assert [entry.name for entry in store.path(PLACE).parent.iterdir()] == [store.path(PLACE).name]
    assert not damages(store.path(PLACE), store.manifest(PLACE)["payload"])


def test_a_job_refuses_a_request_that_its_key_does_not_belong_to(store, study):
    described = json.loads(study.names["base/myo-reach/expert"][0].job)
    described["request"]["expert"]["seed"] = 5
    with pytest.raises(ArtifactError, match="has changed since the workflow was started"):
        make(described, store)


def test_experts_and_critics_from_the_zoo_are_made_and_depend_on_its_files(store, monkeypatch):
    """The process that makes them computes the key of the plan. So does a training that starts from a zoo expert."""
    monkeypatch.setattr(
        "acgd.experts.train.train", lambda request, inputs, ctx: (ctx.out / "weights").write_bytes(b"w")
    )
    monkeypatch.setattr("acgd.critics.fit.fit", lambda request, inputs, ctx: (ctx.out / "weights").write_bytes(b"w"))
    zoos = plan(load_study({"tasks": ["myo/reach"], "critic": {"kind": "zoo"}}))
    warm = plan(
        load_study(
            {
                "tasks": ["myo/pen-twirl-hard"],
                "expert": {"kind": "sac", "warm_start": "myo/pen-twirl"},
            }
        )
    )
    made = [zoos.names["base/expert"][0], zoos.names["base/critic"][0], warm.names["base/expert"][0]]
    for artifact in made:
        make(json.loads(artifact.job), store)
        check(store.path(artifact.place))
    monkeypatch.setattr("acgd.experts.zoo.fitted_critic", lambda task: (ROOT / "Makefile",))
    assert (
        plan(load_study({"tasks": ["myo/reach"], "critic": {"kind": "zoo"}})).names["base/critic"][0].key != made[1].key
    )


def test_a_job_refuses_damaged_inputs_before_it_starts(store, study):
    expert, critic = study.names["base/expert"][0], study.names["base/critic"][0]
    with pytest.raises(ArtifactError, match="no such artifact"):
        make(json.loads(critic.job), store)
    store.make(expert.place, IDENTITY, fill_with(weights=b"w"))
    (store.path(expert.place) / "weights").unlink()
    with pytest.raises(ArtifactError, match="weights is missing"):
        make(json.loads(critic.job), store)


def acgd(*arguments, cwd):
    command = [sys.executable, "-m", "acgd", *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)})


def test_the_command_line_says_what_to_mend_and_fails_without_a_trace(tmp_path):
    (tmp_path / "config.yaml").write_text("studnet: {}")
    run = acgd("check", cwd=tmp_path)
    assert (
        run.returncode == 1
        and run.stderr
        == "error: config.yaml, line 1: studnet: unknown key. Nearest: student. Rename it, or remove it.\n"
    )
    run = acgd("critic", "config.yaml", cwd=tmp_path)
    assert run.returncode == 1 and "config.yaml is no request" in run.stderr and "Traceback" not in run.stderr


def test_check_lists_what_is_to_make(study, tmp_path):
    run = acgd("check", cwd=tmp_path)
    assert (
        run.returncode == 0
        and f"t: valid; {len(study.artifacts)} artifacts, {len(study.artifacts)} of them to make" in run.stdout
    )
