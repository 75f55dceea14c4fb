"""`acgd export` and `acgd replay`."""

import argparse
import shlex
import sys
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from acgd.export.kinds import EXPORTS
from acgd.settings import Section, imported
from acgd.store.store import ArtifactError

SUBJECTS = {"rollouts": ("rollouts", "onpolicy"), "student": ("student",)}
"""Subject of an export -> stages of its artifacts."""


def add_parser(subparsers) -> None:
    """Adds `export rollouts | student` and `replay` to the command line."""
    export = subparsers.add_parser("export", help="write rollouts or a student in a format that other projects read")
    export.add_argument("subject", choices=SUBJECTS)
    export.add_argument(
        "name", type=Path, help="folder of an artifact, or a name such as results/<study>/<variant>/rollouts"
    )
    export.add_argument("--format", required=True, help=f"one of {', '.join(EXPORTS)}")
    export.add_argument("--out", type=Path, required=True, metavar="folder", help="empty or absent")
    export.add_argument(
        "--set", action="append", default=[], metavar="key=value", help="a setting of the format, such as images=mp4"
    )
    export.set_defaults(run=_export)
    replay = subparsers.add_parser("replay", help="replay an exported dataset in the simulator, from its files alone")
    replay.add_argument("folder", type=Path)
    replay.set_defaults(run=_replay)


def settings_of(subject: str, format: str, given: list[str]) -> Section:
    """The settings of a format from `given` key=value pairs. ArtifactError names the fault."""
    fitting = [name for name, kind in EXPORTS.items() if set(imported(kind.settings).stages) <= set(SUBJECTS[subject])]
    if format not in fitting:
        raise ArtifactError(f"{subject} cannot be exported as {format!r}; formats of {subject}: {', '.join(fitting)}")
    values: dict[str, Any] = {}
    for item in given:
        path, equals, value = item.partition("=")
        if not equals:
            raise ArtifactError(f"--set {item}: write it as key=value")
        *outer, last = path.split(".")
        inner = values
        for name in outer:
            inner = inner.setdefault(name, {})
        inner[last] = value
    try:
        return imported(EXPORTS[format].settings)(**values)
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}" for fault in error.errors())
        raise ArtifactError(f"settings of the format {format}: {faults}") from None


def export(settings: Section, name: Path, out: Path, command: str) -> list[Path]:
    """Writes the export with card and checksums. Returns its artifacts."""
    from acgd.export.artifacts import named
    from acgd.export.card import write_card
    from acgd.export.destination import check, filled, write_sums
    from acgd.rollouts.store import DamagedStoreError

    check(out)
    artifacts = named(name, settings.stages)
    with filled(out) as draft:
        try:
            use = imported(EXPORTS[settings.kind].code)(settings, artifacts, draft)
        except DamagedStoreError as error:
            raise ArtifactError(str(error)) from error
        write_card(draft, settings, artifacts, use, command)
        write_sums(draft)
    return artifacts


def _export(options: argparse.Namespace) -> None:
    settings = settings_of(options.subject, options.format, options.set)
    command = shlex.join(["python", "-m", "acgd", *sys.argv[1:]])
    artifacts = export(settings, options.name, options.out, command)
    print(f"{options.out}: {options.format} of {', '.join(str(folder) for folder in artifacts)}")


def _replay(options: argparse.Namespace) -> int:
    from acgd.export.replay import read, replay
    from acgd.rollouts.formats.episode import UnreadableError

    count = same = succeeded = 0
    try:
        for one in replay(read(options.folder)):
            count, same = count + 1, same + (one.recorded == one.replayed)
            succeeded += one.replayed
    except UnreadableError as error:
        raise ArtifactError(str(error)) from error
    print(f"{count} episodes replayed, {succeeded} succeed; {same} end as they were recorded")
    return 0 if count and same == count else 1
