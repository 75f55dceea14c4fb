"""Metrics survive kills and rewinds byte for byte. A log shows progress. The MLflow mirror never fails a job."""

import io
import json
import logging
import math
import re
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from acgd.store.metrics import Metrics, read
from acgd.store.progress import Progress
from acgd.tracking.mlflow_mirror import Mirrored, database_uri, sync


def test_metrics_come_back_as_they_were_logged(tmp_path: Path) -> None:
    with Metrics(tmp_path / "metrics.jsonl") as metrics:
        metrics.log(0, loss=0.1, **{"grad/myo-pose": 1 / 3})
        metrics.log(20, loss=1e-30)
    assert read(tmp_path / "metrics.jsonl") == [
        {"step": 0, "loss": 0.1, "grad/myo-pose": 1 / 3},
        {"step": 20, "loss": 1e-30},
    ]


def test_metrics_are_on_the_disk_after_a_flush_and_not_after_each_row(tmp_path: Path) -> None:
    metrics = Metrics(tmp_path / "metrics.jsonl")
    metrics.log(0, loss=1.0)
    assert read(metrics.path) == []
    metrics.flush()
    assert len(read(metrics.path)) == 1


def test_a_diverged_loss_is_kept_and_the_file_stays_json(tmp_path: Path) -> None:
    with Metrics(tmp_path / "metrics.jsonl") as metrics:
        metrics.log(0, loss=math.nan, best=math.inf, worst=-math.inf)
    json.loads((tmp_path / "metrics.jsonl").read_text(), parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    row = read(tmp_path / "metrics.jsonl")[0]
    assert math.isnan(row["loss"]) and row["best"] == math.inf and row["worst"] == -math.inf


def test_a_resumed_curve_has_the_bytes_of_an_uninterrupted_one(tmp_path: Path) -> None:
    def log(metrics: Metrics, steps: range) -> None:
        for step in steps:
            metrics.log(step, loss=math.sin(step))

    with Metrics(tmp_path / "whole.jsonl") as whole:
        log(whole, range(50))

    with Metrics(tmp_path / "killed.jsonl") as killed:
        log(killed, range(33))
    with open(tmp_path / "killed.jsonl", "a") as file:
        file.write('{"step": 33, "lo')  # the kill came in the middle of a write
    resumed = Metrics(tmp_path / "killed.jsonl")
    resumed.rewind(19)
    log(resumed, range(20, 50))
    resumed.flush()
    assert (tmp_path / "killed.jsonl").read_bytes() == (tmp_path / "whole.jsonl").read_bytes()


def test_rewinding_a_curve_that_was_never_written_is_fine(tmp_path: Path) -> None:
    Metrics(tmp_path / "metrics.jsonl").rewind(100)
    assert read(tmp_path / "metrics.jsonl") == []


def test_a_log_gets_lines_with_share_rate_time_left_and_figures() -> None:
    stream = io.StringIO()
    with Progress(stream, line_every_s=0.02)(100, "fitting {x}") as bar:
        for _ in range(50):
            time.sleep(0.002)
            bar.update(1, loss=0.25)
    lines = stream.getvalue().splitlines()
    assert lines[0] == "fitting {x}: 100 to do"
    assert 3 <= len(lines) < 10
    for line in lines[1:-1]:
        assert re.fullmatch(r"fitting \{x\}: (\d+)% \(\1/100\), [\d.]+/s, 00:00 left, loss 0.25", line), line
    assert lines[-1] == "fitting {x}: done, 50/100 in 00:00, loss 0.25"
    assert "\r" not in stream.getvalue()


def test_a_long_stage_does_not_flood_its_log(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr("tqdm.std.time", lambda: now)
    stream = io.StringIO()
    with Progress(stream)(36_000, "training") as bar:
        for _ in range(36_000):
            now += 1.0
            bar.update()
    lines = stream.getvalue().splitlines()
    assert 10 < len(lines) < 120  # ten hours
    assert lines[1] == "training: 0% (10/36000), 1.00/s, 9:59:50 left"
    assert lines[-1] == "training: done, 36000/36000 in 10:00:00"


def test_units_of_an_earlier_run_count_for_the_share_and_not_for_the_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr("tqdm.std.time", lambda: now)
    stream = io.StringIO()
    with Progress(stream)(100, "training", done=80) as bar:
        now += 10
        bar.update(10)
    assert stream.getvalue().splitlines() == [
        "training: 100 to do, going on from 80",
        "training: 90% (90/100), 1.00/s, 00:10 left",
        "training: done, 90/100 in 00:10",
    ]


def test_a_total_of_zero_and_more_updates_than_the_total_are_allowed() -> None:
    stream = io.StringIO()
    with Progress(stream)(0, "collecting"):
        pass
    with Progress(stream, line_every_s=0.0)(2, "collecting") as bar:
        bar.update(5)
    assert "done, 0/0" in stream.getvalue() and "done, 5/2" in stream.getvalue()


def test_an_error_is_logged_and_raised() -> None:
    stream = io.StringIO()
    with pytest.raises(ValueError, match="boom"), Progress(stream)(10, "collecting") as bar:
        bar.update(3)
        raise ValueError("boom")
    assert "collecting: stopped at 3/10 by ValueError" in stream.getvalue()


def test_a_terminal_gets_a_bar() -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Terminal()
    with Progress(stream)(4, "collecting") as bar:
        bar.update(4, reward=1.5)
    assert "collecting: 100%" in stream.getvalue() and "\r" in stream.getvalue()


# MLflow. Importing it costs seconds, so the whole life of one database is one test.

MakeArtifact = Callable[..., Mirrored]


@pytest.fixture
def artifact(tmp_path: Path) -> MakeArtifact:
    """Writes a published artifact into the store of tmp_path."""

    def make(stage: str, key: str, *names: str, inputs: dict | None = None, rows: int = 30) -> Mirrored:
        path = tmp_path / "store" / stage / "toy" / key
        path.mkdir(parents=True)
        with Metrics(path / "metrics.jsonl") as metrics:
            for i in range(rows):
                metrics.log(10 * i, **{"loss": 1 / (i + 1), "grad ratio (key)": 0.5})
        (path / "health.json").write_text(json.dumps({"perplexity": [1.0, 2.0], "code": {"error": 0.125}}))
        (path / "curve.svg").write_text("<svg xmlns='http://www.w3.org/2000/svg'/>")
        (path / "run.json").write_text(json.dumps({"started": 1_000.0, "wall_s": 2.5}))
        request = {"student": {"width": 64, "name": "x" * 9000}, "tasks": [{"name": "myo/pose"}, {"name": "myo/reach"}]}
        manifest = {"stage": stage, "name": "toy", "key": key, "request": request, "inputs": inputs or {}}
        (path / "manifest.json").write_text(json.dumps(manifest))
        return Mirrored(path, names, ("health.json",))

    return make


def test_mlflow_mirrors_the_artifacts_and_is_built_again_when_deleted(tmp_path: Path, artifact: MakeArtifact) -> None:
    artifacts = [
        artifact("codebook", "c0", "acgd/codebook", "bc/codebook"),
        artifact("student", "s0", "acgd/student", inputs={"codebook": "c0", "rollouts": ["r0", "r1"]}, rows=600),
    ]
    assert sync(tmp_path, "toy-study", artifacts) == 2
    assert sync(tmp_path, "toy-study", artifacts) == 0, "finished runs are skipped"

    from mlflow import MlflowClient

    client = MlflowClient(tracking_uri=database_uri(tmp_path))
    experiment = client.get_experiment_by_name("toy-study")
    assert experiment is not None

    def runs() -> dict:
        return {run.info.run_name: run for run in client.search_runs([experiment.experiment_id])}

    assert set(runs()) == {"codebook toy", "acgd/student"}, "what variants share is named by stage and artifact"
    student = runs()["acgd/student"]
    tags, params = student.data.tags, student.data.params
    assert (tags["key"], tags["stage"], tags["variants"]) == ("s0", "student", "acgd")
    assert (tags["upstream.codebook"], tags["upstream.rollouts"]) == ("c0", "r0, r1")
    assert (params["student.width"], params["tasks.1.name"]) == ("64", "myo/reach")
    assert student.info.status == "FINISHED"
    assert (student.info.start_time, student.info.end_time) == (1_000_000, 1_002_500)
    assert student.data.metrics["health.code.error"] == 0.125
    curve = client.get_metric_history(student.info.run_id, "loss")
    assert sorted((point.step, point.value) for point in curve) == [(10 * i, 1 / (i + 1)) for i in range(600)]
    assert len(client.get_metric_history(student.info.run_id, "grad ratio _key_")) == 600
    assert [file.path for file in client.list_artifacts(student.info.run_id)] == ["curve.svg"]

    # A mirror that was killed leaves a run RUNNING: the next one replaces it.
    client.update_run(student.info.run_id, status="RUNNING")
    assert sync(tmp_path, "toy-study", artifacts) == 1
    assert runs()["acgd/student"].info.run_id != student.info.run_id
    assert client.get_run(student.info.run_id).info.lifecycle_stage == "deleted"

    # A variant added later shares the old codebook.
    assert sync(tmp_path, "toy-study", [Mirrored(artifacts[0].path, (*artifacts[0].names, "small/codebook"))]) == 0
    assert runs()["codebook toy"].data.tags["variants"] == "acgd, bc, small"

    # An experiment deleted in the browser comes back.
    client.delete_experiment(experiment.experiment_id)
    assert sync(tmp_path, "toy-study", artifacts) == 0
    assert client.get_experiment(experiment.experiment_id).lifecycle_stage == "active"

    # So does a deleted database. In a process of its own, as mlflow keeps the deleted file open in this one.
    (tmp_path / "mlflow.db").unlink()
    again = (
        "import pathlib, sys; from acgd.tracking.mlflow_mirror import Mirrored, sync; "
        "results, *paths = map(pathlib.Path, sys.argv[1:]); "
        "print(sync(results, 'toy-study', [Mirrored(path) for path in paths]))"
    )
    command = [sys.executable, "-c", again, str(tmp_path), *(str(made.path) for made in artifacts)]
    assert subprocess.run(command, check=True, capture_output=True, text=True).stdout.split() == ["2"]
    assert (tmp_path / "mlflow.db").exists()


def one_warning(caplog: pytest.LogCaptureFixture) -> str:
    (record,) = [record for record in caplog.records if record.levelno >= logging.WARNING]
    return record.getMessage()


def test_a_locked_database_is_a_warning(
    tmp_path: Path, artifact: MakeArtifact, caplog: pytest.LogCaptureFixture
) -> None:
    holder = sqlite3.connect(tmp_path / "mlflow.db")
    holder.execute("CREATE TABLE held (x)")
    holder.execute("BEGIN EXCLUSIVE")
    assert sync(tmp_path, "toy-study", [artifact("codebook", "c0")], lock_wait_s=0.1) is None
    holder.close()
    assert "locked" in one_warning(caplog) and "python -m acgd mlflow-sync" in one_warning(caplog)


def test_another_mirror_at_work_is_a_warning(
    tmp_path: Path, artifact: MakeArtifact, caplog: pytest.LogCaptureFixture
) -> None:
    from filelock import FileLock

    with FileLock(tmp_path / "mlflow.lock"):
        assert sync(tmp_path, "toy-study", [artifact("codebook", "c0")], lock_wait_s=0.1) is None
    assert "another process" in one_warning(caplog)


def test_a_damaged_database_is_a_warning(
    tmp_path: Path, artifact: MakeArtifact, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "mlflow.db").write_bytes(b"not a database at all" * 1000)
    assert sync(tmp_path, "toy-study", [artifact("codebook", "c0")]) is None
    assert f"rm {tmp_path / 'mlflow.db'}" in one_warning(caplog)


def test_a_missing_artifact_is_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert sync(tmp_path, "toy-study", [Mirrored(tmp_path / "store" / "student" / "toy" / "gone")]) is None
    assert "manifest.json" in one_warning(caplog)
