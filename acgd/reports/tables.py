"""Tables of the page, as rounded text. The csv files have the full precision."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import pandas as pd

from acgd.evaluation.intervals import SEEDS_FOR_A_CLAIM
from acgd.reports import numbers
from acgd.reports.differences import ALL_TASKS
from acgd.simulate.proportion import wilson


@dataclass(frozen=True)
class Cell:
    """A value, and its uncertainty in smaller type."""

    main: str
    small: str = ""
    kind: str = ""
    """CSS classes: `name` aligns text left, `strong` highlights, `faint` marks a control."""


@dataclass(frozen=True)
class Table:
    """Column heads and rows of cells."""

    head: list[str]
    rows: list[list[Cell]]
    notes: list[str] = field(default_factory=list)


def name(text: str, small: str = "") -> Cell:
    """A cell with left-aligned text."""
    return Cell(text, small, "name")


def rate(row: object, kind: str = "") -> Cell:
    """The cell 0.84 [0.74, 0.91] (63/75), from a row with rate, low, high, successes and episodes."""
    whole = numbers.proportion(row.rate, row.low, row.high, row.successes, row.episodes)
    main, small = whole.split(" ", 1)
    return Cell(main, small, kind)


def interval(mean: float, low: float, high: float, signed: bool = False, seeds: int = SEEDS_FOR_A_CLAIM) -> Cell:
    """A mean with its interval. A signed one is strong if the interval excludes zero and the seeds allow a claim."""
    whole = numbers.difference(mean, low, high) if signed else numbers.proportion(mean, low, high)
    main, _, small = whole.partition(" ")
    return Cell(main, small, "strong" if signed and seeds >= SEEDS_FOR_A_CLAIM and (low > 0 or high < 0) else "")


def success(pooled: pd.DataFrame, mean: pd.DataFrame, tasks: Sequence[str], kinds: Sequence[str]) -> Table:
    """One row per variant, one column per task, and the mean over tasks with its interval over student seeds."""
    rows = []
    for variant in dict.fromkeys(pooled.loc[pooled["kind"].isin(kinds), "variant"]):
        by_task = pooled[pooled["variant"] == variant].set_index("task")
        cells = [rate(by_task.loc[task]) if task in by_task.index else Cell("–") for task in tasks]
        row = mean[mean["variant"] == variant].iloc[0]
        seeds = max(len(by_seed) for by_seed in by_task["by_seed"])
        count = f"{seeds} student seed{'s' * (seeds > 1)}" if by_task["kind"].iloc[0] == "student" else ""
        rows.append(
            [
                name(variant.removeprefix("control: "), count),
                *cells,
                *([interval(row.rate, row.low, row.high)] if len(tasks) > 1 else []),
            ]
        )
    return Table(["", *tasks, *(["mean of tasks"] if len(tasks) > 1 else [])], rows)


def differences(paired: pd.DataFrame, rule: str) -> Table:
    """One row per variant and task: the difference, wins and losses, and the difference of each student seed."""
    rows = []
    for row in paired[paired["rule"] == rule].itertuples():
        label = name(row.task, f"{row.variant} − {row.baseline}")
        if row.task == ALL_TASKS:
            label = Cell(label.main, label.small, "name strong")
        by_seed = " · ".join(numbers.signed(float(value)) for value in row.by_seed.split())
        cells = [
            Cell(str(row.wins)),
            Cell(str(row.losses)),
            Cell(str(row.pairs)),
            Cell(f"{row.p_value:.3f}"),
            Cell(by_seed, kind="name"),
        ]
        rows.append([label, interval(row.mean, row.low, row.high, signed=True, seeds=row.seeds), *cells])
    return Table(["", "difference", "won", "lost", "pairs", "McNemar’s p", "by student seed"], rows)


def drops(drops: pd.DataFrame) -> Table:
    """Loss of success without the image, per variant and task."""
    rows = [
        [
            name(row.task, row.variant),
            Cell(f"{row.own:.2f}"),
            Cell(f"{row.shuffled:.2f}"),
            interval(row.mean, row.low, row.high, signed=True, seeds=row.seeds),
        ]
        for row in drops.itertuples()
    ]
    return Table(["", "own images", "another episode’s", "lost without"], rows)


def budget(budget: pd.DataFrame, mean: pd.DataFrame) -> Table:
    """Success and costs of one student, as means over student seeds, per variant."""
    rates = {row.variant: row for row in mean[mean["kind"] == "student"].itertuples()}
    rows = []
    for variant, group in budget.groupby("variant", sort=False):
        row = rates.get(variant)
        success = Cell("–") if row is None else interval(row.rate, row.low, row.high)
        counts = [group[column].mean() for column in ("demonstration_steps", "on_policy_steps", "on_policy_queries")]
        minutes = Cell(f"{group['cpu_s'].mean() / 60:.1f}")
        rows.append([name(variant), success, *(Cell(numbers.figure(round(count))) for count in counts), minutes])
    steps = ["environment steps, demonstrations", "environment steps, on-policy", "expert queries, on-policy"]
    return Table(["", "success", *steps, "processor minutes"], rows)


def cost(per_stage: pd.DataFrame) -> Table:
    """One row per stage, and a row of totals."""
    rows = [
        [
            name(row.stage),
            Cell(str(row.artifacts)),
            *(Cell(numbers.duration(time)) for time in (row.wall_s, row.longest_s, row.cpu_s)),
            *_space(row),
        ]
        for row in per_stage.itertuples()
    ]
    total = per_stage[["artifacts", "wall_s", "cpu_s", "bytes"]].sum()
    times = [Cell(numbers.duration(total.wall_s), kind="strong"), Cell(""), Cell(numbers.duration(total.cpu_s))]
    sums = [Cell("all", kind="name strong"), Cell(f"{total.artifacts:.0f}"), *times]
    rows.append([*sums, Cell(numbers.size(per_stage["peak_rss_bytes"].max())), Cell(numbers.size(total.bytes))])
    return Table(["stage", "artifacts", "wall time", "longest", "processor time", "peak memory", "on disk"], rows)


def artifacts(cost: pd.DataFrame) -> Table:
    """One row per artifact, with its key in the store."""
    rows = [
        [
            name(row.stage, row.label),
            Cell(row.variants, kind="name"),
            Cell(row.key, kind="key"),
            Cell(numbers.duration(row.wall_s)),
            *_space(row),
        ]
        for row in cost.rename(columns={"name": "label"}).itertuples()
    ]
    return Table(["artifact", "variants", "key", "wall time", "peak memory", "on disk"], rows)


def plain(frame: pd.DataFrame, heads: dict[str, str], names: Sequence[str] = ()) -> Table:
    """Columns of a frame with three significant digits. heads: column -> head."""
    rows = [
        [name(str(row[c])) if c in names else Cell(numbers.figure(row[c])) for c in heads]
        for _, row in frame.iterrows()
    ]
    return Table(list(heads.values()), rows)


def _space(row: object) -> list[Cell]:
    return [Cell(numbers.size(row.peak_rss_bytes)), Cell(numbers.size(row.bytes))]


def rules(success: pd.DataFrame) -> Table:
    """Success by each of the three rules, per variant and task, over student seeds."""
    students = success[success["kind"] == "student"]
    order = list(dict.fromkeys(students["rule"]))
    rows = []
    for (variant, task), group in students.groupby(["variant", "task"], sort=False):
        cells = []
        for rule in order:
            counts = group[group["rule"] == rule]
            successes, episodes = int(counts["successes"].sum()), int(counts["episodes"].sum())
            cells.append(interval_of(successes, episodes))
        rows.append([name(variant, task), *cells])
    return Table(["", *order], rows)


def interval_of(successes: int, episodes: int) -> Cell:
    """A success rate with its Wilson interval and counts."""
    rate = wilson(successes, episodes)
    return Cell(f"{rate.rate:.2f}", f"{numbers.bracket(rate.low, rate.high).strip()} ({successes}/{episodes})")


def experts(experts: pd.DataFrame) -> Table:
    """Algorithm, training steps and success of each expert."""
    several, rows = experts["task"].duplicated(keep=False).any(), []
    for row in experts.itertuples():
        training = [Cell(row.algorithm or "–", kind="name"), Cell(numbers.figure(row.steps))]
        success = rate(row) if pd.notna(row.rate) else Cell("–")
        label = name(row.task, row.variants if several else "")
        rows.append([label, *training, Cell(row.start or "–", kind="name"), success])
    return Table(["task", "algorithm", "environment steps", "starts", "success"], rows)


def demonstrations(demonstrations: pd.DataFrame) -> Table:
    """Number of demonstrations, attempts and failures, and environment steps."""
    several = demonstrations["task"].duplicated(keep=False).any()
    rows = []
    for row in demonstrations.itertuples():
        counts = [
            Cell(numbers.figure(value))
            for value in (row.demonstrations, row.attempts, row.failures, row.frames, row.environment_steps)
        ]
        rows.append([name(row.task, row.variants if several else ""), *counts])
    return Table(["task", "kept", "attempts", "failures", "frames", "environment steps"], rows)


def backbone(backbone: pd.DataFrame) -> Table:
    """Median and worst R^2 of the targets, on held-out frames, per task. The worst target is named."""
    rows = []
    for (variants, task), group in backbone[backbone["r2"].notna()].groupby(["variants", "task"], sort=False):
        worst = group.loc[group["r2"].idxmin()]
        cells = [
            Cell(str(len(group))),
            Cell(numbers.plain(group["r2"].median())),
            Cell(numbers.plain(worst["r2"]), worst["target"]),
        ]
        rows.append([name(task, variants if backbone["variants"].nunique() > 1 else ""), *cells])
    return Table(["task", "targets", "median R²", "worst R²"], rows)


def critics(critics: pd.DataFrame) -> Table:
    """Quality of each critic. The first columns are the rank correlations within a state."""
    rows = []
    for row in critics.itertuples():
        cells = [
            interval(row.within_state_mean, row.within_state_low, row.within_state_high),
            interval(row.near_mean, row.near_low, row.near_high),
        ]
        others = (row.rank_correlation_monte_carlo, row.bellman_error, row.gain_critic, row.gain_simulator, row.spread)
        counts = Cell(f"{numbers.figure(row.states)} × {numbers.figure(row.candidates)}")
        rows.append([name(row.task), *cells, counts, *(Cell(numbers.figure(value)) for value in others)])
    head = [
        "task",
        "rank within a state",
        "near candidates only",
        "states × actions",
        "rank, Monte Carlo",
        "Bellman error",
    ]
    return Table([*head, "gain, critic’s pick", "gain, best", "spread of Q"], rows)


def guidance(gates: pd.DataFrame) -> Table:
    """Gates and gradient ratios over student seeds, per variant and task."""
    rows = []
    for (variant, task), group in gates.groupby(["variant", "task"], sort=False):
        ratios = group["gradient_ratio"]
        span = f"{100 * ratios.min():.1f}% to {100 * ratios.max():.1f}%" if len(group) > 1 else ""
        open_gates = f"{int((group['gate'] > 0).sum())} of {len(group)}"
        counts = f"{int((~group['counts_as_none']).sum())} of {len(group)}"
        rows.append([name(task, variant), Cell(open_gates), Cell(f"{100 * ratios.mean():.1f}%", span), Cell(counts)])
    return Table(["", "gate open", "gradient ratio", "counts as guided"], rows)
