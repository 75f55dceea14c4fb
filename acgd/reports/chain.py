"""Tables of experts, demonstrations, critics, backbones, codebooks and guidance."""

from collections.abc import Iterable

import numpy as np
import pandas as pd

from acgd.critics.ranks import rank_correlations
from acgd.reports.artifact import Artifact, Artifacts
from acgd.reports.ledger import used
from acgd.reports.settings import ReportRequest

CRITICS = [
    "task", "variants", "within_state_mean", "within_state_low", "within_state_high", "states", "candidates",
    "near_mean", "near_low", "near_high",
    "rank_correlation_monte_carlo", "bellman_error", "gain_critic", "gain_simulator", "spread",
    "simulator_steps", "key",
]  # fmt: skip
GATES = ["variant", "seed", "task", "gate", "gradient_ratio", "counts_as_none", "counts_from", "reliable_rank"]


def per_task(request: ReportRequest, stage: str, artifacts: Artifacts) -> list[tuple[str, str, Artifact]]:
    """(task, variants, artifact) for each artifact of a per-task stage, in the order of the tasks."""
    rows = []
    for task_id, task in enumerate(request.tasks):
        users: dict[int, list[str]] = {}
        for entry in request.entries:
            places = entry.places(stage)
            if places:
                users.setdefault(places[task_id], []).append(entry.variant)
        rows += [(task, _joined(variants), artifacts[stage][place]) for place, variants in users.items()]
    return rows


def labelled(request: ReportRequest, stage: str, artifacts: Artifacts) -> dict[str, tuple[str, Artifact]]:
    """Label -> (variants, artifact). The label is the task, with the variants if the task has several artifacts."""
    rows = per_task(request, stage, artifacts)
    tasks = [task for task, _, _ in rows]
    return {
        task if tasks.count(task) == 1 else f"{task} ({variants})": (variants, artifact)
        for task, variants, artifact in rows
    }


def experts(request: ReportRequest, artifacts: Artifacts) -> pd.DataFrame:
    """experts.csv: one row per expert's card, with the success on the card's held-out seeds."""
    rows = []
    for task, variants, artifact in per_task(request, "card", artifacts):
        card = artifact.json("card.json")
        success = card.get("success", {}).get(request.report.success, {})
        training = [card.get(name) for name in ("algorithm", "steps", "start", "episodes")]
        figures = [success.get(name) for name in ("successes", "rate", "low", "high")]
        rows.append((task, variants, *training, *figures, artifact.key))
    columns = ["task", "variants", "algorithm", "steps", "start", "episodes", "successes", "rate", "low", "high", "key"]
    return pd.DataFrame(rows, columns=columns)


def demonstrations(request: ReportRequest, artifacts: Artifacts) -> pd.DataFrame:
    """demonstrations.csv: one row per set of rollouts, from its summary.json."""
    columns = ["demonstrations", "attempts", "failures", "frames", "environment_steps"]
    rows = [
        (task, variants, *(artifact.json("summary.json").get(column) for column in columns), artifact.key)
        for task, variants, artifact in per_task(request, "rollouts", artifacts)
        if artifact.json("summary.json")
    ]
    return pd.DataFrame(rows, columns=["task", "variants", *columns, "key"])


def critics(request: ReportRequest, artifacts: Artifacts) -> pd.DataFrame:
    """critics.csv: one row per critic, from its quality.json."""
    rows = []
    for label, (variants, artifact) in labelled(request, "quality", artifacts).items():
        quality = artifact.json("quality.json")
        within, near, gain = (
            quality.get(name, {}) for name in ("within_state", "within_state_near", "gain_of_best_candidate")
        )
        ranks = [within.get(name) for name in ("mean", "low", "high", "states", "candidates")]
        near_ranks = [near.get(name) for name in ("mean", "low", "high")]
        others = [quality.get(name) for name in ("rank_correlation_monte_carlo", "bellman_error")]
        gains = [gain.get("critic"), gain.get("simulator"), quality.get("spread"), quality.get("simulator_steps")]
        rows.append((label, variants, *ranks, *near_ranks, *others, *gains, artifact.key))
    return pd.DataFrame(rows, columns=CRITICS)


def candidates(request: ReportRequest, artifacts: Artifacts) -> dict[str, pd.DataFrame]:
    """Label -> within_state.csv: one row per state and candidate action. q and return are standardised within a state.

    The spread of returns differs between states. Without the standardisation a few states would dominate the figure.
    """
    tables = {}
    for label, (_, artifact) in labelled(request, "quality", artifacts).items():
        frame = artifact.csv("within_state.csv")
        if len(frame):
            groups = frame.groupby("state")[["q", "return"]]
            spread = groups.transform("std").where(lambda std: std > 0)
            standardised = (frame[["q", "return"]] - groups.transform("mean")) / spread
            tables[label] = frame.assign(q=standardised["q"], **{"return": standardised["return"]})
    return tables


def ranks(candidates: pd.DataFrame) -> np.ndarray:
    """Rank correlation within each state (states,). States whose candidates have equal returns are left out."""
    q, returns = (np.stack([values for _, values in candidates.groupby("state")[name]]) for name in ("q", "return"))
    correlations = rank_correlations(q, returns)
    return correlations[~np.isnan(correlations)]


def backbones(request: ReportRequest, artifacts: Artifacts) -> pd.DataFrame:
    """backbone.csv: R^2 and RMSE of each target of each privileged backbone, on held-out frames.

    r2 is empty for a constant target.
    """
    rows = []
    for place, artifact in enumerate(artifacts.get("backbone", ())):
        variants = _joined(entry.variant for entry in request.entries if place in entry.places("backbone"))
        meta = artifact.json("backbone.json")
        if meta.get("kind") == "privileged":
            rows += [
                (variants, task, target, figures["r2"], figures["rmse"], artifact.key)
                for task, targets in meta["tasks"].items()
                for target, figures in targets.items()
            ]
    return pd.DataFrame(rows, columns=["variants", "task", "target", "r2", "rmse", "key"]).astype(
        {"r2": float, "rmse": float}
    )


def guided_variants(request: ReportRequest, artifacts: Artifacts) -> frozenset[str]:
    """Variants with a student that was trained with guidance."""
    return frozenset(
        entry.variant
        for entry in request.entries
        if any(_settings(student).get("kind", "none") != "none" for student in used(entry, "student", artifacts))
    )


def gates(request: ReportRequest, artifacts: Artifacts) -> pd.DataFrame:
    """guidance.csv: gate and mean gradient ratio of each guided student and task, in the last round.

    counts_as_none: whether the ratio is below counts_from. reliable_rank: threshold of a `reliable` gate; empty for
    another gate.
    """
    rows = []
    for entry in request.entries:
        for student in used(entry, "student", artifacts)[-1:]:
            notes, settings = student.json("student.json").get("guidance", {}), _settings(student)
            reliable_rank = settings.get("reliable_rank") if settings.get("gate") == "reliable" else None
            limits = notes.get("counts_from"), reliable_rank
            for task, note in notes.get("tasks", {}).items():
                measured = note["gate"], note["gradient_ratio"], not note["counts_as_guidance"]
                rows.append((entry.variant, entry.seed, task, *measured, *limits))
    return pd.DataFrame(rows, columns=GATES).astype(
        {"counts_as_none": bool, "counts_from": float, "reliable_rank": float}
    )


def codebooks(request: ReportRequest, artifacts: Artifacts) -> pd.DataFrame:
    """codebook.csv: one row per codebook, from its health.json.

    perplexity: mean over groups. shuffled_ratio: near 1 if the decoder ignores the codes.
    """
    rows = []
    for place, artifact in enumerate(artifacts.get("codebook", ())):
        users = [entry for entry in request.entries if place in entry.places("codebook")]
        health = artifact.json("health.json")
        if not users or not health:
            continue
        names = [_joined(entry.variant for entry in users), _joined(str(entry.seed) for entry in users)]
        perplexity = [min(health["perplexity"]), float(np.mean(health["perplexity"])), max(health["perplexity"])]
        error, shuffled = health["reconstruction"], health["shuffled"]
        errors = [error["training"], error["validation"], shuffled["validation"], health["shuffled_ratio"]]
        sizes = [len(health["perplexity"]), health["codes"]]
        rows.append((*names, *sizes, *perplexity, health["bits"], *errors, artifact.key))
    codes = ["groups", "codes", "perplexity_min", "perplexity", "perplexity_max", "bits"]
    errors = ["error_training", "error_validation", "error_shuffled", "shuffled_ratio"]
    return pd.DataFrame(rows, columns=["variants", "seeds", *codes, *errors, "key"])


def _settings(student: Artifact) -> dict:
    """The section `guidance` of the student's settings."""
    return student.request.get("guidance") or {}


def _joined(names: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(names))
