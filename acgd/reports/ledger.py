"""What a study cost, artifact by artifact."""

from collections.abc import Mapping, Sequence

import pandas as pd

from acgd.reports.artifact import Artifact
from acgd.reports.settings import ReportEntry, ReportRequest

STAGES = ("expert", "critic", "rollouts", "backbone", "features", "codebook", "student", "evaluation", "controls")
PER_TASK = ("expert", "critic", "rollouts", "features")
COLUMNS = ["stage", "name", "variants", "key", "wall_s", "cpu_s", "peak_rss_bytes", "bytes"]


def cost(request: ReportRequest, artifacts: Mapping[str, Sequence[Artifact]]) -> pd.DataFrame:
    """stages.csv: one row per artifact. wall_s and peak_rss_bytes are of the run that made it, perhaps for an earlier study."""
    rows = []
    for stage in STAGES:
        for place, artifact in enumerate(artifacts.get(stage, ())):
            users = [entry for entry in request.entries if place in places(entry, stage)]
            variants = list(dict.fromkeys(entry.variant for entry in users))
            run = artifact.run
            measured = [run.get("wall_s"), run.get("cpu_s"), run.get("peak_rss_bytes")]
            rows.append(
                (
                    stage,
                    _name(request, users, stage, place),
                    ", ".join(variants),
                    artifact.key,
                    *measured,
                    _bytes(artifact),
                )
            )
    frame = pd.DataFrame(rows, columns=COLUMNS)
    return frame.astype({"wall_s": float, "cpu_s": float, "peak_rss_bytes": float})


def per_stage(cost: pd.DataFrame) -> pd.DataFrame:
    """Sums over a stage's artifacts, in the order of the chain; memory is the greatest."""
    named = dict(
        artifacts=("key", "size"), wall_s=("wall_s", "sum"), longest_s=("wall_s", "max"), cpu_s=("cpu_s", "sum")
    )
    return (
        cost.groupby("stage", sort=False)
        .agg(**named, peak_rss_bytes=("peak_rss_bytes", "max"), bytes=("bytes", "sum"))
        .reset_index()
    )


def places(entry: ReportEntry, stage: str) -> tuple[int, ...]:
    """Where the artifacts of one entry stand in the inputs of that stage."""
    value = getattr(entry, stage)
    if value is None:
        return ()
    return value if isinstance(value, tuple) else (value,)


def _name(request: ReportRequest, users: Sequence[ReportEntry], stage: str, place: int) -> str:
    """The task of a per-task artifact; the student seeds of the others, where they depend on one."""
    if not users:
        return ""
    if stage in PER_TASK:
        return request.tasks[getattr(users[0], stage).index(place)]
    seeds = dict.fromkeys(str(entry.seed) for entry in users)
    return f"seed {', '.join(seeds)}" if stage in ("codebook", "student", "evaluation") else ""


def _bytes(artifact: Artifact) -> int:
    return sum(file.stat().st_size for file in artifact.path.rglob("*") if file.is_file())
