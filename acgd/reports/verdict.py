"""The results in sentences. The wording follows the intervals only."""

from collections.abc import Sequence, Set

import pandas as pd

from acgd.evaluation.intervals import SEEDS_FOR_A_CLAIM
from acgd.reports import numbers
from acgd.reports.artifact import Artifacts
from acgd.reports.differences import ALL_TASKS, VISUAL_DROP
from acgd.reports.settings import ReportRequest


def choose_baseline(request: ReportRequest, guided: Set[str]) -> str:
    """The variant to compare with: the configured one, else the first without guidance, else the first.

    Raises ValueError where the configured variant is unknown.
    """
    variants, configured = request.variants(), request.report.baseline
    if configured is None:
        return next((variant for variant in variants if variant not in guided), variants[0])
    if configured not in variants:
        raise ValueError(
            f"report.baseline is {configured!r}, which is no variant of the study: choose one of {', '.join(variants)}."
        )
    return configured


def compared(request: ReportRequest, episodes: pd.DataFrame) -> str:
    """A sentence with the variants and the numbers of tasks, student seeds and episodes."""
    variants = request.variants()
    seeds = {entry.seed for entry in request.entries}
    students = episodes[episodes["kind"] == "student"]
    counts = students.groupby(["variant", "seed", "task"]).size()
    per = "no episodes" if counts.empty else f"{_range(counts)} held-out episodes per task and student"
    tasks = len(request.tasks)
    return (
        f"{numbers.listing(variants)}: one {'multi-task ' if tasks > 1 else ''}student per seed "
        f"for {tasks} task{'s' * (tasks > 1)}, "
        f"{len(seeds)} student seed{'s' * (len(seeds) > 1)}, {per}."
    )


def answers(
    request: ReportRequest, paired: pd.DataFrame, mean: pd.DataFrame, baseline: str, guided: Set[str]
) -> list[str]:
    """One sentence per variant: whether it is better than the baseline, by the interval of the paired difference.

    With fewer than SEEDS_FOR_A_CLAIM student seeds the sentence gives the interval without a claim.
    """
    rates = {row.variant: row.rate for row in mean.itertuples()}
    sentences = []
    for variant in request.variants():
        if variant == baseline:
            continue
        rows = paired[(paired["variant"] == variant) & (paired["rule"] == request.report.success)]
        if rows.empty:
            sentences.append(
                f"{variant} shares no student seed, start and task with {baseline}: there is no paired difference."
            )
            continue
        overall = rows[rows["task"] == ALL_TASKS]
        row = (overall if len(overall) else rows).iloc[0]
        where = f" on {row.task}" if len(request.tasks) > 1 and overall.empty else ""
        guides = variant in guided and baseline not in guided
        covers = ", an interval that covers zero" if row.low <= 0 <= row.high else ""
        figures = f"{variant} {rates[variant]:.2f}, {baseline} {rates[baseline]:.2f}; paired difference"
        interval = numbers.difference(row["mean"], row.low, row.high)
        sentences.append(f"{_outcome(row, guides, variant, baseline)}{where}: {figures} {interval}{covers}.{_few(row)}")
    if not sentences and baseline in rates:
        sentences.append(
            f"{baseline} succeeds in {rates[baseline]:.2f} of the episodes. One variant: there is nothing to compare."
        )
    return sentences


def _outcome(row: pd.Series, guides: bool, variant: str, baseline: str) -> str:
    """First part of the sentence: better, worse, no difference shown, or no claim."""
    if row.seeds < SEEDS_FOR_A_CLAIM:
        question = "whether guidance helps" if guides else f"whether {variant} does better than {baseline}"
        verb = "does" if row.seeds == 1 else "do"
        return f"{numbers.counted(row.seeds, 'student seed').capitalize()} {verb} not tell {question}"
    if guides:
        return f"Guidance {'helped' if row.low > 0 else 'hurt' if row.high < 0 else 'is not shown to help'}"
    if row.low > 0 or row.high < 0:
        return f"{variant} did {'better' if row.low > 0 else 'worse'} than {baseline}"
    return f"{variant} is not shown to differ from {baseline}"


def _few(row: pd.Series) -> str:
    """The sentence that follows the interval if there are too few student seeds for a claim; else empty."""
    if row.seeds == 1:
        return " The interval is of the episodes only; nothing is known of the next student seed."
    if row.seeds < SEEDS_FOR_A_CLAIM:
        seeds, needed = numbers.counted(row.seeds, "student seed"), numbers.counted(SEEDS_FOR_A_CLAIM, "student seed")
        return f" {seeds.capitalize()} carry an interval and no claim; a claim needs {needed}."
    return ""


def exceptions(paired: pd.DataFrame, rule: str) -> str:
    """Tasks whose interval excludes zero. Empty for one task, or for too few seeds for a claim."""
    tasks = paired[(paired["rule"] == rule) & (paired["task"] != ALL_TASKS)]
    tasks = tasks[tasks["seeds"] >= SEEDS_FOR_A_CLAIM]
    if tasks["task"].nunique() < 2:
        return ""
    excluding = [
        f"{row.task} ({row.variant} {numbers.difference(row.mean, row.low, row.high)})"
        for row in tasks.itertuples()
        if row.low > 0 or row.high < 0
    ]
    if not excluding:
        return "On no single task does the interval of the difference exclude zero."
    chance = f"By chance, one of twenty such intervals does; here are {len(tasks)}."
    return f"Task by task, the interval excludes zero on {numbers.listing(excluding)}. {chance}"


def visual(drops: pd.DataFrame) -> tuple[bool | None, str]:
    """Whether a task needs its image, and a sentence; None without an evaluation with shuffled image features."""
    if drops.empty:
        condition = "no evaluation has a condition with image_features: shuffled"
        return None, f"Whether the students use their images was not measured: {condition}."
    per_task = [group.loc[group["mean"].idxmax()] for _, group in drops.groupby("task", sort=False)]
    needing = [row for row in per_task if row["mean"] >= VISUAL_DROP - 1e-9]
    lost = [
        f"{row.task} {'loses ' if place == 0 else ''}{numbers.points(row['mean'])}"
        for place, row in enumerate(needing or per_task)
    ]
    if needing:
        return True, f"The study is visual: when image features are shuffled across episodes, {numbers.listing(lost)}."
    return False, (
        f"The study is not visual: no task loses {numbers.points(VISUAL_DROP)} when image features are shuffled across "
        f"episodes ({numbers.listing(lost)}). Its results say little about vision."
    )


def replay(pooled: pd.DataFrame, tasks: Sequence[str]) -> str:
    """A sentence with the tasks on which a replay is about as good as the best student; empty without one."""
    solved = []
    for task in tasks:
        rows = pooled[pooled["task"] == task]
        students = rows[rows["kind"] == "student"]
        replays = rows[(rows["kind"] == "control") & rows["variant"].str.contains("replay")]
        if students.empty or replays.empty:
            continue
        best, best_replay = students.loc[students["rate"].idxmax()], replays.loc[replays["rate"].idxmax()]
        if best_replay.high >= best.rate:
            name = best_replay.variant.removeprefix("control: ")
            solved.append(f"{task} ({name} {best_replay.rate:.2f}, best student {best.rate:.2f})")
    if not solved:
        return ""
    return (
        "The replay of a demonstration, which reads nothing after the start, does about as well as the best student on "
        f"{numbers.listing(solved)}: there, success shows little feedback control."
    )


def idle_guidance(gates: pd.DataFrame) -> str:
    """A sentence with guided students whose gate was closed or whose guidance gradient was too small; else empty."""
    if gates.empty:
        return ""
    closed, faint = gates[gates["gate"] == 0], gates[(gates["gate"] != 0) & gates["counts_as_none"]]
    floor, parts = numbers.common(faint["counts_from"]), []
    if len(closed):
        parts.append(f"the gate was closed for {_which(closed)}")
    if len(faint):
        below = "the floor" if floor is None else f"{100 * floor:g}% of imitation’s"
        parts.append(f"the critics’ gradient stayed below {below} for {_which(faint)}")
    return f"Read it with care: {numbers.listing(parts)}, which counts as no guidance." if parts else ""


def precision(artifacts: Artifacts) -> str:
    """A sentence with the stages whose artifacts were computed in different precisions; else empty."""
    mixed = []
    for stage, made in artifacts.items():
        precisions = [artifact.precision for artifact in made if artifact.precision is not None]
        if len(set(precisions)) > 1:
            mixed.append(f"{stage} ({precisions.count('float32')} of {len(precisions)} in float32)")
    if not mixed:
        return ""
    return (
        f"The study mixes precisions: of artifacts that ask for bfloat16, {numbers.listing(mixed)}, since a processor "
        "had no bfloat16. A difference between variants may come from that."
    )


def _which(rows: pd.DataFrame) -> str:
    """Tasks in words, with variant and number of students."""
    per_task = rows.groupby(["variant", "task"], sort=False).size()
    return numbers.listing(
        [f"{task} ({variant}, {count} student{'s' * (count > 1)})" for (variant, task), count in per_task.items()]
    )


def _range(counts: pd.Series) -> str:
    return str(counts.min()) if counts.min() == counts.max() else f"{counts.min()} to {counts.max()}"
