"""Learning curves, by what is learnt: which columns of metrics.jsonl are worth a panel."""

from collections.abc import Mapping, Sequence

import pandas as pd

from acgd.reports.artifact import Artifact
from acgd.reports.settings import ReportRequest

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


def by_variant(request: ReportRequest, stage: str, artifacts: Sequence[Artifact]) -> dict[str, list[pd.DataFrame]]:
    """Variant -> one frame per artifact of the stage that it is the first to use; its student seeds stand side by side."""
    seen: set[int] = set()
    runs: dict[str, list[pd.DataFrame]] = {}
    for entry in request.entries:
        place = getattr(entry, stage)
        if place is None or place in seen:
            continue
        seen.add(place)
        frame = artifacts[place].curves()
        if len(frame):
            runs.setdefault(entry.variant, []).append(frame)
    return runs


def logged(runs: Mapping[str, Sequence[pd.DataFrame]], columns: Mapping[str, str]) -> dict[str, str]:
    """Those of the columns that some run has logged."""
    found = {column for frames in runs.values() for frame in frames for column in frame}
    return {column: title for column, title in columns.items() if column in found}


def backbone(
    request: ReportRequest, artifacts: Sequence[Artifact]
) -> tuple[dict[str, list[pd.DataFrame]], dict[str, str]]:
    """Runs of trained backbones and the columns to show: the loss, and per task the mean R^2 over its targets."""
    runs = by_variant(request, "backbone", artifacts)
    for frames in runs.values():
        for frame in frames:
            for task in request.tasks:
                of_task = [column for column in frame if column.startswith(f"r2/{task}/")]
                if of_task:
                    frame[task] = frame[of_task].mean(axis=1)
    return runs, logged(runs, {"loss": "training loss", **{task: f"R², {task}" for task in request.tasks}})


def ratios(request: ReportRequest, students: Sequence[Artifact]) -> dict[tuple[str, str], list[pd.DataFrame]]:
    """(variant, task) -> per student the gradient-norm ratio of guidance to imitation: step, ratio."""
    curves: dict[tuple[str, str], list[pd.DataFrame]] = {}
    for entry in request.entries:
        frame = students[entry.student].curves()
        for task in request.tasks:
            column = f"guidance_ratio/{task}"
            if column in frame:
                line = frame[["step", column]].dropna().rename(columns={column: "ratio"})
                curves.setdefault((entry.variant, task), []).append(line)
    return curves


def table(runs: Mapping[str, Sequence[pd.DataFrame]]) -> pd.DataFrame:
    """curves.csv: every logged value, long: variant, run (its place among the variant's), step, name, value."""
    parts = [
        frame.melt(id_vars="step", var_name="name", value_name="value").dropna().assign(variant=variant, run=place)
        for variant, frames in runs.items()
        for place, frame in enumerate(frames)
    ]
    columns = ["variant", "run", "step", "name", "value"]
    return pd.concat(parts, ignore_index=True)[columns] if parts else pd.DataFrame(columns=columns)
