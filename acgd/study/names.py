"""Names of artifacts: text files in `results/<study>/`. Each file lists the directories of the artifacts it names."""

import hashlib
import shutil
from collections.abc import Iterable
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


def content(store: Store, artifacts: Iterable[Artifact]) -> str:
    """Content of the file of a name: one directory per line."""
    return "".join(f"{store.path(artifact.place)}\n" for artifact in artifacts)


def outdated(store: Store, plan: Plan) -> list[str]:
    """Names of the plan whose file is absent or lists other directories."""
    folder = store.results / plan.study
    return [name for name, artifacts in all_names(plan).items() if _text(folder / name) != content(store, artifacts)]


def prune(store: Store, plan: Plan) -> None:
    """Removes the names in the study's folder that the plan lacks."""
    folder, names = store.results / plan.study, all_names(plan)
    for file in [file for file in folder.rglob("*") if file.is_file() and _is_name(file)]:
        if file.relative_to(folder).as_posix() not in names:
            file.unlink()


def prune_dangling(store: Store) -> None:
    """Removes the names of artifacts that the store lacks, in every study."""
    for file in [
        file
        for file in store.results.rglob("*")
        if file.is_file() and store.root not in file.parents and _is_name(file)
    ]:
        if not all((Path(line) / MANIFEST).is_file() for line in file.read_text(encoding="utf-8").split()):
            file.unlink()


def publish(store: Store, plan: Plan, source: str = "") -> Path:
    """Copies the report to `results/<study>/` and writes the names of the study. Returns the page's path.

    Removes names of before. source: path of the configuration, for `other_source`.
    """
    folder = store.results / plan.study
    report = store.path(plan.report.place)
    for file in sorted(report.rglob("*")):
        if file.is_file() and not (file.parent == report and file.name in (*NOT_PAYLOAD, METRICS)):
            target = folder / file.relative_to(report)
            replace_file(target, lambda draft, source=file: shutil.copyfile(source, draft))
    for name, artifacts in all_names(plan).items():
        text = content(store, artifacts)
        if _text(folder / name) != text:
            replace_text(folder / name, text)
    prune(store, plan)
    mark(store, "published", plan.study, fingerprint(plan), source)
    return folder / "report.html"


def mark(store: Store, action: str, study: str, fingerprint: str, source: str = "") -> None:
    """Records a finished action (`published`, `mirrored`): `results/work/<action>/<study>/<fingerprint>`.

    The file contains the path of the configuration. Removes the records of earlier fingerprints.
    """
    folder = store.results / "work" / action / study
    shutil.rmtree(folder, ignore_errors=True)
    replace_text(folder / fingerprint, source)


def other_source(store: Store, study: str, source: Path) -> Path | None:
    """Another configuration that published a study of this name, and still has the name. None without one."""
    from acgd.study.load import ConfigError, read_yaml
    from acgd.study.study import Study

    for record in (store.results / "work" / "published" / study).glob("*"):
        other = Path(_text(record) or "/")
        if other.is_file() and not (source.exists() and other.samefile(source)):
            try:
                return other if read_yaml(other).get("name", Study.model_fields["name"].default) == study else None
            except ConfigError:
                return None
    return None


def _text(file: Path) -> str | None:
    """The text of a file. None where it is absent."""
    try:
        return file.read_text(encoding="utf-8", errors="replace")
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        return None


def _is_name(file: Path) -> bool:
    """Whether the file is a name: it has no suffix, and lists directories of a store."""
    if file.suffix or file.stat().st_size > 1 << 20:
        return False
    lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
    return bool(lines) and all("store/" in line for line in lines)
