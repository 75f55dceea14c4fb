"""A mirror of the artifacts in MLflow, for looking at curves side by side: `mlflow ui`.

Never the source of truth and never able to fail a job: everything here is read from published artifacts, and whatever
goes wrong with the database becomes one warning that names the mend. One process mirrors all artifacts of a study, since
importing mlflow costs seconds; it holds a lock, so that two workflows do not create one database at once.
"""

import json
import logging
import math
import os
import re
import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock, Timeout

from acgd.store.metrics import read

if TYPE_CHECKING:
    from mlflow import MlflowClient
    from mlflow.entities import Experiment, Metric, Run

logger = logging.getLogger(__name__)

SYNC_COMMAND = "python -m acgd mlflow-sync"
LOCK_WAIT_S = 60.0
"""How long to wait for another mirror, and then for whoever else writes to the database."""
METRICS_A_CALL, PARAMS_A_CALL, LONGEST_VALUE = 1000, 100, 5000
"""MLflow's limits; a longer parameter or tag is cut."""
FIGURES = (".svg", ".png")


@dataclass(frozen=True)
class Mirrored:
    """A published artifact and the names that the study gives it, e.g. ("acgd/seed-0/student",); several share one."""

    path: Path
    names: tuple[str, ...] = ()
    results: tuple[str, ...] = ()
    """JSON files of its payload whose numbers are worth a column; in the others stand settings, which are parameters."""


def database_uri(results: Path) -> str:
    return f"sqlite:///{Path(results).resolve() / 'mlflow.db'}"


def sync(results: Path, study: str, artifacts: Sequence[Mirrored], lock_wait_s: float = LOCK_WAIT_S) -> int | None:
    """Brings the study's experiment up to date with its artifacts: returns the number of runs written, None on a warning.

    Runs that are there already stay; a deleted database is built again from the artifacts.
    """
    results = Path(results)
    database = results / "mlflow.db"
    try:
        results.mkdir(parents=True, exist_ok=True)
        with FileLock(results / "mlflow.lock", timeout=lock_wait_s):
            _refuse_unusable(database, lock_wait_s)
            manifests = [
                json.loads((artifact.path / "manifest.json").read_text(encoding="utf-8")) for artifact in artifacts
            ]
            mirror = _Mirror(results, study)
            return sum(
                mirror.write(artifact, manifest) for artifact, manifest in zip(artifacts, manifests, strict=True)
            )
    except Timeout:
        logger.warning(
            "MLflow was not updated: another process has been mirroring for %.0f s. Once it has ended: %s",
            lock_wait_s,
            SYNC_COMMAND,
        )
    except Exception as error:  # the boundary: a mirror must never fail the job that asked for it
        logger.warning(
            "MLflow was not updated (%s: %s). %s", type(error).__name__, _first_line(error), _mend(error, database)
        )
    return None


class _Mirror:
    """One study's experiment in an open database."""

    def __init__(self, results: Path, study: str) -> None:
        self.client = _client(results)
        self.study = study
        self.experiment = self._open_experiment((results / "mlruns").resolve())
        self.runs = self._runs_by_key()

    def write(self, artifact: Mirrored, manifest: dict[str, Any]) -> bool:
        """Mirrors one artifact, unless a finished run of its key is there; False if so."""
        tags = _tags(self.study, manifest, artifact.names)
        for run in self.runs.get(manifest["key"], []):
            if run.info.status == "FINISHED":
                self._retag(run, tags)
                return False
            self.client.set_terminated(run.info.run_id, "KILLED")
            self.client.delete_run(run.info.run_id)
        began, ended = _times(artifact.path)
        run = self.client.create_run(
            self.experiment.experiment_id, start_time=began, tags=tags, run_name=_run_name(manifest, artifact.names)
        )
        run_id = run.info.run_id
        params = [_param(name, value) for name, value in _flatten(manifest["request"])]
        for batch in _batches(params, PARAMS_A_CALL):
            self.client.log_batch(run_id, params=batch)
        for batch in _batches(list(_metrics(artifact, ended)), METRICS_A_CALL):
            self.client.log_batch(run_id, metrics=batch)
        for figure in sorted(path for path in artifact.path.rglob("*") if path.suffix in FIGURES):
            folder = figure.parent.relative_to(artifact.path)
            self.client.log_artifact(run_id, str(figure), None if folder == Path() else str(folder))
        self.client.set_terminated(run_id, "FINISHED", end_time=ended)
        return True

    def _retag(self, run: "Run", tags: dict[str, str]) -> None:
        """A variant added later may share an old artifact."""
        for name, value in tags.items():
            if run.data.tags.get(name) != value:
                self.client.set_tag(run.info.run_id, name, value)

    def _open_experiment(self, root: Path) -> "Experiment":
        location = (root / self.study).as_uri()
        experiment = self.client.get_experiment_by_name(self.study)
        if experiment is None:
            experiment = self.client.get_experiment(self.client.create_experiment(self.study, location))
        if experiment.artifact_location != location:  # MLflow stores absolute paths
            raise RuntimeError(f"this database belongs to {experiment.artifact_location}: results/ was moved or copied")
        if experiment.lifecycle_stage == "deleted":
            self.client.restore_experiment(experiment.experiment_id)
        return experiment

    def _runs_by_key(self) -> dict[str, list["Run"]]:
        runs: dict[str, list[Run]] = {}
        page = None
        while page is None or page.token:
            page = self.client.search_runs(
                [self.experiment.experiment_id], max_results=1000, page_token=page and page.token
            )
            for run in page:
                runs.setdefault(run.data.tags.get("key", ""), []).append(run)
        return runs


def _client(results: Path) -> "MlflowClient":
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")  # mlflow reads it when imported, and calls home otherwise
    logging.getLogger("alembic").setLevel(logging.WARNING)  # a page of migrations for each new database
    from mlflow import MlflowClient

    logging.getLogger("mlflow").setLevel(logging.WARNING)
    return MlflowClient(tracking_uri=database_uri(results))


def _refuse_unusable(database: Path, wait_s: float) -> None:
    """mlflow itself tries a locked or damaged database for minutes: ask sqlite first."""
    if not database.exists():
        return
    connection = sqlite3.connect(database, timeout=wait_s)
    try:
        connection.execute("BEGIN IMMEDIATE")
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        connection.rollback()
    finally:
        connection.close()


def _mend(error: Exception, database: Path) -> str:
    if "locked" in str(error):
        return f"Close the program that holds {database} (mlflow ui?), then: {SYNC_COMMAND}"
    if "disk is full" in str(error) or getattr(error, "errno", None) == 28:
        return f"Make room on the disk, then: {SYNC_COMMAND}"
    return f"Nothing is lost, it only mirrors the artifacts. Build it again: rm {database}; {SYNC_COMMAND}"


def _first_line(error: Exception) -> str:
    return (str(error).strip() or "no message").splitlines()[0]


def _run_name(manifest: dict[str, Any], names: Sequence[str]) -> str:
    """A student is known by its variant; what several variants share, by its stage and the artifact's own name."""
    return names[0] if len(names) == 1 else f"{manifest['stage']} {manifest['name']}"


def _tags(study: str, manifest: dict[str, Any], names: Sequence[str]) -> dict[str, str]:
    """What to filter by: `tags.stage = "student"`, `tags.variants LIKE "%acgd%"`, `tags."upstream.codebook" = "<key>"`."""
    tags = {"study": study, "key": manifest["key"], "stage": manifest["stage"], "name": manifest["name"]}
    if names:
        tags["variants"] = ", ".join(dict.fromkeys(name.split("/")[0] for name in names))
        tags["names"] = ", ".join(names)
    for role, keys in manifest["inputs"].items():
        tags[f"upstream.{role}"] = keys if isinstance(keys, str) else ", ".join(keys)
    return {name: value[:LONGEST_VALUE] for name, value in tags.items()}


def _times(path: Path) -> tuple[int | None, int | None]:
    """Begin and end in milliseconds, from run.json's `started` (s since 1970) and `wall_s`, so that MLflow shows durations."""
    try:
        run = json.loads((path / "run.json").read_text(encoding="utf-8"))
        began = int(1000 * run["started"])
        return began, began + int(1000 * run["wall_s"])
    except (OSError, KeyError, ValueError, TypeError):
        return None, None


def _metrics(artifact: Mirrored, ended_ms: int | None) -> Iterator["Metric"]:
    """Every curve, then each number among the results as one point, e.g. quality.within_state.mean."""
    from mlflow.entities import Metric

    stamp = ended_ms or 0
    for row in read(artifact.path / "metrics.jsonl"):
        step = row.pop("step")
        for name, value in row.items():
            yield Metric(_allowed(name), value, stamp, step)
    for file in (artifact.path / name for name in artifact.results):
        if not file.exists():
            continue
        for name, value in _numbers(json.loads(file.read_text(encoding="utf-8")), file.stem):
            yield Metric(_allowed(name), value, stamp, 0)


def _numbers(value: object, name: str) -> Iterator[tuple[str, float]]:
    """The numbers in nested maps; lists are tables, which MLflow cannot show."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _numbers(item, f"{name}.{key}")
    elif isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        yield name, float(value)


def _param(name: str, value: object) -> Any:
    from mlflow.entities import Param

    text = value if isinstance(value, str) else json.dumps(value)
    return Param(_allowed(name), text[:LONGEST_VALUE])


def _flatten(value: object, prefix: str = "") -> Iterator[tuple[str, object]]:
    """{"student": {"lr": 1e-3}} -> ("student.lr", 1e-3). Lists of maps, such as the tasks, are numbered; others stay whole."""
    if isinstance(value, dict):
        named = value.items()
    elif isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
        named = ((str(i), item) for i, item in enumerate(value))
    else:
        yield prefix, value
        return
    for name, item in named:
        yield from _flatten(item, f"{prefix}.{name}" if prefix else name)


def _allowed(name: str) -> str:
    """MLflow refuses other characters in the names of metrics and parameters."""
    return re.sub(r"[^\w.\- /:]", "_", name)[:250]


def _batches(items: list[Any], size: int) -> Iterator[list[Any]]:
    for first in range(0, len(items), size):
        yield items[first : first + size]
