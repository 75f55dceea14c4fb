"""Names for people: small text files in `results/<study>/` that list the directories of the artifacts they stand for."""

import hashlib
import shutil
from pathlib import Path

from acgd.store.atomic import replace_file
from acgd.store.key import KEY_LENGTH, canonical
from acgd.store.store import MANIFEST, METRICS, NOT_PAYLOAD, Store
from acgd.study.plan import Artifact, Plan


def all_names(plan: Plan) -> dict[str, list[Artifact]]:
    """The names of the variants' artifacts, and that of the report."""
    return {**plan.names, "report": [plan.report]}


def fingerprint(plan: Plan) -> str:
    """A hash of the names and of what they stand for: it changes when there is something to write anew."""
    places = {name: [artifact.place for artifact in artifacts] for name, artifacts in all_names(plan).items()}
    return hashlib.sha256(canonical(places).encode()).hexdigest()[:KEY_LENGTH]


def content(store: Store, plan: Plan, name: str) -> str:
    """What the file of a name says."""
    return "".join(f"{store.path(artifact.place)}\n" for artifact in all_names(plan)[name])


def prune(store: Store, plan: Plan) -> dict[Path, str]:
    """Takes away names that no longer hold: of other artifacts than the plan's, or of artifacts that are gone. Gives what they said."""
    said = {}
    folder, names = store.results / plan.study, all_names(plan)
    for file in [file for file in folder.rglob("*") if file.is_file() and _is_name(file)]:
        name = file.relative_to(folder).as_posix()
        text = file.read_text(encoding="utf-8")
        holds = (
            name in names
            and text == content(store, plan, name)
            and all(store.has(artifact.place) for artifact in names[name])
        )
        if not holds:
            said[file] = text
            file.unlink()
    return said


def restore(said: dict[Path, str]) -> None:
    """Puts back what `prune` took away, where nothing has been written since."""
    for file, text in said.items():
        if not file.exists():
            replace_file(file, lambda draft, text=text: draft.write_text(text, encoding="utf-8"))


def prune_dangling(store: Store) -> None:
    """Takes away names of artifacts that are gone, in every study."""
    for file in [
        file
        for file in store.results.rglob("*")
        if file.is_file() and store.root not in file.parents and _is_name(file)
    ]:
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
    for name in all_names(plan):
        write(store, plan, name)
    mark(store, "published", plan.study, fingerprint(plan))
    return folder / "report.html"


def mark(store: Store, what: str, study: str, fingerprint: str) -> None:
    """Notes what `what` is up to date with: `results/work/<what>/<study>/<fingerprint>`, in place of earlier notes."""
    folder = store.results / "work" / what / study
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / fingerprint).touch()


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
