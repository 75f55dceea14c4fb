"""A mirror of the artifacts in MLflow, for comparing curves with `mlflow ui`.

The mirror reads published artifacts, which remain the source of truth. An error of the database becomes one warning
that names the mend, so the mirror never fails a job. One process mirrors all artifacts of a study, since importing
mlflow takes seconds. The process holds a lock, so that two workflows do not create one database at the same time.
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
"""Longest wait for another mirror, and then for another program that writes to the database."""
METRICS_A_CALL, PARAMS_A_CALL, LONGEST_VALUE = 1000, 100, 5000
"""Limits of MLflow: metrics and parameters per call, characters of a parameter or tag. Longer values are cut."""
FIGURES = (".svg", ".png")


@dataclass(frozen=True)
class Mirrored:
    """A published artifact and its names in the study, e.g. ("acgd/seed-0/student",)."""

    path: Path
    names: tuple[str, ...] = ()
    results: tuple[str, ...] = ()
    """JSON files of the payload whose numbers become metrics."""


def database_uri(results: Path) -> str:
    """The address of the database. Raises RuntimeError where no address can express its path."""
    path = str(Path(results).resolve() / "mlflow.db")
    if "?" in path:  # begins the options of an address
        path = os.path.relpath(path)
    if "?" in path:
        raise RuntimeError(f"the path {path} has a question mark, which MLflow cannot read. Rename the folder.")
    return f"sqlite:///{path}"


def sync(results: Path, study: str, artifacts: Sequence[Mirrored], lock_wait_s: float = LOCK_WAIT_S) -> int | None:
    """Writes a run for each artifact that the study's experiment lacks.

    Returns the number of new runs, or None after a warning. A deleted database is built again from the artifacts.
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
            "MLflow was not updated: another process has been mirroring for %.0f s. When it has ended, type: %s",
            lock_wait_s,
            SYNC_COMMAND,
        )
    except Exception as error:  # a mirror must never fail the job that called it
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
        """Mirrors one artifact. Returns False if the experiment has a finished run of the artifact's key."""
        tags = _tags(self.study, manifest, artifact.names)
        for run in self.runs.get(manifest["key"], []):
            if run.info.status == "FINISHED":
                self._retag(run, tags)
                return False
            self.client.set_terminated(run.info.run_id, "KILLED")
            self.client.delete_run(run.info.run_id)
        started, ended = _times(artifact.path)
        run = self.client.create_run(
            self.experiment.experiment_id, start_time=started, tags=tags, run_name=_run_name(manifest, artifact.names)
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
        """Updates the tags of a run: a new variant may share an old artifact."""
        for name, value in tags.items():
            if run.data.tags.get(name) != value:
                self.client.set_tag(run.info.run_id, name, value)

    def _open_experiment(self, root: Path) -> "Experiment":
        """The study's experiment, made or restored if needed. Raises RuntimeError where results/ has been moved."""
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
        """Artifact key -> runs."""
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
    os.environ.setdefault(
        "MLFLOW_DISABLE_TELEMETRY", "true"
    )  # mlflow reads it at import; by default it sends telemetry
    logging.getLogger("alembic").setLevel(logging.WARNING)  # alembic logs every migration of a new database
    from mlflow import MlflowClient

    logging.getLogger("mlflow").setLevel(logging.WARNING)
    return MlflowClient(tracking_uri=database_uri(results))


def _refuse_unusable(database: Path, wait_s: float) -> None:
    """Raises sqlite3.Error of a locked or damaged database. mlflow would retry for minutes."""
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
    """The mend of an error, for the warning."""
    if "locked" in str(error):
        return f"Close the program that uses {database} (mlflow ui?), then type: {SYNC_COMMAND}"
    if "disk is full" in str(error) or getattr(error, "errno", None) == 28:
        return f"Make room on the disk, then type: {SYNC_COMMAND}"
    return f"No result is lost: MLflow mirrors the artifacts. Build the database again: rm {database}; {SYNC_COMMAND}"


def _first_line(error: Exception) -> str:
    return (str(error).strip() or "no message").splitlines()[0]


def _run_name(manifest: dict[str, Any], names: Sequence[str]) -> str:
    """The artifact's name in the study if it has one name, else its stage and its name in the store."""
    return names[0] if len(names) == 1 else f"{manifest['stage']} {manifest['name']}"


def _tags(study: str, manifest: dict[str, Any], names: Sequence[str]) -> dict[str, str]:
    """Tags for filters: `tags.stage = "student"`, `tags.variants LIKE "%acgd%"`, `tags."upstream.critic" = "<key>"`."""
    tags = {"study": study, "key": manifest["key"], "stage": manifest["stage"], "name": manifest["name"]}
    if names:
        tags["variants"] = ", ".join(dict.fromkeys(name.split("/")[0] for name in names))
        tags["names"] = ", ".join(names)
    for role, keys in manifest["inputs"].items():
        tags[f"upstream.{role}"] = keys if isinstance(keys, str) else ", ".join(keys)
    return {name: value[:LONGEST_VALUE] for name, value in tags.items()}


def _times(path: Path) -> tuple[int | None, int | None]:
    """Start and end in ms since 1970, from `started` and `wall_s` (s) of run.json; None where it lacks them."""
    try:
        run = json.loads((path / "run.json").read_text(encoding="utf-8"))
        started = int(1000 * run["started"])
        return started, started + int(1000 * run["wall_s"])
    except (OSError, KeyError, ValueError, TypeError):
        return None, None


def _metrics(artifact: Mirrored, ended_ms: int | None) -> Iterator["Metric"]:
    """The points of every curve, then each number of the results as one point, e.g. quality.within_state.mean."""
    from mlflow.entities import Metric

    timestamp = ended_ms or 0
    for row in read(artifact.path / "metrics.jsonl"):
        step = row.pop("step")
        for name, value in row.items():
            yield Metric(_allowed(name), value, timestamp, step)
    for file in (artifact.path / name for name in artifact.results):
        if not file.exists():
            continue
        for name, value in _numbers(json.loads(file.read_text(encoding="utf-8")), file.stem):
            yield Metric(_allowed(name), value, timestamp, 0)


def _numbers(value: object, name: str) -> Iterator[tuple[str, float]]:
    """(dotted name, value) of the finite numbers in nested maps. Lists are left out: MLflow cannot show tables."""
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
    """(dotted name, value) of nested settings: {"student": {"lr": 1e-3}} -> ("student.lr", 1e-3).

    The items of a list of maps, such as the tasks, are numbered. Any other list is one value.
    """
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
    """`name` without the characters that MLflow refuses in names of metrics and parameters."""
    return re.sub(r"[^\w.\- /:]", "_", name)[:250]


def _batches(items: list[Any], size: int) -> Iterator[list[Any]]:
    for first in range(0, len(items), size):
        yield items[first : first + size]
