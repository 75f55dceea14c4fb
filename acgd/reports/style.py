"""How the figures look, and how one becomes the same svg bytes every time."""

import io
import re
from collections.abc import Sequence
from contextlib import AbstractContextManager

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, MUTED, RULE, PAPER = "#1b1c1f", "#6d7178", "#dcdee2", "#fefefe"
"""Exactly these become CSS variables in the page, so that a figure follows its dark and light theme."""

PALETTE = ("#2f74c0", "#d1702a", "#2b9a72", "#a4549b", "#b18a1e", "#c0444f", "#4b9fb5", "#7d7468")
"""Told apart by the colour blind, and legible on white and on near-black."""

_SETTINGS = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.5,
    "text.color": INK,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": RULE,
    "grid.linewidth": 0.7,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.major.size": 0,
    "ytick.major.size": 0,
    "axes.formatter.use_mathtext": False,
    "axes.unicode_minus": True,
    "figure.constrained_layout.w_pad": 0.1,
    "figure.constrained_layout.h_pad": 0.07,
    "legend.frameon": False,
    "figure.facecolor": PAPER,
    "axes.facecolor": "none",
}


def applied() -> AbstractContextManager:
    """Figures are drawn inside of it; matplotlib's settings are as before afterwards."""
    return matplotlib.rc_context(_SETTINGS)


def colours(names: Sequence[str]) -> dict[str, str]:
    """Name -> colour, by its place, so that a variant keeps its colour through the page."""
    return {name: PALETTE[place % len(PALETTE)] for place, name in enumerate(names)}


def panels(rows: int, columns: int, width: float, height: float, **share: object) -> tuple[Figure, list[list[Axes]]]:
    """A grid of axes; width and height in inches at 96 px."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **share).tolist()


def svg(figure: Figure, name: str) -> str:
    """The figure as svg text: no date, ids that depend on nothing but `name` and the drawing."""
    buffer = io.StringIO()
    with matplotlib.rc_context({**_SETTINGS, "svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Title": name})
    return buffer.getvalue()


def inline(text: str, name: str) -> str:
    """The svg as a part of an html page: no prologue, ids of its own, colours of the page's theme."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)
    text = re.sub(r' xmlns(:xlink)?="[^"]*"', "", text).replace("xlink:href", "href")
    for colour, variable in ((INK, "ink"), (MUTED, "muted"), (RULE, "rule"), (PAPER, "paper")):
        text = text.replace(colour, f"var(--{variable})")
    return text.strip()
