"""The artifacts of a small study, invented: what the report reads, in the files and fields that the stages write."""

import json
from hashlib import sha256
from pathlib import Path

import numpy as np
import pandas as pd
import zarr

from acgd.evaluation.clips import write_mp4
from acgd.reports.settings import ReportConfig, ReportEntry, ReportRequest

TASKS = ("myo/key-turn", "myo/obj-hold", "myo/reach")
RULES = ("final", "held", "once")


class Folder:
    """One artifact being invented."""

    def __init__(
        self, root: Path, stage: str, name: str, request: dict, upstream: dict[str, Path | list[Path]] | None = None
    ) -> None:
        self.path = root / stage / name
        self.path.mkdir(parents=True)
        key = sha256(f"{stage}/{name}".encode()).hexdigest()[:16]
        manifest = {
            "key": key,
            "stage": stage,
            "name": name,
            "request": request,
            "inputs": {role: keys(given) for role, given in (upstream or {}).items()},
            "simulator": {"mujoco": "3.3.0", "myosuite": "3.0.0"},
        }
        self.json("manifest.json", manifest)
        cost = 10 + int(key, 16) % 300
        usage = {
            "started": 1.7e9,
            "wall_s": cost + 0.5,
            "cpu_s": cost * 0.9,
            "peak_rss_bytes": 10**8 * (3 + cost % 20),
            "resumed": False,
        }
        machine = {
            "processor": "A processor",
            "cores": 2,
            "device": "cpu",
            "packages": {"torch": "2.13.0"},
            "revision": "0123456789ab",
        }
        self.json("run.json", usage | machine)

    def json(self, name: str, content: dict) -> None:
        (self.path / name).write_text(json.dumps(content))

    def lines(self, name: str, rows: list[dict]) -> None:
        (self.path / name).write_text("".join(json.dumps(row) + "\n" for row in rows))


def keys(given: Path | list[Path]) -> str | list[str]:
    """Keys of invented artifacts, from their manifests."""
    if isinstance(given, list):
        return [str(keys(one)) for one in given]
    return json.loads((given / "manifest.json").read_text())["key"]


def episode(
    task: str,
    seed: int,
    solved: bool,
    control: str = "none",
    goal: str = "training",
    image: str = "own",
    start: str = "perturbed",
) -> dict:
    label = {"control": control, "task": task, "goal": goal, "image_features": image, "start": start}
    return {
        **label,
        "episode_seed": seed,
        "final": solved,
        "held": solved,
        "once": solved or seed % 3 == 0,
        "steps": 100,
        "return": -3.0,
    }


def study(
    root: Path,
    rates: dict[str, list[float]],
    *,
    seeds: tuple[int, ...] = (0, 1, 2),
    episodes: int = 25,
    guided: tuple[str, ...] = ("acgd",),
    shuffled: float | None = 0.3,
    controls: bool = True,
    features: bool = True,
    clips: bool = False,
    rounds: int = 0,
    reliable_rank: float | None = None,
    config: ReportConfig | None = None,
) -> tuple[ReportRequest, dict[str, list[Path]]]:
    """`rates`: variant -> success per task. Without its images a student has `shuffled` times its success."""
    tasks, rng = TASKS[: len(next(iter(rates.values())))], np.random.default_rng(0)
    slugs, inputs = [task.replace("/", "-") for task in tasks], {}
    inputs["expert"] = [Folder(root, "expert", slug, {"task": {"name": task}}) for slug, task in zip(slugs, tasks)]
    inputs["expert"] = [folder.path for folder in inputs["expert"]]
    for place, task in enumerate(tasks):
        of = {"expert": inputs["expert"][place]}
        inputs.setdefault("card", []).append(card(root, slugs[place], task, of))
        inputs.setdefault("rollouts", []).append(rollouts(root, slugs[place], task, of))
        if guided:
            inputs.setdefault("critic", []).append(critic(root, slugs[place], task, of))
            of = of | {"critic": inputs["critic"][place]}
            skill = (0.75, 0.35, 0.05)[place]
            inputs.setdefault("quality", []).append(quality(root, slugs[place], task, of, rng, skill))
    inputs["backbone"] = [backbone(root, tasks, {"rollouts": inputs["rollouts"]}, privileged=features)]
    if features:
        of = [{"rollouts": path, "backbone": inputs["backbone"][0]} for path in inputs["rollouts"]]
        inputs["features"] = [Folder(root, "features", slug, {}, each).path for slug, each in zip(slugs, of)]
    if controls:
        inputs["controls"] = [control_runs(root, tasks, episodes, {"expert": inputs["expert"]})]
    inputs["codebook"] = [codebook(root, seed, {"rollouts": inputs["rollouts"]}, rng) for seed in seeds]
    entries = []
    for variant, of_tasks in rates.items():
        for at, seed in enumerate(seeds):
            guides = variant in guided
            read = {stage: inputs[stage] for stage in ("rollouts", "features", "critic") if stage in inputs}
            read |= {"codebook": inputs["codebook"][at]}
            if not guides:
                read.pop("critic", None)
            students = inputs.setdefault("student", [])
            evaluations = inputs.setdefault("evaluation", [])
            places = {stage: tuple(range(len(tasks))) for stage in ("expert", "card", "rollouts", "features")}
            places |= {stage: places["expert"] for stage in ("critic", "quality") if guides}
            places |= {"backbone": (0,), "codebook": (at,), "controls": (0,), "student": (), "evaluation": ()}
            for turn in range(rounds + 1):
                if turn:
                    labels = {"student": students[-1], "expert": inputs["expert"]}
                    made = [on_policy(root, variant, seed, turn, task, labels) for task in tasks]
                    places["onpolicy"] = places.get("onpolicy", ()) + added(inputs, "onpolicy", made)
                    read = read | {"student": students[-1], "onpolicy": inputs["onpolicy"][-len(tasks) :]}
                students.append(student(root, variant, seed, turn, tasks, guides, read, rng, reliable_rank))
                places["student"] += (len(students) - 1,)
            run = {"student": students[-1]}
            for image, factor in (("own", 1.0), ("shuffled", shuffled)):
                if factor is not None:
                    scaled = [factor * rate for rate in of_tasks]
                    evaluations.append(evaluation(root, variant, seed, tasks, scaled, episodes, image, run))
                    places["evaluation"] += (len(evaluations) - 1,)
            if clips and at == 0:
                headline = {"evaluation": evaluations[places["evaluation"][0]]}
                places["clips"] = added(inputs, "clips", [filmed(root, variant, seed, tasks, headline, rng)])
            entries.append(
                ReportEntry(
                    variant=variant,
                    seed=seed,
                    artifacts={stage: at for stage, at in places.items() if stage in inputs},
                )
            )
    settings = {
        "name": "demo",
        "tasks": list(tasks),
        "seeds": list(seeds),
        "student": {"training": {"steps": 2000, "batch": 256}},
    }
    request = ReportRequest(
        study="demo", tasks=tasks, entries=tuple(entries), report=config or ReportConfig(), configuration=settings
    )
    return request, dict(sorted(inputs.items()))  # a job's inputs are canonical JSON


def added(inputs: dict[str, list[Path]], stage: str, paths: list[Path]) -> tuple[int, ...]:
    """Places of the paths in the inputs of their stage, after adding them."""
    made = inputs.setdefault(stage, [])
    made += paths
    return tuple(range(len(made) - len(paths), len(made)))


def card(root: Path, slug: str, task: str, upstream: dict) -> Path:
    folder = Folder(root, "card", slug, {"task": {"name": task}}, upstream)
    success = {rule: {"successes": 190, "rate": 0.95, "low": 0.910, "high": 0.973} for rule in RULES}
    folder.json(
        "card.json",
        {
            "task": task,
            "algorithm": "PPO (stable-baselines3)",
            "steps": 2_000_000,
            "start": "perturbed",
            "episodes": 200,
            "success": success,
        },
    )
    steps = np.arange(0, 2_000_001, 100_000)
    curve = {"step": steps, **{rule: 1 - np.exp(-steps / 6e5) for rule in RULES}, "return": steps * 0.0}
    pd.DataFrame(curve).to_csv(folder.path / "curve.csv", index=False)
    return folder.path


def critic(root: Path, slug: str, task: str, upstream: dict) -> Path:
    folder = Folder(root, "critic", slug, {"task": {"name": task}}, upstream)
    rows = [
        {"step": s, "value_loss": 1 / s, "branch_loss": 2 / s, "target_shift": "nan" if s == 1 else 0.1}
        for s in range(1, 2000, 100)
    ]
    folder.lines("metrics.jsonl", rows)
    return folder.path


def quality(root: Path, slug: str, task: str, upstream: dict, rng: np.random.Generator, skill: float) -> Path:
    folder = Folder(root, "quality", slug, {"task": {"name": task}}, upstream)
    rows, ranks = [], []
    for state in range(32):
        returns = 100 + 10 * rng.normal() + rng.normal(size=16)
        q = skill * returns + (1 - skill) * rng.normal(size=16)
        rank = float(pd.Series(q).corr(pd.Series(returns), method="spearman"))
        ranks.append(rank)
        rows += [(state, "near", a, b) for a, b in zip(q, returns, strict=True)]
    pd.DataFrame(rows, columns=["state", "source", "q", "return"]).to_csv(folder.path / "within_state.csv", index=False)
    mean, half = float(np.mean(ranks)), 2.04 * float(np.std(ranks)) / 32**0.5
    within = {"mean": mean, "low": mean - half, "high": mean + half, "states": 32, "candidates": 16}
    gain = {"critic": 0.01, "simulator": 0.02}
    others = {
        "bellman_error": 0.11,
        "rank_correlation_monte_carlo": 0.93,
        "spread": 12.5,
        "simulator_steps": 50_000,
        "gain_of_best_candidate": gain,
    }
    folder.json("quality.json", {"within_state": within, "within_state_near": {**within, "candidates": 12}, **others})
    return folder.path


def backbone(root: Path, tasks: tuple[str, ...], upstream: dict, privileged: bool) -> Path:
    folder = Folder(root, "backbone", "privileged", {}, upstream if privileged else None)
    rows = [
        {
            "step": s,
            "loss": 2 / (1 + s / 100),
            "r2/myo/key-turn/key": 1 - 1 / (1 + s / 200),
            "r2/myo/key-turn/turn": 0.5,
        }
        for s in range(0, 2000, 100)
    ]
    folder.lines("metrics.jsonl", rows)
    seen = {"key": {"r2": 0.97, "rmse": 0.002}, "turn": {"r2": 0.41, "rmse": 0.1}, "fixed": {"r2": None, "rmse": 0.0}}
    about = {"kind": "privileged", "dim": 64, "tasks": {task: seen for task in tasks}}
    folder.json("backbone.json", about if privileged else {"kind": "scratch", "dim": 64})
    return folder.path


def on_policy(root: Path, variant: str, seed: int, turn: int, task: str, upstream: dict) -> Path:
    name = f"{task.replace('/', '-')}-{variant}-seed-{seed}-round-{turn}"
    folder = Folder(root, "onpolicy", name, {"task": {"name": task}, "seed": seed, "round": turn}, upstream)
    folder.json("summary.json", {"frames": 400, "environment_steps": 500, "expert_queries": 400})
    return folder.path


def rollouts(root: Path, slug: str, task: str, upstream: dict) -> Path:
    folder = Folder(root, "rollouts", slug, {"task": {"name": task}}, upstream)
    images = np.tile(np.linspace(60, 220, 84, dtype=np.uint8)[:, None, None], (2, 1, 84, 3))
    zarr.open_group(folder.path / "rollouts.zarr", mode="w").create_array("final_image", data=images)
    folder.json(
        "summary.json",
        {"demonstrations": 2, "failures": 1, "attempts": 3, "success": 2 / 3, "frames": 200, "environment_steps": 300},
    )
    return folder.path


def codebook(root: Path, seed: int, upstream: dict, rng: np.random.Generator) -> Path:
    folder = Folder(root, "codebook", f"seed-{seed}", {"seed": seed}, upstream)
    errors = {
        "reconstruction": {"training": 0.041, "validation": 0.052},
        "shuffled": {"training": 0.12, "validation": 0.131},
        "shuffled_ratio": 2.5,
    }
    folder.json(
        "health.json", {"perplexity": [12.0, 13.5, 9.75, 14.1], "codes": 16, "bits": 14.5, "best_step": 1800, **errors}
    )
    rows = [
        {
            "step": s,
            "l_act": 3 / (1 + s / 300),
            "l_code": 1.0 - s / 4000,
            "l_usage": 0.2,
            "validation_loss": 0.2 / (1 + s / 500) + 0.01 * rng.random(),
        }
        for s in range(100, 2001, 100)
    ]
    folder.lines("metrics.jsonl", rows)
    return folder.path


def student(
    root: Path,
    variant: str,
    seed: int,
    turn: int,
    tasks: tuple[str, ...],
    guided: bool,
    upstream: dict,
    rng: np.random.Generator,
    reliable_rank: float | None,
) -> Path:
    gate = {"gate": "one"} if reliable_rank is None else {"gate": "reliable", "reliable_rank": reliable_rank}
    guidance = {"kind": "critic", **gate} if guided else {"kind": "none"}
    asks = {"seed": seed, "round": turn, "training": {"precision": "bfloat16"}, "guidance": guidance}
    folder = Folder(root, "student", f"{variant}-seed-{seed}-round-{turn}", asks, upstream)
    ratio = {task: (0.2, 0.06, 0.004)[place] for place, task in enumerate(tasks)}
    notes = {
        task: {"gate": 1.0, "gradient_ratio": value, "counts_as_guidance": value >= 0.01}
        for task, value in ratio.items()
    }
    measured = {"counts_from": 0.01, "tasks": notes} if guided else {}
    folder.json("student.json", {"tasks": list(tasks), "seed": seed, "guidance": measured})
    rows = []
    for step in range(100, 2001, 100):
        fall = 1 / (1 + step / 400) + 0.03 * rng.random()
        row = {
            "step": step,
            "l_act": 4 * fall,
            "l_lat": 2.7 * fall,
            "loss": 7 * fall,
            "gradient_norm": 3 * fall,
            "learning_rate": 1e-3,
        }
        if guided:
            row |= {
                "l_distill": -fall,
                **{f"guidance_ratio/{task}": value * (1 + 0.3 * rng.random()) for task, value in ratio.items()},
            }
        if step % 200 == 0:
            row |= {
                "validation_loss": 6 * fall + 0.3,
                "validation_plan_error": 0.3 * fall,
                "validation_code_accuracy": 1 - fall,
                "validation_l_act": fall,
            }
        rows.append(row)
    folder.lines("metrics.jsonl", rows)
    return folder.path


def evaluation(
    root: Path,
    variant: str,
    seed: int,
    tasks: tuple[str, ...],
    rates: list[float],
    episodes: int,
    image: str,
    upstream: dict,
) -> Path:
    condition = {"goal": "training", "image_features": image, "start": None}
    folder = Folder(
        root, "evaluation", f"{variant}-seed-{seed}-{image}", {"seed": seed, "condition": condition}, upstream
    )
    rows = [
        episode(task, i, solved, image=image)
        for task, rate in zip(tasks, rates, strict=True)
        for i, solved in enumerate(outcomes(rate, episodes, seed))
    ]
    folder.lines("episodes.jsonl", rows)
    return folder.path


def filmed(
    root: Path, variant: str, seed: int, tasks: tuple[str, ...], upstream: dict, rng: np.random.Generator
) -> Path:
    folder = Folder(root, "clips", f"{variant}-seed-{seed}", {}, upstream)
    frames = rng.integers(40, 220, (12, 1, 1, 3), dtype=np.uint8) * np.ones((1, 64, 64, 1), np.uint8)
    for task in tasks:
        write_mp4(folder.path / f"{task.replace('/', '-')}-success.mp4", frames, 10)
    return folder.path


def outcomes(rate: float, episodes: int, seed: int) -> list[bool]:
    """Exactly round(rate * episodes) successes, spread differently for each student seed."""
    solved = np.zeros(episodes, bool)
    solved[: round(rate * episodes)] = True
    return [bool(met) for met in np.roll(solved, 3 * seed)]


def control_runs(root: Path, tasks: tuple[str, ...], episodes: int, upstream: dict) -> Path:
    folder = Folder(root, "controls", "controls", {}, upstream)
    rates = {"replay": 0.2, "replay-nearest": 0.4, "expert": 0.96}
    rows = [
        episode(task, i, solved, control=control, goal="none", image="none")
        for task in tasks
        for control, rate in rates.items()
        for i, solved in enumerate(outcomes(rate, episodes, 0))
    ]
    rows += [
        episode(task, 0, True, control="expert-nominal", goal="none", image="none", start="nominal") for task in tasks
    ]
    folder.lines("episodes.jsonl", rows)
    return folder.path
