"""Commands on studies and the store: check, ls, gc, verify, mlflow-sync."""

import contextlib
import os
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path

from acgd.store.store import MANIFEST, ArtifactError, Store, damages
from acgd.study import names
from acgd.study.load import ConfigError, read_yaml
from acgd.study.plan import Plan
from acgd.study.plan import plan as plan_study
from acgd.study.study import load_study

Table = list[tuple[str, ...]]


def plans(files: Sequence[Path]) -> list[Plan]:
    """The plan of the study in each file. Without files: config.yaml and all of studies/.

    Raises ConfigError of a missing or invalid file.
    """
    files = list(files) or [
        file for file in (Path("config.yaml"), *sorted(Path("studies").glob("*.yaml"))) if file.is_file()
    ]
    if not files:
        raise ConfigError(
            "This folder has neither config.yaml nor studies/. Go to the folder of config.yaml, or name the files of "
            "the studies."
        )
    return [_plan(file) for file in files]


def list_store(store: Store, files: Sequence[Path]) -> None:
    """`acgd ls`: prints a row for each artifact, with the studies that name it."""
    users = _users(plans(files))
    rows: Table = [("stage", "name", "key", "size", "age", "studies")]
    total = 0
    for place in store.places():
        size = _size(store.path(place))
        total += size
        age = time.time() - (store.path(place) / MANIFEST).stat().st_mtime
        rows.append((*place.split("/"), _bytes(size), _age(age), ", ".join(users.get(place, ())) or "-"))
    _print(rows)
    unfinished = [place for place in store.unfinished()]
    note = f", {len(unfinished)} unfinished: {', '.join(unfinished)}" if unfinished else ""
    print(f"{len(rows) - 1} artifacts, {_bytes(total)} in {store.root}{note}")


def free(store: Store, files: Sequence[Path], yes: bool) -> None:
    """`acgd gc`: removes artifacts and unfinished work that no study names. Without `yes`, it prints them only."""
    kept = set(_users(plans(files)))
    freed = 0
    for place in sorted({*store.places(), *store.unfinished(), *store.in_work()} - kept):
        size = _size(store.path(place)) + _size(store.work(place))
        if yes and not store.free(place):
            print(f"not removed, a process is making it: {place}")
            continue
        freed += size
        print(f"{'removed' if yes else 'would remove'} {place} ({_bytes(size)})")
    if yes:
        names.prune_dangling(store)
    print(f"{_bytes(freed)} {'freed' if yes else 'to free. To remove them, repeat the command with --yes.'}")


def verify(store: Store, repair: bool) -> None:
    """`acgd verify`: compares every file with its checksum. With `repair`, it removes the damaged artifacts.

    Raises ArtifactError where damaged artifacts remain.
    """
    damaged = {}
    places = store.places()
    for place in places:
        try:
            differences = damages(store.path(place), store.manifest(place)["payload"])
        except ArtifactError:
            differences = [f"{MANIFEST} is damaged"]
        if differences:
            damaged[place] = differences
            more = f" and {len(differences) - 5} more" if len(differences) > 5 else ""
            print(f"{store.path(place)}: {'; '.join(differences[:5])}{more}")
            if repair:
                store.remove(place)
    print(f"{len(places)} artifacts read, {len(damaged)} damaged{' and removed' if damaged and repair else ''}")
    if damaged and repair:
        names.prune_dangling(store)
        print("Run the workflow, which makes them again.")
    elif damaged:
        raise ArtifactError(
            "Artifacts are damaged. Type: python -m acgd verify --repair, which removes them. Then run the workflow, "
            "which makes them again."
        )


def mirror(store: Store, plans: Iterable[Plan]) -> None:
    """`acgd mlflow-sync`: writes the published artifacts of the studies to MLflow. An error becomes a warning."""
    from acgd.tracking.mlflow_mirror import Mirrored, sync

    for plan in plans:
        published = [
            Mirrored(store.path(artifact.place), tuple(plan.names_of(artifact)), artifact.stage.results)
            for artifact in plan.artifacts.values()
            if store.has(artifact.place)
        ]
        written = sync(store.results, plan.study, published)
        if written is not None:
            print(f"MLflow, {plan.study}: {len(published)} artifacts, {written} of them new")


def check(store: Store, files: Sequence[Path]) -> None:
    """`acgd check`: validates the studies and prints the artifacts that each still needs.

    Raises ConfigError where two studies have one name.
    """
    studies = plans(files)
    for plan in studies:
        missing = [artifact for artifact in plan.artifacts.values() if not store.has(artifact.place)]
        print(f"{plan.study}: valid; {len(plan.artifacts)} artifacts, {len(missing)} of them to make")
        for artifact in missing:
            print(f"  {artifact.place}  {' '.join(plan.names_of(artifact)[:3])}")
    counts = Counter(plan.study for plan in studies)
    if twice := [study for study, count in counts.items() if count > 1]:
        raise ConfigError(
            f"{counts[twice[0]]} studies have the name {twice[0]}, and so one folder {store.results / twice[0]}. "
            "Give each its own `name:`."
        )


def _plan(file: Path) -> Plan:
    """The plan of the study in a file. Each line of a ConfigError begins with the file's name."""
    try:
        return plan_study(load_study(read_yaml(file)))
    except ConfigError as error:
        lines = str(error).splitlines()
        raise ConfigError(
            "\n".join(line if line.startswith((f"{file}:", f"{file}, line")) else f"{file}: {line}" for line in lines)
        ) from None


def _users(plans: Iterable[Plan]) -> dict[str, list[str]]:
    """Place -> names of the studies that need the artifact."""
    users: dict[str, list[str]] = defaultdict(list)
    for plan in plans:
        for place in plan.artifacts:
            users[place].append(plan.study)
    return users


def _size(folder: Path) -> int:
    """Bytes of all files in a folder. Ignores files that another process removes during the count."""
    size = 0
    for place, _, files in os.walk(folder):
        for file in files:
            with contextlib.suppress(FileNotFoundError):
                size += (Path(place) / file).stat().st_size
    return size


def _bytes(size: float) -> str:
    for unit in ("B", "kB", "MB"):
        if size < 1000:
            return f"{size:.0f} {unit}" if unit == "B" else f"{size:.1f} {unit}"
        size /= 1000
    return f"{size:.1f} GB"


def _age(seconds: float) -> str:
    for unit, length in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} s"


def _print(rows: Table) -> None:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        sys.stdout.write("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() + "\n")
