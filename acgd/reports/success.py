"""Success of every student and control, from the episodes alone."""

from collections.abc import Sequence

import pandas as pd

from acgd.evaluation.intervals import over_seeds, wilson
from acgd.reports.artifact import Artifact
from acgd.reports.settings import ReportEntry, ReportRequest

RULES = ("final", "held", "once")
CONDITION = ["goal", "image_features", "start"]
EPISODE = ["variant", "kind", "parent", "seed", "task", "episode", *CONDITION, *RULES]
CONTROLS = {
    "replay": "open-loop replay",
    "replay-nearest": "nearest-start replay",
    "expert": "expert",
    "expert-nominal": "expert, nominal start",
}
"""What the controls stage calls them -> what the report does."""
ROW = ["variant", "kind", "seed", "task", *CONDITION]


def gather(request: ReportRequest, evaluations: Sequence[Artifact], controls: Sequence[Artifact]) -> pd.DataFrame:
    """One row per episode, columns EPISODE.

    kind: `student` in the headline condition of its evaluation, `condition` in another one, `control` for what is no student of
    the study: replays, the expert, and a student that sees another episode's images. parent: the variant that a condition is of.
    """
    parts = [_of_student(entry, evaluations[entry.evaluation]) for entry in request.entries]
    used = dict.fromkeys(entry.controls for entry in request.entries if entry.controls is not None)
    for order, place in enumerate(used):
        owner = next(entry.variant for entry in request.entries if entry.controls == place)
        parts.append(_of_controls(controls[place], owner, suffix=f" ({owner})" if order else ""))
    parts = [part for part in parts if len(part)]
    episodes = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=EPISODE)
    return episodes.astype({"seed": "Int64", **{rule: bool for rule in RULES}})


def _of_student(entry: ReportEntry, evaluation: Artifact) -> pd.DataFrame:
    rows = pd.DataFrame(evaluation.json_lines("episodes.jsonl"))
    if rows.empty:
        return pd.DataFrame(columns=EPISODE)
    rows = rows.drop_duplicates(
        ["task", "episode_seed", *CONDITION]
    )  # without a goal image, conditions that differ in it are one
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
    differs = {field for field in CONDITION if condition[field] != headline[field]}
    if not differs:
        return variant, "student"
    if differs == {"image_features"} and condition["image_features"] == "shuffled":
        return f"control: {variant}, shuffled images", "control"
    words = {"goal": "{} goal", "image_features": "{} image features", "start": "{} start"}
    return ", ".join(
        [variant, *(words[field].format(condition[field]) for field in CONDITION if field in differs)]
    ), "condition"


def table(episodes: pd.DataFrame) -> pd.DataFrame:
    """success.csv: one row per variant, student seed, task and rule, with Wilson's interval."""
    rows = []
    for key, group in episodes.groupby(ROW, sort=False, dropna=False):
        for rule in RULES:
            successes, n = int(group[rule].sum()), len(group)
            interval = wilson(successes, n)
            rows.append((*key, rule, n, successes, interval.mean, interval.low, interval.high))
    frame = pd.DataFrame(rows, columns=[*ROW, "rule", "episodes", "successes", "rate", "low", "high"])
    return frame.astype({"seed": "Int64"})


def pooled(success: pd.DataFrame, rule: str) -> pd.DataFrame:
    """One row per variant and task, over its student seeds: variant, kind, task, episodes, successes, rate, low, high, by_seed.

    Wilson's interval takes the episodes as independent; `by_seed` holds each student's own rate, since they are not.
    """
    rows = []
    for (variant, kind, task), group in success[success["rule"] == rule].groupby(
        ["variant", "kind", "task"], sort=False
    ):
        successes, n = int(group["successes"].sum()), int(group["episodes"].sum())
        interval = wilson(successes, n)
        rows.append(
            (variant, kind, task, n, successes, interval.mean, interval.low, interval.high, group["rate"].tolist())
        )
    return pd.DataFrame(
        rows, columns=["variant", "kind", "task", "episodes", "successes", "rate", "low", "high", "by_seed"]
    )


def over_tasks(success: pd.DataFrame, rule: str) -> pd.DataFrame:
    """One row per variant: the mean of its tasks' rates, each task weighing the same, and the t interval over student seeds.

    Columns variant, kind, rate, low, high, seeds; without a second seed low and high are NaN.
    """
    rows = []
    for (variant, kind), group in success[success["rule"] == rule].groupby(["variant", "kind"], sort=False):
        by_seed = group.groupby("seed", dropna=False)["rate"].mean().tolist()
        interval = over_seeds(by_seed)
        known = len(by_seed) > 1
        rows.append(
            (
                variant,
                kind,
                interval.mean,
                interval.low if known else float("nan"),
                interval.high if known else float("nan"),
                len(by_seed),
            )
        )
    return pd.DataFrame(rows, columns=["variant", "kind", "rate", "low", "high", "seeds"])
