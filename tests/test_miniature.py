"""The whole chain on two real tasks, through Snakemake: killed with -9, gone on with, and run again."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from workflow_runs import ROOT, STUDY, snakemake, workflow

from acgd.experts import zoo
from acgd.rollouts.store import read_group
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
    "dagger/seed-0/round-1/student",
)

STOPPED = """
import os, signal, sys
from acgd import chain
from acgd.__main__ import main
from acgd.settings import imported
from torch.optim.optimizer import register_optimizer_step_post_hook

kills, artifact, job = sys.argv[1], sys.argv[2], sys.argv[3:]
imported(chain.stage(job[0]).function)

def stopped_after(left):
    def count(*_):
        nonlocal left
        left -= 1
        if left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
    register_optimizer_step_post_hook(count)
    sys.exit(main(job))

for steps in map(int, kills.split(",")):
    child = os.fork()
    if child == 0:
        stopped_after(steps)
    status = os.waitpid(child, 0)[1]
    assert os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL, (steps, status)
    assert not os.path.exists(artifact)
sys.exit(main(job))
"""
"""A job that is killed after so many optimiser steps, once for each of several numbers, and then comes to its end. Each
attempt is a process of its own; that they are forked saves importing torch each time."""

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
    """A copy of the finished study that lacks some artifacts. `and_what_follows`: and all that is made from them."""

    def copy(*lost, and_what_follows=True):
        shutil.copytree(uninterrupted / "results", tmp_path / "results", ignore=shutil.ignore_patterns("work"))
        store = Store(tmp_path / "results")
        gone = set(lost)
        for place, artifact in planned.artifacts.items():
            if artifact in gone or (and_what_follows and gone & set(artifact.upstream)):
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
    """In steps 1-4, before the first checkpoint; in 6-9, after it (in step 5 it is yet to be written); and once more
    after a resumption."""
    artifact = planned.names[name][0]
    folder = without(artifact)
    write_requests(Store(folder / "results"), {place: one.job for place, one in planned.artifacts.items()})
    store = Store(Path("results"))
    job = [artifact.stage.name, str(request_file(store, artifact.place)), "--device", "cpu"]
    kills = ",".join(map(str, (random.randint(1, 4), random.randint(6, 9), random.randint(5, 7))))
    run = subprocess.run(
        [sys.executable, "-c", STOPPED, kills, str(store.path(artifact.place)), *job],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0 and run.stderr.count("going on from its checkpoint") >= 2, (kills, run.stderr[-3000:])
    assert manifest(folder, artifact.place) == manifest(uninterrupted, artifact.place)


def test_an_on_policy_round_counts_exactly_what_it_stores(uninterrupted, planned):
    """An expert query is a visited state: its label is stored, and where the expert acted its action is that label."""
    artifacts = planned.names["dagger/onpolicy"]
    assert len(artifacts) == 2 * 2, "two rounds of two tasks"
    for artifact in artifacts:
        folder = Store(uninterrupted / "results").path(artifact.place)
        summary = json.loads((folder / "summary.json").read_text())
        names = ["reward", "mean_action", "action", "by_expert", "success_final"]
        arrays = read_group(folder / "rollouts.zarr", [*names, "episode_ends"])
        by_expert = arrays["by_expert"]
        assert summary["episodes"] == len(arrays["episode_ends"]) == artifact.request.rounds.episodes
        assert summary["environment_steps"] == len(arrays["reward"]) == arrays["episode_ends"][-1]
        assert summary["expert_queries"] == len(arrays["mean_action"]) == summary["environment_steps"]
        assert summary["steps_by_expert"] == by_expert.sum()
        assert np.array_equal(arrays["action"][by_expert], arrays["mean_action"][by_expert])
        assert summary["failures"] == (~arrays["success_final"]).sum()


@pytest.mark.parametrize("whole", [True, False], ids=["with its jobs", "alone, while its jobs live on"])
def test_a_workflow_killed_in_the_middle_goes_on(whole, uninterrupted, without, planned):
    """Killed alone, Snakemake leaves jobs that go on. The next workflow waits for them, or finds what they made.

    What is lost is one variant's way from the backbone to the report. The rest of the study would repeat the same jobs.
    """
    stages = ("backbone", "features", "codebook", "student", "evaluation", "clips")
    lost = [artifact for stage in stages for artifact in planned.names[f"no-guidance/{stage}"]]
    folder = without(*lost, planned.report, and_what_follows=False)
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
