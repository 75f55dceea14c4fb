"""Learning curves of students, codebooks, critics and backbones. The dicts map columns to the titles of panels."""

from collections.abc import Mapping, Sequence

import pandas as pd

from acgd.reports.artifact import Artifacts
from acgd.reports.ledger import used
from acgd.reports.settings import ReportEntry, ReportRequest

STUDENT = {
    "validation_loss": "validation L_BC",
    "validation_code_accuracy": "validation code accuracy",
    "validation_plan_error": "validation error of the plan",
    "validation_gain": "validation gain, in spreads",
    "l_act": "training L_act",
    "l_lat": "training L_lat",
    "l_distill": "training L_distill",
    "gradient_norm": "gradient norm",
}
CODEBOOK = {
    "validation_loss": "validation reconstruction",
    "l_act": "training L_act",
    "l_code": "training L_code",
    "l_usage": "nats from uniform usage",
}
CRITIC = {
    "value_loss": "regression on y",
    "branch_loss": "regression within states",
    "target_shift": "shift of the targets",
}


def by_variant(request: ReportRequest, stage: str, artifacts: Artifacts) -> dict[str, list[pd.DataFrame]]:
    """Variant -> one frame per student seed, with the rounds of a stage concatenated.

    Curves of an artifact that several variants share belong to the first of them.
    """
    seen: set[tuple[int, ...]] = set()
    runs: dict[str, list[pd.DataFrame]] = {}
    for entry in request.entries:
        places = entry.places(stage)
        if not places or places in seen:
            continue
        seen.add(places)
        frame = joined(entry, stage, artifacts)
        if len(frame):
            runs.setdefault(entry.variant, []).append(frame)
    return runs


def joined(entry: ReportEntry, stage: str, artifacts: Artifacts) -> pd.DataFrame:
    """Curves of an entry's artifacts of one stage. The steps of a round continue those of the previous round."""
    frames, last_step = [], 0
    for artifact in used(entry, stage, artifacts):
        frame = artifact.curves()
        if len(frame):
            frames.append(frame.assign(step=frame["step"] + last_step))
            last_step = int(frames[-1]["step"].max())
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame()


def logged(runs: Mapping[str, Sequence[pd.DataFrame]], columns: Mapping[str, str]) -> dict[str, str]:
    """The columns that at least one run has logged, with their titles."""
    present = {column for frames in runs.values() for frame in frames for column in frame}
    return {column: title for column, title in columns.items() if column in present}


def backbone(request: ReportRequest, artifacts: Artifacts) -> tuple[dict[str, list[pd.DataFrame]], dict[str, str]]:
    """Curves of trained backbones, and the columns to show: the loss, and the mean R^2 of each task."""
    runs = by_variant(request, "backbone", artifacts)
    for frames in runs.values():
        for frame in frames:
            for task in request.tasks:
                targets = [column for column in frame if column.startswith(f"r2/{task}/")]
                if targets:
                    frame[task] = frame[targets].mean(axis=1)
    return runs, logged(runs, {"loss": "training loss", **{task: f"R², {task}" for task in request.tasks}})


def ratios(request: ReportRequest, artifacts: Artifacts) -> dict[tuple[str, str], list[pd.DataFrame]]:
    """(variant, task) -> one frame (step, ratio) per student: gradient norm of guidance over that of imitation."""
    curves: dict[tuple[str, str], list[pd.DataFrame]] = {}
    for entry in request.entries:
        frame = joined(entry, "student", artifacts)
        for task in request.tasks:
            column = f"guidance_ratio/{task}"
            if column in frame:
                line = frame[["step", column]].dropna().rename(columns={column: "ratio"})
                curves.setdefault((entry.variant, task), []).append(line)
    return curves


def table(runs: Mapping[str, Sequence[pd.DataFrame]]) -> pd.DataFrame:
    """curves.csv: one row per logged value. `run` is the index of the run within the variant."""
    parts = [
        frame.melt(id_vars="step", var_name="name", value_name="value").dropna().assign(variant=variant, run=place)
        for variant, frames in runs.items()
        for place, frame in enumerate(frames)
    ]
    columns = ["variant", "run", "step", "name", "value"]
    return pd.concat(parts, ignore_index=True)[columns] if parts else pd.DataFrame(columns=columns)
