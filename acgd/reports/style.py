"""Style of the figures, and their reproducible svg text."""

import io
import re
from collections.abc import Sequence
from contextlib import AbstractContextManager

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, MUTED, RULE, PAPER = "#1b1c1f", "#6d7178", "#dcdee2", "#fefefe"
"""Colours that become CSS variables in the page, so that a figure follows the dark or light theme."""

PALETTE = ("#2f74c0", "#d1702a", "#2b9a72", "#a4549b", "#b18a1e", "#c0444f", "#4b9fb5", "#7d7468")
"""Colours of the variants. They are distinguishable for colour-blind readers, and legible on white and near-black."""

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
    """A context with the style of the figures. Its exit restores matplotlib's settings."""
    return matplotlib.rc_context(_SETTINGS)


def colours(names: Sequence[str]) -> dict[str, str]:
    """Name -> colour, by the index of the name, so that a variant has one colour on the page."""
    return {name: PALETTE[place % len(PALETTE)] for place, name in enumerate(names)}


def panels(rows: int, columns: int, width: float, height: float, **share: object) -> tuple[Figure, list[list[Axes]]]:
    """A figure with a grid of axes. width, height: inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **share).tolist()


def svg(figure: Figure, name: str) -> str:
    """The figure as svg text without a date. Its ids depend on `name` and the drawing only."""
    buffer = io.StringIO()
    with matplotlib.rc_context({**_SETTINGS, "svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Title": name})
    return buffer.getvalue()


def inline(text: str, name: str) -> str:
    """The svg as a part of an html page: no prologue, ids prefixed by `name`, colours of the page's theme."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)
    text = re.sub(r' xmlns(:xlink)?="[^"]*"', "", text).replace("xlink:href", "href")
    for colour, variable in ((INK, "ink"), (MUTED, "muted"), (RULE, "rule"), (PAPER, "paper")):
        text = text.replace(colour, f"var(--{variable})")
    return text.strip()
