"""What a person does with the store: look, free, verify, mirror."""

import contextlib
import os
import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path

from acgd.store.store import MANIFEST, ArtifactError, Store, damages
from acgd.study import names
from acgd.study.load import ConfigError, read_yaml
from acgd.study.plan import Plan, plan
from acgd.study.study import load_study

Table = list[tuple[str, ...]]


def plans(files: Sequence[Path]) -> list[Plan]:
    """What the studies in these files need; without files, config.yaml and all of studies/."""
    files = list(files) or [
        file for file in (Path("config.yaml"), *sorted(Path("studies").glob("*.yaml"))) if file.is_file()
    ]
    if not files:
        raise ConfigError(
            "There is no config.yaml here, nor studies/. Go to the folder of config.yaml, or name the files of the studies."
        )
    return [_plan(file) for file in files]


def list_store(store: Store, files: Sequence[Path]) -> None:
    """`acgd ls`: a row for each artifact, with the studies that name it."""
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
    """`acgd gc`: removes what no study names, and abandoned work; only says so unless `yes`."""
    kept = set(_users(plans(files)))
    freed = 0
    for place in sorted({*store.places(), *store.unfinished(), *store.in_work()} - kept):
        size = _size(store.path(place)) + _size(store.work(place))
        if yes and not store.free(place):
            print(f"left alone, in the making: {place}")
            continue
        freed += size
        print(f"{'removed' if yes else 'would remove'} {place} ({_bytes(size)})")
    if yes:
        names.prune_dangling(store)
    print(f"{_bytes(freed)} {'freed' if yes else 'to free. To do it, type the same with --yes.'}")


def verify(store: Store, repair: bool) -> None:
    """`acgd verify`: rereads every checksum; with `repair`, removes what is damaged, so that the workflow makes it anew."""
    damaged = {}
    places = store.places()
    for place in places:
        try:
            found = damages(store.path(place), store.manifest(place)["payload"])
        except ArtifactError:
            found = [f"{MANIFEST} is damaged"]
        if found:
            damaged[place] = found
            print(
                f"{store.path(place)}: {'; '.join(found[:5])}{f' and {len(found) - 5} more' if len(found) > 5 else ''}"
            )
            if repair:
                store.remove(place)
    print(f"{len(places)} artifacts read, {len(damaged)} damaged{' and removed' if damaged and repair else ''}")
    if damaged and repair:
        names.prune_dangling(store)
        print("Run the workflow, which makes them anew.")
    elif damaged:
        raise ArtifactError(
            "To remove the damaged artifacts: python -m acgd verify --repair. Then run the workflow, which makes them anew."
        )


def mirror(store: Store, plans: Iterable[Plan]) -> None:
    """`acgd mlflow-sync`: brings MLflow up to date with what the studies have published. Never fails."""
    from acgd.tracking.mlflow_mirror import Mirrored, sync

    for plan in plans:
        published = [
            Mirrored(store.path(one.place), tuple(plan.names_of(one)), one.stage.results)
            for one in plan.artifacts.values()
            if store.has(one.place)
        ]
        written = sync(store.results, plan.study, published)
        if written is not None:
            print(f"MLflow, {plan.study}: {len(published)} artifacts, {written} of them new")


def check(store: Store, files: Sequence[Path]) -> None:
    """`acgd check`: validates studies and says what each would make."""
    for plan in plans(files):
        missing = [artifact for artifact in plan.artifacts.values() if not store.has(artifact.place)]
        print(f"{plan.study}: valid; {len(plan.artifacts)} artifacts, {len(missing)} of them to make")
        for artifact in missing:
            print(f"  {artifact.place}  {' '.join(plan.names_of(artifact)[:3])}")


def _plan(file: Path) -> Plan:
    try:
        return plan(load_study(read_yaml(file)))
    except ConfigError as error:
        lines = str(error).splitlines()
        raise ConfigError(
            "\n".join(line if line.startswith(f"{file}:") else f"{file}: {line}" for line in lines)
        ) from None


def _users(plans: Iterable[Plan]) -> dict[str, list[str]]:
    users: dict[str, list[str]] = defaultdict(list)
    for plan in plans:
        for place in plan.artifacts:
            users[place].append(plan.study)
    return users


def _size(folder: Path) -> int:
    """Bytes of all files. Those that vanish meanwhile do not count: another process may be making the artifact."""
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
