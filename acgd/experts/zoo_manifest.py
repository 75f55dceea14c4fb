"""zoo/manifest.json: what the zoo holds as a release, and what defines its tasks; a page to read for each expert."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from acgd.experts import zoo
from acgd.store.key import file_digest
from acgd.tasks.definition import definition, packages
from acgd.tasks.spec import TaskSpec

FILE, PAGE = "manifest.json", "README.md"


def entry(spec: TaskSpec, folder: Path) -> dict[str, Any]:
    """Of one expert: its task, its files and how well it does."""
    card = json.loads((folder / "card.json").read_text())
    files = [file for file in sorted(folder.rglob("*")) if file.is_file() and file.name != PAGE]
    return {
        "task": {"name": spec.name, "episode": definition(spec.name).episode, "packages": packages(spec.name)},
        "expert": {name: card[name] for name in ("algorithm", "steps", "seed")},
        "success": {rule: value["rate"] for rule, value in card["success"].items()},
        "episodes": card["episodes"],
        "versions": card["versions"],
        "files": {file.relative_to(folder).as_posix(): file_digest(file) for file in files},
    }


def write(entries: list[tuple[TaskSpec, Path]]) -> None:
    """manifest.json, and README.md in each folder."""
    content = {folder.name: entry(spec, folder) for spec, folder in entries}
    (zoo.ROOT / FILE).write_text(json.dumps(content, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    for spec, folder in entries:
        (folder / PAGE).write_text(page(spec, folder), encoding="utf-8")


def faults(spec: TaskSpec, folder: Path) -> Iterator[str]:
    """How an expert differs from what the manifest says of it, each with its mend."""
    file = zoo.ROOT / FILE
    known = json.loads(file.read_text())[folder.name] if file.is_file() else None
    if known is None:
        yield f"{file} is missing: restore it from the repository, or write it with `python -m acgd zoo manifest`"
        return
    here = entry(spec, folder)
    for name in sorted({*known["files"], *here["files"]}):
        if known["files"].get(name) != here["files"].get(name):
            yield f"{folder / name} is not the file of the release: restore it from the repository"
    if known["task"]["episode"] != here["task"]["episode"]:
        yield (
            f"the task {spec.name} has changed since its expert was measured: `python -m acgd zoo card {folder.name}`, "
            "then `python -m acgd zoo manifest`"
        )


def page(spec: TaskSpec, folder: Path) -> str:
    """The card as a page."""
    card = json.loads((folder / "card.json").read_text())
    rows = [
        f"| {rule} | {value['rate']:.3f} | {value['low']:.3f} to {value['high']:.3f} |"
        for rule, value in card["success"].items()
    ]
    critic = (
        "and the critic that was fitted to it (`critic/`)" if zoo.has_fitted_critic(spec.name) else "without a critic"
    )
    return "\n".join(
        [
            f"# Expert of {spec.name}",
            "",
            f"The goal: {spec.goal}. An episode has at most {spec.horizon} steps, and starts are {card['start']}.",
            "",
            f"Trained by {card['algorithm']} in {card['steps']:,} steps with seed {card['seed']}, from the privileged "
            f"state. {critic} Licence: Apache-2.0.",
            "",
            f"Over {card['episodes']} held-out episodes from seed {card['first_seed']} on, with 95 % intervals:",
            "",
            "| success | rate | interval |",
            "|---|---|---|",
            *rows,
            "",
            f"`final` is success at the last step, `held` for more than five steps, `once` at any step. Mean return "
            f"{card['return']:.1f}. Measured with {', '.join(f'{n} {v}' for n, v in card['versions'].items())}. "
            f"SHA-256 of the policy: `{card['sha256']}`.",
            "",
            "Measure it again: `python -m acgd zoo evaluate "
            + spec.name
            + "`. Settings: `request.json`. Learning curve: "
            "`curve.csv`.",
            "",
        ]
    )
