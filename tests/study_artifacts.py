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

    def __init__(self, root: Path, stage: str, name: str, request: dict) -> None:
        self.path = root / stage / name
        self.path.mkdir(parents=True)
        key = sha256(f"{stage}/{name}".encode()).hexdigest()[:16]
        manifest = {
            "key": key,
            "stage": stage,
            "name": name,
            "request": request,
            "inputs": {},
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
    config: ReportConfig | None = None,
) -> tuple[ReportRequest, dict[str, list[Path]]]:
    """`rates`: variant -> success per task. Student seed s gains a hundredth; `shuffled` is what success becomes times, without images."""
    tasks, rng = TASKS[: len(next(iter(rates.values())))], np.random.default_rng(0)
    inputs: dict[str, list[Path]] = {
        stage: [] for stage in ("expert", "critic", "rollouts", "backbone", "codebook", "student", "evaluation")
    }
    for place, task in enumerate(tasks):
        slug = task.replace("/", "-")
        inputs["expert"].append(expert(root, slug, task))
        inputs["rollouts"].append(rollouts(root, slug, task))
        if guided:
            inputs["critic"].append(critic(root, slug, task, rng, skill=(0.75, 0.35, 0.05)[place]))
    if features:
        inputs["features"] = [Folder(root, "features", task.replace("/", "-"), {}).path for task in tasks]
    backbone = Folder(root, "backbone", "privileged", {})
    backbone.lines(
        "metrics.jsonl",
        [
            {
                "step": s,
                "loss": 2 / (1 + s / 100),
                "r2/myo/key-turn/key": 1 - 1 / (1 + s / 200),
                "r2/myo/key-turn/turn": 0.5,
            }
            for s in range(0, 2000, 100)
        ],
    )
    seen = {"key": {"r2": 0.97, "rmse": 0.002}, "turn": {"r2": 0.41, "rmse": 0.1}, "fixed": {"r2": None, "rmse": 0.0}}
    backbone.json(
        "backbone.json",
        {"kind": "privileged", "dim": 64, "tasks": {task: seen for task in tasks}}
        if features
        else {"kind": "scratch", "dim": 64},
    )
    inputs["backbone"].append(backbone.path)
    if controls:
        inputs["controls"] = [control_runs(root, tasks, episodes)]
    entries = []
    for seed in seeds:
        inputs["codebook"].append(codebook(root, seed, rng))
    for variant, of_tasks in rates.items():
        for at, seed in enumerate(seeds):
            inputs["student"].append(student(root, variant, seed, tasks, variant in guided, rng))
            inputs["evaluation"].append(
                evaluation(root, variant, seed, tasks, of_tasks, episodes, shuffled, rng, clips and at == 0)
            )
            whole = tuple(range(len(tasks)))
            places = {
                "expert": whole,
                "rollouts": whole,
                "critic": whole if variant in guided else (),
                "features": whole if features else (),
            }
            last = len(inputs["student"]) - 1
            entries.append(
                ReportEntry(
                    variant=variant,
                    seed=seed,
                    student=last,
                    evaluation=last,
                    codebook=at,
                    backbone=0,
                    controls=0 if controls else None,
                    **places,
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
    return request, {stage: paths for stage, paths in inputs.items() if paths}


def expert(root: Path, slug: str, task: str) -> Path:
    folder = Folder(root, "expert", slug, {"task": {"name": task}})
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


def critic(root: Path, slug: str, task: str, rng: np.random.Generator, skill: float) -> Path:
    folder = Folder(root, "critic", slug, {"task": {"name": task}})
    rows, found = [], []
    for state in range(32):
        returns = 100 + 10 * rng.normal() + rng.normal(size=16)
        q = skill * returns + (1 - skill) * rng.normal(size=16)
        rank = float(pd.Series(q).corr(pd.Series(returns), method="spearman"))
        found.append(rank)
        rows += [(state, "near", a, b) for a, b in zip(q, returns, strict=True)]
    pd.DataFrame(rows, columns=["state", "source", "q", "return"]).to_csv(folder.path / "within_state.csv", index=False)
    mean, half = float(np.mean(found)), 2.04 * float(np.std(found)) / 32**0.5
    within = {"mean": mean, "low": mean - half, "high": mean + half, "states": 32, "candidates": 16}
    folder.lines(
        "metrics.jsonl",
        [
            {"step": s, "value_loss": 1 / s, "branch_loss": 2 / s, "target_shift": "nan" if s == 1 else 0.1}
            for s in range(1, 2000, 100)
        ],
    )
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


def rollouts(root: Path, slug: str, task: str) -> Path:
    folder = Folder(root, "rollouts", slug, {"task": {"name": task}})
    images = np.tile(np.linspace(60, 220, 84, dtype=np.uint8)[:, None, None], (2, 1, 84, 3))
    zarr.open_group(folder.path / "rollouts.zarr", mode="w").create_array("final_image", data=images)
    folder.json(
        "summary.json",
        {"demonstrations": 2, "failures": 1, "attempts": 3, "success": 2 / 3, "frames": 200, "environment_steps": 300},
    )
    return folder.path


def codebook(root: Path, seed: int, rng: np.random.Generator) -> Path:
    folder = Folder(root, "codebook", f"seed-{seed}", {})
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
    root: Path, variant: str, seed: int, tasks: tuple[str, ...], guided: bool, rng: np.random.Generator
) -> Path:
    folder = Folder(root, "student", f"{variant}-seed-{seed}", {})
    ratio = {task: (0.2, 0.06, 0.004)[place] for place, task in enumerate(tasks)}
    told = {
        task: {"gate": 1.0, "gradient_ratio": value, "counts_as_guidance": value >= 0.01}
        for task, value in ratio.items()
    }
    folder.json("student.json", {"tasks": list(tasks), "seed": seed, "guidance": told if guided else {}})
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
    shuffled: float | None,
    rng: np.random.Generator,
    clips: bool,
) -> Path:
    folder = Folder(root, "evaluation", f"{variant}-seed-{seed}", {})
    rows = [
        episode(task, i, solved)
        for task, rate in zip(tasks, rates, strict=True)
        for i, solved in enumerate(outcomes(rate, episodes, seed))
    ]
    if shuffled is not None:
        for task, rate in zip(tasks, rates, strict=True):
            rows += [
                episode(task, i, solved, image="shuffled")
                for i, solved in enumerate(outcomes(rate * shuffled, episodes, seed))
            ]
    folder.lines("episodes.jsonl", rows)
    if clips:
        frames = rng.integers(40, 220, (12, 1, 1, 3), dtype=np.uint8) * np.ones((1, 64, 64, 1), np.uint8)
        for task in tasks:
            write_mp4(folder.path / "clips" / f"{task.replace('/', '-')}-success.mp4", frames, 10)
    return folder.path


def outcomes(rate: float, episodes: int, seed: int) -> list[bool]:
    """Exactly round(rate * episodes) successes, spread differently for each student seed."""
    solved = np.zeros(episodes, bool)
    solved[: round(rate * episodes)] = True
    return [bool(met) for met in np.roll(solved, 3 * seed)]


def control_runs(root: Path, tasks: tuple[str, ...], episodes: int) -> Path:
    folder = Folder(root, "controls", "controls", {})
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
