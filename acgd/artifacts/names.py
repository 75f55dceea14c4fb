"""Names for people: small text files in `results/<study>/` that list the directories of the artifacts they stand for."""

import shutil
from pathlib import Path

from acgd.artifacts.atomic import replace_file
from acgd.artifacts.graph import Artifact, Plan
from acgd.artifacts.store import MANIFEST, METRICS, NOT_PAYLOAD, Store

MLFLOW = "mlflow"
"""The name of all that the study has in MLflow."""


def all_names(plan: Plan) -> dict[str, list[Artifact]]:
    """The names of the variants' artifacts, and two of the whole study."""
    return {**plan.names, "report": [plan.report], MLFLOW: list(plan.artifacts.values())}


def content(store: Store, plan: Plan, name: str) -> str:
    """What the file of a name says."""
    return "".join(f"{store.path(artifact.place)}\n" for artifact in all_names(plan)[name])


def prune(store: Store, plan: Plan) -> None:
    """Takes away names that no longer hold: of other artifacts than the plan's, or of artifacts that are gone."""
    folder, names = store.results / plan.study, all_names(plan)
    for file in [file for file in folder.rglob("*") if file.is_file() and _is_name(file)]:
        name = file.relative_to(folder).as_posix()
        holds = name in names and file.read_text(encoding="utf-8") == content(store, plan, name)
        if not holds or not all(store.has(artifact.place) for artifact in names[name]):
            file.unlink()


def prune_dangling(store: Store) -> None:
    """Takes away names of artifacts that are gone, in every study."""
    for file in [file for file in store.results.rglob("*") if file.is_file() and store.root not in file.parents and _is_name(file)]:
        if not all((Path(line) / MANIFEST).is_file() for line in file.read_text(encoding="utf-8").split()):
            file.unlink()


def publish(store: Store, plan: Plan) -> Path:
    """Copies the report to `results/<study>/`, writes the names of the study, and gives the page's path."""
    folder = store.results / plan.study
    report = store.path(plan.report.place)
    for file in sorted(report.rglob("*")):
        if file.is_file() and not (file.parent == report and file.name in (*NOT_PAYLOAD, METRICS)):
            target = folder / file.relative_to(report)
            replace_file(target, lambda draft, source=file: shutil.copyfile(source, draft))
    for name in (*plan.names, "report"):
        write(store, plan, name)
    return folder / "report.html"


def write(store: Store, plan: Plan, name: str) -> None:
    """One name, if it says something else or is not there; whoever reads it then finds the whole of it."""
    file = store.results / plan.study / name
    text = content(store, plan, name)
    if not file.is_file() or file.read_text(encoding="utf-8") != text:
        replace_file(file, lambda draft: draft.write_text(text, encoding="utf-8"))


def _is_name(file: Path) -> bool:
    """Names have no suffix and list directories of a store."""
    if file.suffix or file.stat().st_size > 1 << 20:
        return False
    lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
    return bool(lines) and all("store/" in line for line in lines)
