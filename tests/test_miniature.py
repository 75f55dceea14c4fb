"""The whole chain on two real tasks, through Snakemake: killed with -9, gone on with, and run again."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from workflow_runs import ROOT, STUDY, snakemake, workflow

from acgd.experts import zoo
from acgd.store.job import request_file, write_requests
from acgd.store.store import Store, check
from acgd.study.load import read_yaml
from acgd.study.plan import plan
from acgd.study.study import load_study

TRAINED = (
    "acgd/myo-reach/critic",
    "acgd/backbone",
    "acgd/seed-0/codebook",
    "acgd/seed-0/student",
    "no-guidance/seed-0/student",
)

STOPPED = """
import os, signal, sys
from torch.optim.optimizer import register_optimizer_step_post_hook

left = int(sys.argv[1])

def count(*_):
    global left
    left -= 1
    if left == 0:
        os.kill(os.getpid(), signal.SIGKILL)

register_optimizer_step_post_hook(count)
from acgd.__main__ import main
sys.exit(main(sys.argv[2:]))
"""
"""A job that kills itself after so many optimiser steps."""

lacking = [task for task in read_yaml(STUDY)["tasks"] if zoo.missing(task)]
pytestmark = pytest.mark.skipif(bool(lacking), reason=f"zoo/ has no expert for {', '.join(lacking)}")


def manifest(folder, place):
    """With it, the checksum of every file."""
    return Store(folder / "results").manifest(place)


def manifests(folder, planned):
    """Of every artifact but the report, which tells wall times."""
    return {place: manifest(folder, place) for place in planned.artifacts if not place.startswith("report/")}


@pytest.fixture(scope="module")
def planned():
    return plan(load_study(read_yaml(STUDY)))


@pytest.fixture(scope="session")
def uninterrupted(finished_miniature):
    return finished_miniature


@pytest.fixture
def without(uninterrupted, tmp_path, planned):
    """A copy of the finished study that lacks some artifacts and all that follows from them."""

    def copy(*lost):
        shutil.copytree(uninterrupted / "results", tmp_path / "results", ignore=shutil.ignore_patterns("work"))
        store = Store(tmp_path / "results")
        gone = set(lost)
        for place, artifact in planned.artifacts.items():
            if artifact in gone or gone & set(artifact.upstream):
                gone.add(artifact)
                store.remove(place)
        return tmp_path

    return copy


def test_every_artifact_is_whole_and_the_results_have_their_names(uninterrupted, planned):
    store = Store(uninterrupted / "results")
    for place in planned.artifacts:
        check(store.path(place))
    folder = uninterrupted / "results/miniature"
    for name in ("report.html", "success.csv", *planned.names):
        assert (folder / name).stat().st_size > 0, name
    student = uninterrupted / (folder / "acgd/seed-0/student").read_text().strip()
    assert (student / "best.safetensors").is_file() and (student / "metrics.jsonl").is_file()


def test_a_second_run_does_nothing(uninterrupted, planned):
    before = manifests(uninterrupted, planned)
    assert "Nothing to be done" in workflow(uninterrupted, "all")
    assert manifests(uninterrupted, planned) == before


def test_an_artifact_that_is_lost_is_made_again_to_the_same_bytes_and_nothing_follows(uninterrupted, planned, tmp_path):
    shutil.copytree(uninterrupted / "results", tmp_path / "results")
    lost = planned.names["acgd/seed-0/codebook"][0]
    Store(tmp_path / "results").remove(lost.place)
    said = workflow(tmp_path, "all")
    assert said.count("started\n") == 1 and f"{lost.place}: started" in said
    assert manifests(tmp_path, planned) == manifests(uninterrupted, planned)


@pytest.mark.parametrize("name", TRAINED)
def test_killed_at_three_random_steps_training_ends_in_the_same_bytes(name, uninterrupted, without, planned):
    """Kills in steps 1-4, before the first checkpoint; in 6-9, after it; and around the second checkpoint.

    The first checkpoint is written in step 5.
    """
    artifact = planned.names[name][0]
    folder = without(artifact)
    write_requests(Store(folder / "results"), {place: one.job for place, one in planned.artifacts.items()})
    job = [artifact.stage.name, str(request_file(Store(Path("results")), artifact.place)), "--device", "cpu"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    for steps in (random.randint(1, 4), random.randint(6, 9), random.randint(5, 7)):
        run = subprocess.run(
            [sys.executable, "-c", STOPPED, str(steps), *job],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
        )
        assert run.returncode == -signal.SIGKILL, run.stderr[-3000:]
        assert not Store(folder / "results").has(artifact.place)
    run = subprocess.run(
        [sys.executable, "-m", "acgd", *job], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert run.returncode == 0 and "going on from its checkpoint" in run.stderr, run.stderr[-3000:]
    assert manifest(folder, artifact.place) == manifest(uninterrupted, artifact.place)


@pytest.mark.parametrize("whole", [True, False], ids=["with its jobs", "alone, while its jobs live on"])
def test_a_workflow_killed_in_the_middle_goes_on(whole, uninterrupted, without, planned):
    """If only Snakemake is killed, its jobs continue. The next workflow waits for them or reads their artifacts."""
    folder = without(planned.names["acgd/backbone"][0], planned.names["acgd/seed-0/codebook"][0])
    running = subprocess.Popen(
        [*snakemake(), "all"], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    while not list((folder / "results/work").glob("codebook/*/*/lock")):
        assert running.poll() is None, "the workflow ended before it was killed"
        time.sleep(0.01)
    if whole:
        os.killpg(running.pid, signal.SIGKILL)
    else:
        running.kill()
    running.wait()
    workflow(folder, "--unlock")
    workflow(folder, "all")
    assert manifests(folder, planned) == manifests(uninterrupted, planned)
    assert "Nothing to be done" in workflow(folder, "all")
