"""What stands behind the students: experts and how far their critics can be trusted."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from acgd.critics.ranks import rank_correlations
from acgd.reports.artifact import Artifact
from acgd.reports.ledger import places
from acgd.reports.settings import ReportRequest

CRITICS = [
    "task", "variants", "within_state_mean", "within_state_low", "within_state_high", "states", "candidates",
    "near_mean", "near_low", "near_high",
    "rank_correlation_monte_carlo", "bellman_error", "gain_critic", "gain_simulator", "spread", "simulator_steps", "key",
]  # fmt: skip


def used(request: ReportRequest, stage: str, artifacts: Sequence[Artifact]) -> list[tuple[str, str, Artifact]]:
    """(task, variants that use it, artifact) for each artifact of a per-task stage, in the order of the tasks."""
    found = []
    for task_id, task in enumerate(request.tasks):
        owners: dict[int, list[str]] = {}
        for entry in request.entries:
            at = places(entry, stage)
            if at:
                owners.setdefault(at[task_id], []).append(entry.variant)
        found += [(task, ", ".join(dict.fromkeys(variants)), artifacts[place]) for place, variants in owners.items()]
    return found


def labels(rows: Sequence[tuple[str, str, Artifact]]) -> list[str]:
    """The task, and where two variants have different artifacts for it, whose."""
    tasks = [task for task, _, _ in rows]
    return [task if tasks.count(task) == 1 else f"{task} ({variants})" for task, variants, _ in rows]


def experts(request: ReportRequest, artifacts: Sequence[Artifact]) -> pd.DataFrame:
    """experts.csv: one row per expert, with its success on the card's own held-out seeds."""
    rows = []
    for task, variants, artifact in used(request, "expert", artifacts):
        card = artifact.json("card.json")
        success = card.get("success", {}).get(request.report.success, {})
        figures = [success.get(name) for name in ("successes", "rate", "low", "high")]
        rows.append(
            (
                task,
                variants,
                card.get("algorithm"),
                card.get("steps"),
                card.get("start"),
                card.get("episodes"),
                *figures,
                artifact.key,
            )
        )
    columns = ["task", "variants", "algorithm", "steps", "start", "episodes", "successes", "rate", "low", "high", "key"]
    return pd.DataFrame(rows, columns=columns)


def demonstrations(request: ReportRequest, artifacts: Sequence[Artifact]) -> pd.DataFrame:
    """demonstrations.csv: one row per set of rollouts, from its summary.json."""
    columns = ["demonstrations", "attempts", "failures", "frames", "environment_steps"]
    rows = [
        (task, variants, *(artifact.json("summary.json").get(column) for column in columns), artifact.key)
        for task, variants, artifact in used(request, "rollouts", artifacts)
        if artifact.json("summary.json")
    ]
    return pd.DataFrame(rows, columns=["task", "variants", *columns, "key"])


def critics(request: ReportRequest, artifacts: Sequence[Artifact]) -> pd.DataFrame:
    """critics.csv: quality.json of each critic, flat."""
    rows = []
    found = used(request, "critic", artifacts)
    for (_, variants, artifact), label in zip(found, labels(found), strict=True):
        quality = artifact.json("quality.json")
        within, near, gain = (
            quality.get(name, {}) for name in ("within_state", "within_state_near", "gain_of_best_candidate")
        )
        ranks = [within.get(name) for name in ("mean", "low", "high", "states", "candidates")]
        others = [quality.get(name) for name in ("rank_correlation_monte_carlo", "bellman_error")]
        gains = [gain.get("critic"), gain.get("simulator"), quality.get("spread"), quality.get("simulator_steps")]
        rows.append(
            (
                label,
                variants,
                *ranks,
                *(near.get(name) for name in ("mean", "low", "high")),
                *others,
                *gains,
                artifact.key,
            )
        )
    return pd.DataFrame(rows, columns=CRITICS)


def candidates(request: ReportRequest, artifacts: Sequence[Artifact]) -> dict[str, pd.DataFrame]:
    """Label -> within_state.csv: one row per state and candidate action, with q and return standardised within their state.

    States differ in how much the action matters; unscaled, a few of them would be all that a picture shows.
    """
    found = used(request, "critic", artifacts)
    tables = {}
    for (_, _, artifact), label in zip(found, labels(found), strict=True):
        frame = artifact.csv("within_state.csv")
        if len(frame):
            of_state = frame.groupby("state")[["q", "return"]]
            standard = (frame[["q", "return"]] - of_state.transform("mean")) / of_state.transform("std").where(
                lambda std: std > 0
            )
            tables[label] = frame.assign(q=standard["q"], **{"return": standard["return"]})
    return tables


def ranks(candidates: pd.DataFrame) -> np.ndarray:
    """(states,): the rank correlation within each state; states whose candidates all return the same have none."""
    q, returns = (np.stack([values for _, values in candidates.groupby("state")[name]]) for name in ("q", "return"))
    found = rank_correlations(q, returns)
    return found[~np.isnan(found)]


def backbones(request: ReportRequest, artifacts: Sequence[Artifact]) -> pd.DataFrame:
    """backbone.csv: how well each privileged backbone regresses each target from a held-out frame; r2 is empty where nothing varies."""
    rows = []
    for place, artifact in enumerate(artifacts):
        variants = ", ".join(dict.fromkeys(entry.variant for entry in request.entries if entry.backbone == place))
        told = artifact.json("backbone.json")
        if told.get("kind") == "privileged":
            found = [
                (task, target, figures)
                for task, targets in told["tasks"].items()
                for target, figures in targets.items()
            ]
            rows += [
                (variants, task, target, figures["r2"], figures["rmse"], artifact.key)
                for task, target, figures in found
            ]
    return pd.DataFrame(rows, columns=["variants", "task", "target", "r2", "rmse", "key"]).astype(
        {"r2": float, "rmse": float}
    )


def gates(request: ReportRequest, students: Sequence[Artifact]) -> pd.DataFrame:
    """guidance.csv: per guided student and task its gate, the mean ratio of gradient norms, and whether that counts as guidance."""
    rows = []
    for entry in request.entries:
        for task, told in students[entry.student].json("student.json").get("guidance", {}).items():
            rows.append(
                (entry.variant, entry.seed, task, told["gate"], told["gradient_ratio"], not told["counts_as_guidance"])
            )
    return pd.DataFrame(rows, columns=["variant", "seed", "task", "gate", "gradient_ratio", "counts_as_none"]).astype(
        {"counts_as_none": bool}
    )


def codebooks(request: ReportRequest, artifacts: Sequence[Artifact]) -> pd.DataFrame:
    """codebook.csv: health.json of each codebook. perplexity is the mean over groups; shuffled_ratio near 1 means unused codes."""
    rows = []
    for place, artifact in enumerate(artifacts):
        users = [entry for entry in request.entries if entry.codebook == place]
        health = artifact.json("health.json")
        if not users or not health:
            continue
        variants = ", ".join(dict.fromkeys(entry.variant for entry in users))
        seeds = ", ".join(dict.fromkeys(str(entry.seed) for entry in users))
        perplexity = [min(health["perplexity"]), float(np.mean(health["perplexity"])), max(health["perplexity"])]
        error, shuffled = health["reconstruction"], health["shuffled"]
        errors = [error["training"], error["validation"], shuffled["validation"], health["shuffled_ratio"]]
        rows.append(
            (
                variants,
                seeds,
                len(health["perplexity"]),
                health["codes"],
                *perplexity,
                health["bits"],
                *errors,
                artifact.key,
            )
        )
    columns = [
        "variants",
        "seeds",
        "groups",
        "codes",
        "perplexity_min",
        "perplexity",
        "perplexity_max",
        "bits",
        "error_training",
        "error_validation",
    ]
    return pd.DataFrame(rows, columns=[*columns, "error_shuffled", "shuffled_ratio", "key"])
