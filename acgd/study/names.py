"""Names of artifacts: text files in `results/<study>/`. Each file lists the directories of the artifacts it names."""

import hashlib
import shutil
from pathlib import Path

from acgd.store.atomic import replace_file, replace_text
from acgd.store.key import KEY_LENGTH, canonical
from acgd.store.store import MANIFEST, METRICS, NOT_PAYLOAD, Store
from acgd.study.plan import Artifact, Plan


def all_names(plan: Plan) -> dict[str, list[Artifact]]:
    """Name -> artifacts, for all variants and the report."""
    return {**plan.names, "report": [plan.report]}


def fingerprint(plan: Plan) -> str:
    """A hash of all names and their artifacts. It changes when a name must be rewritten."""
    places = {name: [artifact.place for artifact in artifacts] for name, artifacts in all_names(plan).items()}
    return hashlib.sha256(canonical(places).encode()).hexdigest()[:KEY_LENGTH]


def content(store: Store, plan: Plan, name: str) -> str:
    """Content of the file of a name: one directory per line."""
    return "".join(f"{store.path(artifact.place)}\n" for artifact in all_names(plan)[name])


def prune(store: Store, plan: Plan) -> dict[Path, str]:
    """Removes the names of artifacts that the plan or the store lacks. Returns file -> content of the removed names."""
    removed = {}
    folder, names = store.results / plan.study, all_names(plan)
    for file in [file for file in folder.rglob("*") if file.is_file() and _is_name(file)]:
        name = file.relative_to(folder).as_posix()
        text = file.read_text(encoding="utf-8")
        is_valid = (
            name in names
            and text == content(store, plan, name)
            and all(store.has(artifact.place) for artifact in names[name])
        )
        if not is_valid:
            removed[file] = text
            file.unlink()
    return removed


def restore(removed: dict[Path, str]) -> None:
    """Writes the names that `prune` has removed, unless the file exists again."""
    for file, text in removed.items():
        if not file.exists():
            replace_text(file, text)


def prune_dangling(store: Store) -> None:
    """Removes the names of artifacts that the store lacks, in every study."""
    for file in [
        file
        for file in store.results.rglob("*")
        if file.is_file() and store.root not in file.parents and _is_name(file)
    ]:
        if not all((Path(line) / MANIFEST).is_file() for line in file.read_text(encoding="utf-8").split()):
            file.unlink()


def publish(store: Store, plan: Plan) -> Path:
    """Copies the report to `results/<study>/` and writes the names of the study. Returns the page's path."""
    folder = store.results / plan.study
    report = store.path(plan.report.place)
    for file in sorted(report.rglob("*")):
        if file.is_file() and not (file.parent == report and file.name in (*NOT_PAYLOAD, METRICS)):
            target = folder / file.relative_to(report)
            replace_file(target, lambda draft, source=file: shutil.copyfile(source, draft))
    for name in all_names(plan):
        write(store, plan, name)
    mark(store, "published", plan.study, fingerprint(plan))
    return folder / "report.html"


def mark(store: Store, action: str, study: str, fingerprint: str) -> None:
    """Records a finished action (`published`, `mirrored`): `results/work/<action>/<study>/<fingerprint>`.

    Removes the records of earlier fingerprints.
    """
    folder = store.results / "work" / action / study
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / fingerprint).touch()


def write(store: Store, plan: Plan, name: str) -> None:
    """Writes the file of a name, unless it has this content. A reader never sees an incomplete file."""
    file = store.results / plan.study / name
    text = content(store, plan, name)
    if not file.is_file() or file.read_text(encoding="utf-8") != text:
        replace_text(file, text)


def _is_name(file: Path) -> bool:
    """Whether the file is a name: it has no suffix, and lists directories of a store."""
    if file.suffix or file.stat().st_size > 1 << 20:
        return False
    lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
    return bool(lines) and all("store/" in line for line in lines)
