"""The figures. Each function draws a table that is also written as csv, or curves of artifacts."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from acgd.reports.differences import ALL_TASKS
from acgd.reports.style import INK, MUTED, PALETTE, colours, panels

WIDTH = 11.2
"""Inches, the width of the page's column."""


def success(pooled: pd.DataFrame, tasks: Sequence[str], variants: Sequence[str]) -> Figure:
    """A panel per task: rate and Wilson interval of each variant and control, and a tick for each student seed."""
    names = [
        name
        for kind in ("student", "condition", "control")
        for name in dict.fromkeys(pooled.loc[pooled["kind"] == kind, "variant"])
    ]
    colour = colours(variants)
    rows, columns = _grid(len(tasks), 4)
    figure, axes = panels(rows, columns, WIDTH, rows * (0.75 + 0.24 * len(names)), sharey=True, sharex=True)
    places = {name: -place - 0.6 * (name not in variants) for place, name in enumerate(names)}
    for axis, task in _pair(axes, tasks):
        for row in pooled[pooled["task"] == task].itertuples():
            shade, y = colour.get(row.variant, MUTED), places[row.variant]
            axis.plot([row.low, row.high], [y, y], color=shade, linewidth=2, solid_capstyle="butt", alpha=0.55)
            axis.plot(row.rate, y, "o", color=shade, markersize=6)
            if len(row.by_seed) > 1:
                axis.plot(
                    row.by_seed,
                    np.full(len(row.by_seed), y - 0.28),
                    "|",
                    color=shade,
                    markersize=5,
                    markeredgewidth=1.2,
                )
        axis.set_title(task)
        axis.set_xlim(-0.03, 1.03)
        axis.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", "", "0.5", "", "1"])
        axis.grid(axis="y", visible=False)
        axis.spines["left"].set_visible(False)
        axis.set_yticks(list(places.values()), [name.removeprefix("control: ") for name in names])
        axis.set_ylim(min(places.values()) - 0.6, 0.6)
    return figure


def differences(paired: pd.DataFrame, rule: str, variants: Sequence[str], baseline: str) -> Figure:
    """A forest plot per variant: the paired difference of each task, and of all tasks below."""
    rows = paired[paired["rule"] == rule]
    names = [name for name in variants if name in set(rows["variant"])]
    tasks = list(dict.fromkeys(rows["task"]))
    grid_rows, columns = _grid(len(names), 3)
    figure, axes = panels(grid_rows, columns, WIDTH, grid_rows * (0.85 + 0.27 * len(tasks)), sharey=True, sharex=True)
    reach = max(0.25, 1.08 * float(rows[["low", "high"]].abs().to_numpy().max()))
    for axis, name in _pair(axes, names):
        axis.axvline(0, color=INK, linewidth=0.9)
        for row in rows[rows["variant"] == name].itertuples():
            y, shade = -tasks.index(row.task) - 0.35 * (row.task == ALL_TASKS), colours(variants)[name]
            axis.plot([row.low, row.high], [y, y], color=shade, linewidth=2, solid_capstyle="butt", alpha=0.55)
            axis.plot(row.mean, y, "D" if row.task == ALL_TASKS else "o", color=shade, markersize=6.5)
        axis.set_title(f"{name} − {baseline}")
        axis.set_xlim(-reach, reach)
        axis.set_ylim(0.6 - len(tasks) - 0.35 * (ALL_TASKS in tasks) - 0.2, 0.6)
        axis.set_yticks([-place - 0.35 * (task == ALL_TASKS) for place, task in enumerate(tasks)], tasks)
        axis.grid(axis="y", visible=False)
        axis.spines["left"].set_visible(False)
        axis.set_xlabel("difference in success")
    return figure


def curves(runs: Mapping[str, Sequence[pd.DataFrame]], columns: Mapping[str, str], variants: Sequence[str]) -> Figure:
    """A panel per column (name -> title), a line per run in the colour of the variant."""
    rows, across = _grid(len(columns), 4, least=2)
    figure, axes = panels(rows, across, WIDTH, 2.4 * rows + 0.3)
    colour = {name: shade for name, shade in colours(variants).items() if name in runs}
    for axis, (column, title) in _pair(axes, list(columns.items())):
        for name, frames in runs.items():
            for frame in frames:
                if column in frame:
                    line = frame[["step", column]].dropna()
                    axis.plot(line["step"], line[column], color=colour[name], linewidth=1.2, alpha=0.9)
        axis.set_title(title)
        axis.set_xlabel("step")
        axis.xaxis.set_major_locator(MaxNLocator(4, integer=True))
        axis.margins(x=0.01)
    _legend(figure, colour)
    return figure


def expert_curves(curves: Mapping[str, pd.DataFrame], column: str) -> Figure:
    """Success on validation episodes over environment steps, a panel per task."""
    rows, columns = _grid(len(curves), 4, least=2)
    figure, axes = panels(rows, columns, WIDTH, 2.2 * rows + 0.2, sharey=True)
    for axis, (task, curve) in _pair(axes, list(curves.items())):
        axis.plot(curve["step"] / 1e6, curve[column], color=PALETTE[0], linewidth=1.4)
        axis.set_title(task)
        axis.set_ylim(-0.03, 1.03)
        axis.set_xlabel("million steps")
        axis.xaxis.set_major_locator(MaxNLocator(5))
    return figure


def within_state(
    ranks: Mapping[str, np.ndarray], quality: pd.DataFrame, candidates: Mapping[str, pd.DataFrame], gate: float | None
) -> Figure:
    """Above: histogram of the rank correlations within states. Below: Q over the simulated return.

    ranks: task -> (states,). candidates: task -> columns q and return, standardised within each state. gate: a dashed
    line at this correlation.
    """
    tasks = list(ranks)
    bands, across = _grid(len(tasks), 4, least=2)
    figure, axes = panels(2 * bands, across, WIDTH, 4.3 * bands)
    for place, task in enumerate(tasks):
        band, column = divmod(place, across)
        above, below = axes[2 * band][column], axes[2 * band + 1][column]
        above.hist(ranks[task], bins=np.linspace(-1, 1, 17), color=PALETTE[0], alpha=0.75, edgecolor="none")
        row = quality[quality["task"] == task].iloc[0]
        above.axvspan(row["within_state_low"], row["within_state_high"], color=PALETTE[1], alpha=0.3, linewidth=0)
        above.axvline(row["within_state_mean"], color=PALETTE[1], linewidth=1.6)
        if gate is not None:
            above.axvline(gate, color=INK, linewidth=0.9, linestyle=(0, (3, 3)))
        above.set_title(f"{task}   {row['within_state_mean']:.2f}")
        above.set_xlim(-1, 1)
        above.set_xticks([-1, -0.5, 0, 0.5, 1], ["−1", "−0.5", "0", "0.5", "1"])
        above.set_xlabel("rank correlation within a state")
        above.set_ylabel("states" if column == 0 else "")
        points = candidates[task]
        below.plot(points["return"], points["q"], ".", color=PALETTE[0], markersize=3, alpha=0.5)
        below.set_xlabel("simulated return, standardised within its state")
        below.set_ylabel("Q, likewise" if column == 0 else "")
    for extra in range(len(tasks), bands * across):
        band, column = divmod(extra, across)
        axes[2 * band][column].set_visible(False)
        axes[2 * band + 1][column].set_visible(False)
    return figure


def ratios(
    curves: Mapping[tuple[str, str], Sequence[pd.DataFrame]],
    tasks: Sequence[str],
    variants: Sequence[str],
    floor: float | None,
) -> Figure:
    """Gradient norm of L_distill divided by that of L_BC over training, a line per student seed.

    curves: (variant, task) -> one frame (step, ratio) per student seed. floor: a dashed line at this ratio.
    """
    rows, across = _grid(len(tasks), 4, least=2)
    figure, axes = panels(rows, across, WIDTH, 2.4 * rows + 0.3, sharey=True)
    colour = colours(variants)
    values = np.concatenate([frame["ratio"].to_numpy() for frames in curves.values() for frame in frames])
    values = values[values > 0]
    limits = (0.5 * min([*values, 0.1 if floor is None else floor]), 2 * max([*values, 1.0]))
    for axis, task in _pair(axes, tasks):
        for (variant, curve_task), frames in curves.items():
            for frame in frames if curve_task == task else ():
                positive = frame[frame["ratio"] > 0]
                axis.plot(positive["step"], positive["ratio"], color=colour[variant], linewidth=1.2)
        if floor is not None:
            axis.axhline(floor, color=INK, linewidth=0.9, linestyle=(0, (3, 3)))
        axis.set_yscale("log")
        axis.set_ylim(*limits)
        axis.yaxis.set_major_formatter(FuncFormatter(lambda ratio, _: f"{100 * ratio:g}%"))
        axis.xaxis.set_major_locator(MaxNLocator(4, integer=True))
        axis.set_title(task)
        axis.set_xlabel("step")
    _legend(figure, {variant: colour[variant] for variant, _ in curves})
    return figure


def _grid(count: int, across: int, least: int = 1) -> tuple[int, int]:
    """(rows, columns) for `count` panels: at most `across` and at least `least` columns."""
    columns = max(least, min(count, across))
    return max(1, -(-count // columns)), columns


def _pair(axes: list[list[Axes]], items: Sequence) -> list[tuple]:
    """(axes, item) pairs. Hides the axes without an item."""
    flat = [axis for row in axes for axis in row]
    for axis in flat[len(items) :]:
        axis.set_visible(False)
    return list(zip(flat, items, strict=False))


def _legend(figure: Figure, colour: Mapping[str, str]) -> None:
    if len(colour) > 1:
        handles = [figure.axes[0].plot([], [], color=shade, linewidth=2)[0] for shade in colour.values()]
        figure.legend(
            handles, list(colour), loc="outside upper left", ncols=len(colour), labelcolor=INK, handlelength=1.2
        )
