"""What the numbers say, in sentences. Nothing here knows which answer is hoped for."""

from collections.abc import Sequence

import pandas as pd

from acgd.reports import numbers
from acgd.reports.differences import ALL_TASKS, VISUAL_DROP
from acgd.reports.settings import ReportRequest


def choose_baseline(request: ReportRequest) -> str:
    """The variant to compare with: the configured one, else the first without guidance, else the first."""
    variants = list(dict.fromkeys(entry.variant for entry in request.entries))
    wanted = request.report.baseline
    if wanted is not None:
        if wanted not in variants:
            raise ValueError(
                f"report.baseline is {wanted!r}, which is no variant of the study; choose one of {', '.join(variants)}"
            )
        return wanted
    guided = guided_variants(request)
    return next((variant for variant in variants if variant not in guided), variants[0])


def guided_variants(request: ReportRequest) -> set[str]:
    """Variants whose students were distilled from critics."""
    return {entry.variant for entry in request.entries if entry.critic}


def compared(request: ReportRequest, episodes: pd.DataFrame) -> str:
    """One sentence: variants, tasks, student seeds, episodes."""
    variants = list(dict.fromkeys(entry.variant for entry in request.entries))
    seeds = {entry.seed for entry in request.entries}
    students = episodes[episodes["kind"] == "student"]
    counts = students.groupby(["variant", "seed", "task"]).size()
    per = "no episodes" if counts.empty else f"{_range(counts)} held-out episodes per task and student"
    tasks = len(request.tasks)
    return (
        f"{numbers.listing(variants)}: one {'multi-task ' if tasks > 1 else ''}student per seed for {tasks} task{'s' * (tasks > 1)}, "
        f"{len(seeds)} student seed{'s' * (len(seeds) > 1)}, {per}."
    )


def answers(request: ReportRequest, paired: pd.DataFrame, mean: pd.DataFrame, baseline: str) -> list[str]:
    """One sentence per variant: did it do better than the baseline, going by the interval of the paired difference."""
    guided, rule = guided_variants(request), request.report.success
    rates = {row.variant: row.rate for row in mean.itertuples()}
    sentences = []
    for variant in dict.fromkeys(entry.variant for entry in request.entries):
        if variant == baseline:
            continue
        rows = paired[(paired["variant"] == variant) & (paired["rule"] == rule)]
        if rows.empty:
            sentences.append(
                f"{variant} shares no student seed, start and task with {baseline}, so nothing can be said of their difference."
            )
            continue
        whole = rows[rows["task"] == ALL_TASKS]
        row = (whole if len(whole) else rows).iloc[0]
        told = f"{variant} {rates[variant]:.2f}, {baseline} {rates[baseline]:.2f}; paired difference {numbers.difference(row['mean'], row.low, row.high)}"
        where = f" on {row.task}" if len(request.tasks) > 1 and whole.empty else ""
        told += ", an interval that covers zero." if row.low <= 0 <= row.high else "."
        told += " It is of one student seed, and says nothing of the next." if row.seeds == 1 else ""
        outcome = _outcome(row, "Guidance" if variant in guided and baseline not in guided else "", variant, baseline)
        sentences.append(f"{outcome}{where}: {told}")
    if not sentences and baseline in rates:
        sentences.append(
            f"{baseline} succeeds in {rates[baseline]:.2f} of the episodes. With one variant there is nothing to compare."
        )
    return sentences


def _outcome(row: pd.Series, guidance: str, variant: str, baseline: str) -> str:
    """Better, worse, or not told apart."""
    if guidance:
        return f"{guidance} {'helped' if row.low > 0 else 'hurt' if row.high < 0 else 'is not shown to help'}"
    if row.low > 0 or row.high < 0:
        return f"{variant} did {'better' if row.low > 0 else 'worse'} than {baseline}"
    return f"{variant} did no better and no worse than {baseline}"


def exceptions(paired: pd.DataFrame, rule: str) -> str:
    """Tasks whose own interval lies to one side of zero, where there are several tasks."""
    tasks = paired[(paired["rule"] == rule) & (paired["task"] != ALL_TASKS)]
    if tasks["task"].nunique() < 2:
        return ""
    apart = [
        f"{row.task} ({row.variant} {numbers.difference(row.mean, row.low, row.high)})"
        for row in tasks.itertuples()
        if row.low > 0 or row.high < 0
    ]
    if not apart:
        return "On no single task does the interval of the difference exclude zero."
    return f"Task by task, the interval excludes zero on {numbers.listing(apart)}."


def visual(drops: pd.DataFrame) -> tuple[bool | None, str]:
    """Whether some task needs its image; None where no student was run with shuffled image features."""
    if drops.empty:
        return (
            None,
            "Whether the students use their images was not measured: no evaluation has a condition with image_features: shuffled.",
        )
    per_task = [group.loc[group["mean"].idxmax()] for _, group in drops.groupby("task", sort=False)]
    needing = [row for row in per_task if row["mean"] >= VISUAL_DROP - 1e-9]
    lost = [
        f"{row.task} {'loses ' if place == 0 else ''}{numbers.points(row['mean'])}"
        for place, row in enumerate(needing or per_task)
    ]
    if needing:
        return True, f"The study is visual: when image features are shuffled across episodes, {numbers.listing(lost)}."
    return False, (
        f"The study is not visual: no task loses {numbers.points(VISUAL_DROP)} when image features are shuffled across episodes "
        f"({numbers.listing(lost)}). What it finds says little about vision."
    )


def replay(pooled: pd.DataFrame, tasks: Sequence[str]) -> str:
    """Tasks that a replay, which sees nothing once started, does as well as the best student."""
    told = []
    for task in tasks:
        rows = pooled[pooled["task"] == task]
        students, blind = (
            rows[rows["kind"] == "student"],
            rows[(rows["kind"] == "control") & rows["variant"].str.contains("replay")],
        )
        if students.empty or blind.empty:
            continue
        best, other = students.loc[students["rate"].idxmax()], blind.loc[blind["rate"].idxmax()]
        if other.high >= best.rate:
            told.append(
                f"{task} ({other.variant.removeprefix('control: ')} {other.rate:.2f}, best student {best.rate:.2f})"
            )
    if not told:
        return ""
    return f"A replay that never looks does about as well as the best student on {numbers.listing(told)}: there, success shows little feedback control."


def idle_guidance(gates: pd.DataFrame) -> str:
    """Guided students whose critics had no say: closed gates, or gradients below the floor."""
    if gates.empty:
        return ""
    closed, faint = gates[gates["gate"] == 0], gates[(gates["gate"] != 0) & gates["counts_as_none"]]
    parts = []
    if len(closed):
        parts.append(f"the gate was closed for {_which(closed)}")
    if len(faint):
        parts.append(f"the critics’ gradient stayed below 1% of imitation’s for {_which(faint)}")
    return f"Read it with care: {numbers.listing(parts)}, which counts as no guidance." if parts else ""


def _which(rows: pd.DataFrame) -> str:
    per_task = rows.groupby(["variant", "task"], sort=False).size()
    return numbers.listing(
        [f"{task} ({variant}, {count} student{'s' * (count > 1)})" for (variant, task), count in per_task.items()]
    )


def _range(counts: pd.Series) -> str:
    return str(counts.min()) if counts.min() == counts.max() else f"{counts.min()} to {counts.max()}"
