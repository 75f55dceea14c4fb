"""The card stage: what an expert is, how it was trained, and how well it does on held-out seeds."""

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
"""Entries of a card that no measurement changes."""
PACKAGES = ("mujoco", "myosuite", "myo-sim", "stable-baselines3", "torch")
"""Packages whose version may change what a policy does in an episode."""
RULES = ("final", "held", "once")


def measure(request: CardRequest, inputs: Inputs, ctx: Context) -> None:
    """{expert} -> card.json, curve.csv."""
    expert, task = inputs["expert"], request.task
    if isinstance(request.expert, ZooSettings):
        source = zoo.folder(task.name)
        known = read(source)
        if known["sha256"] != file_digest(expert / POLICY):
            raise ValueError(f"{expert} is not the expert that {source} has now: start the workflow again")
        for note in other_versions(known):
            print(
                f"warning: {task.name}: {note}: measure it with `python -m acgd zoo evaluate {task.name}`", flush=True
            )
        serves = known["episodes"] >= request.card.episodes and known["start"] == task.start
        described = {name: known[name] for name in DESCRIPTION}
        card = known if serves else described | measured(expert, task, request.card.episodes)
    else:
        source = expert
        card = described_by(request.expert, task, expert) | measured(expert, task, request.card.episodes)
    write(card, ctx.out)
    shutil.copyfile(source / "curve.csv", ctx.out / "curve.csv")
    with open(source / "curve.csv", newline="") as file:
        for row in csv.DictReader(file):
            shown = {name: float(row[name]) for name in (*RULES, "return")}
            ctx.metrics.log(int(row["step"]), **shown)


def described_by(settings: LearnerSettings, task: TaskConfig, folder: Path) -> dict[str, Any]:
    """DESCRIPTION of the expert in `folder`, which was trained for `task` with `settings`."""
    apart = ("kind", "seed", "reward_weights")
    return {
        "task": task.name,
        "algorithm": settings.algorithm,
        "steps": Expert.load(folder).meta.get("steps", settings.steps),
        "seed": settings.seed,
        "settings": {name: value for name, value in in_key(settings).items() if name not in apart},
        "reward_weights": settings.reward_weights,
    }


def measured(folder: Path, task: TaskConfig, count: int) -> dict[str, Any]:
    """Success of the expert in `folder` in `count` held-out episodes of `task`, with what it was measured on."""
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
    """Successes, rate and 95% Wilson interval of episodes, by rule."""
    counts = {rule: sum(bool(row[rule]) for row in rows) for rule in RULES}
    rates = {rule: wilson(count, len(rows)) for rule, count in counts.items()}
    return {
        rule: {"successes": counts[rule], "rate": rate.rate, "low": rate.low, "high": rate.high}
        for rule, rate in rates.items()
    }


def write(card: dict[str, Any], folder: Path) -> None:
    """card.json, its entries in alphabetical order."""
    (folder / "card.json").write_text(json.dumps(card, indent=1, sort_keys=True) + "\n")


def read(folder: Path) -> dict[str, Any]:
    """The card in `folder`. Raises FileNotFoundError or ValueError where it is not that of the weights beside it."""
    if absent := [name for name in zoo.FILES if not (folder / name).is_file()]:
        raise FileNotFoundError(
            f"{folder} lacks {', '.join(absent)}: restore it from the repository, or use a task of the zoo "
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
    """The card of an entry of the zoo. Raises as `read` does, and where the fitted critic is not that of the policy."""
    card, critic = read(folder), folder / zoo.CRITIC_FOLDER / zoo.CRITIC[1]
    if critic.is_file() and json.loads(critic.read_text()).get("expert_sha256") != card["sha256"]:
        raise ValueError(
            f"{critic.parent} holds the critic of another policy than {folder / POLICY}: restore both from the "
            "repository, or remove that folder, fit the critic again (critic.kind: fqe) and put its files there"
        )
    return card


def other_versions(card: dict[str, Any]) -> list[str]:
    """Packages whose installed version is not that of the measurement: success may differ."""
    return [
        f"{name} {here} here, {then} when it was measured"
        for name, then in card["versions"].items()
        if (here := importlib.metadata.version(name)) != then
    ]
