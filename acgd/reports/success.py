"""Success of every student and control, computed from the episodes."""

import pandas as pd

from acgd.evaluation.intervals import episode_noise, over_seeds
from acgd.reports.artifact import Artifact, Artifacts
from acgd.reports.ledger import used
from acgd.reports.settings import ReportEntry, ReportRequest
from acgd.simulate.proportion import wilson

RULES = ("final", "held", "once")
CONDITION = ["goal", "image_features", "start"]
EPISODE = ["variant", "kind", "parent", "seed", "task", "episode", *CONDITION, *RULES]
CONTROLS = {
    "replay": "open-loop replay",
    "replay-nearest": "nearest-start replay",
    "expert": "expert",
    "expert-nominal": "expert, nominal start",
}
"""Name in the stage `controls` -> name in the report."""
ROW = ["variant", "kind", "seed", "task", *CONDITION]


def gather(request: ReportRequest, artifacts: Artifacts) -> pd.DataFrame:
    """One row per episode, columns EPISODE.

    kind: `student` in the headline condition, which is the first one; `condition` in another condition; `control` for
    a replay, the expert, and a student with shuffled images. parent: variant of the student or of the controls.
    """
    parts = [_of_student(entry, artifacts) for entry in request.entries]
    owners: dict[int, str] = {}
    for entry in request.entries:
        for place in entry.places("controls"):
            owners.setdefault(place, entry.variant)
    for order, (place, owner) in enumerate(owners.items()):
        parts.append(_of_controls(artifacts["controls"][place], owner, suffix=f" ({owner})" if order else ""))
    parts = [part for part in parts if len(part)]
    episodes = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=EPISODE)
    return episodes.astype({"seed": "Int64", **{rule: bool for rule in RULES}})


def _of_student(entry: ReportEntry, artifacts: Artifacts) -> pd.DataFrame:
    evaluations = used(entry, "evaluation", artifacts)
    rows = pd.DataFrame([row for evaluation in evaluations for row in evaluation.json_lines("episodes.jsonl")])
    if rows.empty:
        return pd.DataFrame(columns=EPISODE)
    rows = rows.drop_duplicates(["task", "episode_seed", *CONDITION])
    rows = rows.assign(parent=entry.variant, seed=entry.seed, episode=rows["episode_seed"])
    headline = rows.loc[0, CONDITION]
    named = [_name(entry.variant, headline, condition) for _, condition in rows[CONDITION].iterrows()]
    return rows.assign(variant=[name for name, _ in named], kind=[kind for _, kind in named])[EPISODE]


def _of_controls(artifact: Artifact, owner: str, suffix: str) -> pd.DataFrame:
    rows = pd.DataFrame(artifact.json_lines("episodes.jsonl"))
    if rows.empty:
        return pd.DataFrame(columns=EPISODE)
    names = [f"control: {CONTROLS.get(control, control)}{suffix}" for control in rows["control"]]
    return rows.assign(variant=names, parent=owner, kind="control", seed=pd.NA, episode=rows["episode_seed"])[EPISODE]


def _name(variant: str, headline: pd.Series, condition: pd.Series) -> tuple[str, str]:
    """(name, kind) of a student's episodes in one condition."""
    changed = {field for field in CONDITION if condition[field] != headline[field]}
    if not changed:
        return variant, "student"
    if changed == {"image_features"} and condition["image_features"] == "shuffled":
        return f"control: {variant}, shuffled images", "control"
    words = {"goal": "{} goal", "image_features": "{} image features", "start": "{} start"}
    return ", ".join(
        [variant, *(words[field].format(condition[field]) for field in CONDITION if field in changed)]
    ), "condition"


def table(episodes: pd.DataFrame) -> pd.DataFrame:
    """success.csv: one row per variant, student seed, task and rule, with the Wilson interval."""
    rows = []
    for key, group in episodes.groupby(ROW, sort=False, dropna=False):
        for rule in RULES:
            successes, n = int(group[rule].sum()), len(group)
            interval = wilson(successes, n)
            rows.append((*key, rule, n, successes, interval.rate, interval.low, interval.high))
    frame = pd.DataFrame(rows, columns=[*ROW, "rule", "episodes", "successes", "rate", "low", "high"])
    return frame.astype({"seed": "Int64"})


def pooled(success: pd.DataFrame, rule: str) -> pd.DataFrame:
    """One row per variant and task: variant, kind, task, episodes, successes, rate, low, high, by_seed.

    The Wilson interval assumes that the episodes of all student seeds are independent. by_seed: rate of each student.
    """
    rows = []
    for (variant, kind, task), group in success[success["rule"] == rule].groupby(
        ["variant", "kind", "task"], sort=False
    ):
        successes, n = int(group["successes"].sum()), int(group["episodes"].sum())
        interval = wilson(successes, n)
        rows.append(
            (variant, kind, task, n, successes, interval.rate, interval.low, interval.high, group["rate"].tolist())
        )
    return pd.DataFrame(
        rows, columns=["variant", "kind", "task", "episodes", "successes", "rate", "low", "high", "by_seed"]
    )


def over_tasks(success: pd.DataFrame, rule: str) -> pd.DataFrame:
    """One row per variant: mean of the tasks' rates, with the t interval over student seeds. Tasks have equal weights.

    Columns: variant, kind, rate, low, high, seeds. With one seed low and high are NaN. The interval is at least as wide
    as the noise of the episodes.
    """
    rows = []
    for (variant, kind), group in success[success["rule"] == rule].groupby(["variant", "kind"], sort=False):
        by_seed = group.groupby("seed", dropna=False)["rate"].mean().tolist()
        counts = group.groupby("task", sort=False)[["successes", "episodes"]].sum()
        interval = over_seeds(by_seed, episode_noise(counts["successes"], counts["episodes"]))
        has_interval = len(by_seed) > 1
        rows.append(
            (
                variant,
                kind,
                interval.mean,
                interval.low if has_interval else float("nan"),
                interval.high if has_interval else float("nan"),
                len(by_seed),
            )
        )
    return pd.DataFrame(rows, columns=["variant", "kind", "rate", "low", "high", "seeds"])
