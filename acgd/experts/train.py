"""The expert stage: take a trained expert from the zoo, or train one."""

import hashlib
import importlib.metadata
import json
import shutil
from pathlib import Path

from scipy.stats import binomtest

from acgd.experts.policy import Expert
from acgd.experts.settings import ExpertRequest
from acgd.experts.success import episodes
from acgd.experts.zoo import CRITIC, CRITIC_FOLDER, FILES
from acgd.experts.zoo import ROOT as ZOO
from acgd.nn.q_ensemble import META, WEIGHTS
from acgd.simulate.seeds import SEEDS
from acgd.store.stage import Context, Inputs
from acgd.store.versions import SIMULATOR
from acgd.tasks.spec import TASKS

ALGORITHMS = {"ppo": "PPO (stable-baselines3)", "sac": "SAC", "dagger": "DAgger"}


def train(config: ExpertRequest, inputs: Inputs, ctx: Context) -> None:
    """Write policy.safetensors, policy.json, card.json and curve.csv of one expert; SAC's own critics beside them."""
    if config.expert.source == "zoo":
        take(TASKS[config.task.name].slug, ctx)
        return
    from acgd.experts.curve import write_curve

    expert, points = _learn(config)(config, ctx.state, ctx.metrics, ctx.progress, ctx.device)
    expert.save(ctx.out)
    for name in CRITIC:
        if (ctx.state / "best" / name).is_file():
            shutil.copyfile(ctx.state / "best" / name, ctx.out / name)
    write_curve(points, ctx.out / "curve.csv")
    write_card(card(config, ctx.out), ctx.out)


def _learn(config: ExpertRequest):
    """The algorithm's training function; only its own libraries are imported."""
    if config.expert.algorithm == "sac":
        from acgd.experts.sac.learn import train_sac

        return train_sac
    if config.expert.algorithm == "dagger":
        from acgd.experts.muscle.learn import train_dagger

        return train_dagger
    from acgd.experts.ppo.learn import train_ppo

    return train_ppo


def take(slug: str, ctx: Context) -> None:
    """Copy zoo/<slug>, after checking that the card belongs to the weights."""
    folder = ZOO / slug
    for note in other_versions(check(folder)):
        print(f"warning: {slug}: {note}: re-evaluate it with `python -m acgd zoo evaluate {slug}`", flush=True)
    for name in (*FILES, *CRITIC):
        if (folder / name).is_file():
            shutil.copyfile(folder / name, ctx.out / name)
    for line in (folder / "curve.csv").read_text().splitlines()[1:]:
        step, final, held, once, total = line.split(",")[:5]
        ctx.metrics.log(int(step), final=float(final), held=float(held), once=float(once), **{"return": float(total)})


def check(folder: Path) -> dict:
    """The card of a zoo entry. Raises FileNotFoundError or ValueError where the weights do not fit the card, or the fitted critic not the weights."""
    missing = [name for name in FILES if not (folder / name).is_file()]
    if missing:
        have = sorted(path.parent.name for path in ZOO.glob("*/card.json"))
        raise FileNotFoundError(
            f"{folder} lacks {', '.join(missing)}: set expert.source to train, or use a task of the zoo ({', '.join(have)})"
        )
    found = json.loads((folder / "card.json").read_text())
    for entry, name in (("sha256", "policy.safetensors"), ("critic_sha256", WEIGHTS)):
        if found.get(entry) != (sha256(folder / name) if (folder / name).is_file() else None):
            raise ValueError(
                f"{folder}/card.json is not the card of the {name} beside it: "
                f"restore both from the repository, or rewrite it with `python -m acgd zoo card {folder.name}`"
            )
    fitted = folder / CRITIC_FOLDER / META
    if fitted.is_file() and json.loads(fitted.read_text()).get("expert_sha256") != found["sha256"]:
        raise ValueError(
            f"{fitted.parent} holds the critic of another policy than {folder}/policy.safetensors: restore both from the repository, "
            "or take that folder away, fit the critic again (critic.source: fqe) and put the files of that artifact there"
        )
    return found


def other_versions(found: dict) -> list[str]:
    """What a card was measured with and is not installed: success may differ."""
    return [
        f"{name} {have} here, {trained} in training"
        for name, trained in found["versions"].items()
        if (have := importlib.metadata.version(name)) != trained
    ]


def card(config: ExpertRequest, folder: Path) -> dict:
    """Measure the expert in `folder` on held-out seeds: what it is, how it was trained, how well it does."""
    expert = Expert.load(folder)
    rows = episodes(expert, config.task, SEEDS.expert_card.take(config.expert.card_episodes))
    settings = config.expert
    return {
        "task": config.task.name,
        "algorithm": ALGORITHMS[settings.algorithm],
        "steps": expert.meta.get("steps", settings.learner.steps),
        "seed": settings.seed,
        "settings": settings.learner.model_dump(),
        "reward_weights": settings.reward_weights,
        "start": config.task.start,
        "versions": {name: importlib.metadata.version(name) for name in (*SIMULATOR, "stable-baselines3", "torch")},
        "success": {rule: wilson([row[rule] for row in rows]) for rule in ("final", "held", "once")},
        "return": sum(row["return"] for row in rows) / len(rows),
        "episodes": len(rows),
        "first_seed": rows[0]["seed"],
        "sha256": sha256(folder / "policy.safetensors"),
    } | ({"critic_sha256": sha256(folder / WEIGHTS)} if (folder / WEIGHTS).is_file() else {})


def wilson(outcomes: list[bool]) -> dict:
    """Rate with its 95% Wilson interval."""
    n, k = len(outcomes), int(sum(outcomes))
    interval = binomtest(k, n).proportion_ci(0.95, method="wilson")
    return {"successes": k, "rate": k / n, "low": float(interval.low), "high": float(interval.high)}


def write_card(content: dict, folder: Path) -> None:
    """card.json in a stable order."""
    (folder / "card.json").write_text(json.dumps(content, indent=1, sort_keys=True) + "\n")


def sha256(path: Path) -> str:
    """Checksum of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
