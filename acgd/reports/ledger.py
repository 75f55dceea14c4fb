"""Costs of a study: per artifact, per stage and per student."""

from collections.abc import Sequence

import pandas as pd

from acgd.reports.artifact import Artifact, Artifacts
from acgd.reports.settings import ReportEntry, ReportRequest

COLUMNS = ["stage", "name", "variants", "key", "wall_s", "cpu_s", "peak_rss_bytes", "bytes"]
BUDGET = ["variant", "seed", "demonstration_steps", "on_policy_steps", "on_policy_queries", "cpu_s"]


def cost(request: ReportRequest, artifacts: Artifacts) -> pd.DataFrame:
    """stages.csv: one row per artifact. Times (s) and memory (bytes) are those of the run that made it."""
    rows = []
    for stage, made in artifacts.items():
        for place, artifact in enumerate(made):
            users = [entry for entry in request.entries if place in entry.places(stage)]
            variants = ", ".join(dict.fromkeys(entry.variant for entry in users))
            usage = [artifact.run.get(name) for name in ("wall_s", "cpu_s", "peak_rss_bytes")]
            rows.append((stage, label(request, artifact), variants, artifact.key, *usage, artifact.size))
    frame = pd.DataFrame(rows, columns=COLUMNS)
    return frame.astype({"wall_s": float, "cpu_s": float, "peak_rss_bytes": float})


def per_stage(cost: pd.DataFrame) -> pd.DataFrame:
    """Sums over a stage's artifacts, in the order of the chain. peak_rss_bytes is the maximum."""
    sums = dict(
        artifacts=("key", "size"), wall_s=("wall_s", "sum"), longest_s=("wall_s", "max"), cpu_s=("cpu_s", "sum")
    )
    return (
        cost.groupby("stage", sort=False)
        .agg(**sums, peak_rss_bytes=("peak_rss_bytes", "max"), bytes=("bytes", "sum"))
        .reset_index()
    )


def budget(request: ReportRequest, artifacts: Artifacts) -> pd.DataFrame:
    """budget.csv: costs of each student.

    demonstration_steps: environment steps of the demonstrations, including failures. on_policy_steps,
    on_policy_queries: environment steps and expert queries of all rounds. cpu_s: processor time of the last round's
    student and of all artifacts upstream of it. An artifact that several students share counts fully for each.
    """
    rows = []
    for entry in request.entries:
        demonstrations = _total(used(entry, "rollouts", artifacts), "environment_steps")
        rounds = used(entry, "onpolicy", artifacts)
        counts = [_total(rounds, "environment_steps"), _total(rounds, "expert_queries")]
        seconds = sum(artifact.run.get("cpu_s", 0.0) for artifact in chain_of(entry, artifacts))
        rows.append((entry.variant, entry.seed, demonstrations, *counts, seconds))
    return pd.DataFrame(rows, columns=BUDGET)


def chain_of(entry: ReportEntry, artifacts: Artifacts) -> list[Artifact]:
    """The student of the last round and all artifacts upstream of it, by the keys in the manifests."""
    by_key = {artifact.key: artifact for made in artifacts.values() for artifact in made}
    pending = [artifact.key for artifact in used(entry, "student", artifacts)[-1:]]
    chain: dict[str, Artifact] = {}
    while pending:
        key = pending.pop()
        if key in by_key and key not in chain:
            chain[key] = by_key[key]
            pending += by_key[key].upstream
    return list(chain.values())


def used(entry: ReportEntry, stage: str, artifacts: Artifacts) -> list[Artifact]:
    """The artifacts of one stage that an entry lists, in the entry's order."""
    return [artifacts[stage][place] for place in entry.places(stage)]


def label(request: ReportRequest, artifact: Artifact) -> str:
    """Label of an artifact within its stage: task, student seed, round, condition."""
    settings = artifact.request
    by_slug = {task.replace("/", "-"): task for task in request.tasks}
    task = (settings.get("task") or {}).get("name") or by_slug.get(artifact.manifest.get("name", ""), "")
    seed = f"seed {settings['seed']}" if "seed" in settings else ""
    number = f"round {settings['round']}" if settings.get("round") else ""
    condition = ", ".join(f"{name} {value}" for name, value in (settings.get("condition") or {}).items() if value)
    return ", ".join(part for part in (task, seed, number, condition) if part)


def _total(artifacts: Sequence[Artifact], name: str) -> int:
    """Sum of an entry of summary.json over artifacts."""
    return sum(artifact.json("summary.json").get(name, 0) for artifact in artifacts)
