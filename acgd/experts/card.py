"""The card stage: origin, training and held-out success of an expert."""

import csv
import importlib.metadata
import json
import shutil
from pathlib import Path
from typing import Any

from acgd.experts import zoo
from acgd.experts.learner import LearnerSettings
from acgd.experts.policy import Expert
from acgd.experts.settings import CardRequest, ZooSettings
from acgd.experts.success import episodes
from acgd.simulate.proportion import wilson
from acgd.simulate.seeds import SEEDS
from acgd.store.key import file_digest, in_key
from acgd.store.stage import Context, Inputs
from acgd.tasks.settings import TaskConfig

POLICY, CRITIC = zoo.POLICY[0], zoo.CRITIC[0]
DESCRIPTION = ("task", "algorithm", "steps", "seed", "settings", "reward_weights")
"""Entries of a card that do not depend on a measurement."""
PACKAGES = ("mujoco", "myosuite", "myo-sim", "stable-baselines3", "torch")
"""Packages whose version may change an episode."""
RULES = ("final", "held", "once")
"""Rules of success, as in acgd/tasks/success.py."""


def measure(request: CardRequest, inputs: Inputs, ctx: Context) -> None:
    """{expert} -> card.json, curve.csv.

    The card in zoo/ is copied where it has at least `card.episodes` episodes from the same starts; else the expert is
    measured. ValueError where the expert is not that of zoo/ any more.
    """
    expert, task = inputs["expert"], request.task
    if isinstance(request.expert, ZooSettings):
        source = zoo.folder(task.name)
        zoo_card = read(source)
        if zoo_card["sha256"] != file_digest(expert / POLICY):
            raise ValueError(f"{expert} is not the expert that {source} has now: start the workflow again")
        for note in other_versions(zoo_card):
            print(
                f"warning: {task.name}: {note}: measure it with `python -m acgd zoo evaluate {task.name}`", flush=True
            )
        is_sufficient = zoo_card["episodes"] >= request.card.episodes and zoo_card["start"] == task.start
        description = {name: zoo_card[name] for name in DESCRIPTION}
        card = zoo_card if is_sufficient else description | measurements(expert, task, request.card.episodes)
    else:
        source = expert
        card = describe(request.expert, task, expert) | measurements(expert, task, request.card.episodes)
    write(card, ctx.out)
    shutil.copyfile(source / "curve.csv", ctx.out / "curve.csv")
    with open(source / "curve.csv", newline="") as file:
        for row in csv.DictReader(file):
            values = {name: float(row[name]) for name in (*RULES, "return")}
            ctx.metrics.log(int(row["step"]), **values)


def describe(settings: LearnerSettings, task: TaskConfig, folder: Path) -> dict[str, Any]:
    """The DESCRIPTION entries of the expert in `folder`, which was trained for `task` with `settings`."""
    excluded = ("kind", "seed", "reward_weights")
    return {
        "task": task.name,
        "algorithm": settings.algorithm,
        "steps": Expert.load(folder).meta.get("steps", settings.steps),
        "seed": settings.seed,
        "settings": {name: value for name, value in in_key(settings).items() if name not in excluded},
        "reward_weights": settings.reward_weights,
    }


def measurements(folder: Path, task: TaskConfig, count: int) -> dict[str, Any]:
    """The other entries: success in `count` held-out episodes of `task`, seeds, package versions and digests."""
    rows = episodes(Expert.load(folder), task, SEEDS.expert_card.take(count))
    digests = {"sha256": POLICY, "critic_sha256": CRITIC}
    return {
        "start": task.start,
        "versions": {name: importlib.metadata.version(name) for name in PACKAGES},
        "success": success(rows),
        "return": sum(row["return"] for row in rows) / len(rows),
        "episodes": len(rows),
        "first_seed": rows[0]["seed"],
        **{entry: file_digest(folder / name) for entry, name in digests.items() if (folder / name).is_file()},
    }


def success(rows: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Rule -> number of successes, rate and 95% Wilson interval over `rows`, the results of episodes."""
    counts = {rule: sum(bool(row[rule]) for row in rows) for rule in RULES}
    rates = {rule: wilson(count, len(rows)) for rule, count in counts.items()}
    return {
        rule: {"successes": counts[rule], "rate": rate.rate, "low": rate.low, "high": rate.high}
        for rule, rate in rates.items()
    }


def write(card: dict[str, Any], folder: Path) -> None:
    """Writes card.json with sorted entries."""
    (folder / "card.json").write_text(json.dumps(card, indent=1, sort_keys=True) + "\n")


def read(folder: Path) -> dict[str, Any]:
    """The card in `folder`. FileNotFoundError where a file is missing, ValueError where a digest does not match."""
    if missing_files := [name for name in zoo.FILES if not (folder / name).is_file()]:
        raise FileNotFoundError(
            f"{folder} lacks {', '.join(missing_files)}: restore it from the repository, or use a task of the zoo "
            f"({zoo.tasks_with(zoo.has_expert)})"
        )
    card = json.loads((folder / "card.json").read_text())
    for entry, name in (("sha256", POLICY), ("critic_sha256", CRITIC)):
        if card.get(entry) != (file_digest(folder / name) if (folder / name).is_file() else None):
            raise ValueError(
                f"{folder}/card.json is not the card of the {name} beside it: "
                f"restore both from the repository, or rewrite it with `python -m acgd zoo card {folder.name}`"
            )
    return card


def check(folder: Path) -> dict[str, Any]:
    """The card of a zoo entry. Raises as `read`, and ValueError where the fitted critic is that of another policy."""
    card, critic = read(folder), folder / zoo.CRITIC_FOLDER / zoo.CRITIC[1]
    if critic.is_file() and json.loads(critic.read_text()).get("expert_sha256") != card["sha256"]:
        raise ValueError(
            f"{critic.parent} holds the critic of another policy than {folder / POLICY}: restore both from the "
            "repository, or remove that folder, fit the critic again (critic.kind: fqe) and put its files there"
        )
    return card


def other_versions(card: dict[str, Any]) -> list[str]:
    """Messages on packages whose installed version differs from that of the measurement."""
    return [
        f"{name} {installed} here, {recorded} when it was measured"
        for name, recorded in card["versions"].items()
        if (installed := importlib.metadata.version(name)) != recorded
    ]
