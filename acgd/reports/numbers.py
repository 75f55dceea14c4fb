"""Formats of the numbers in the report."""

import math
from collections.abc import Callable, Iterable


def proportion(rate: float, low: float, high: float, successes: int | None = None, episodes: int | None = None) -> str:
    """A rate with its interval and counts: 0.84 [0.74, 0.91] (63/75)."""
    counts = "" if episodes is None else f" ({successes}/{episodes})"
    return f"{plain(rate)}{bracket(low, high)}{counts}"


def difference(mean: float, low: float, high: float) -> str:
    """A difference with its interval: +0.04 [−0.02, +0.10]."""
    return f"{signed(mean)}{bracket(low, high, signed)}"


def bracket(low: float, high: float, write: Callable[[float], str] | None = None) -> str:
    """The interval with a leading space; empty for NaN."""
    if math.isnan(low) or math.isnan(high):
        return ""
    write = write or plain
    return f" [{write(low)}, {write(high)}]"


def plain(value: float) -> str:
    """A number with two decimals and a typographic minus sign."""
    text = f"{value:.2f}".replace("-", "−")
    return "0.00" if text == "−0.00" else text


def signed(value: float) -> str:
    """A signed number with two decimals and a typographic minus sign. A number that rounds to zero has no sign."""
    text = f"{value:+.2f}".replace("-", "−")
    return "0.00" if text[1:] == "0.00" else text


def counted(count: int, what: str) -> str:
    """A count in words: three student seeds, one task."""
    words = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
    return f"{words[count] if count < len(words) else count} {what}{'' if count == 1 else 's'}"


def points(fraction: float) -> str:
    """A fraction in percentage points: 0.34 -> 34 points."""
    count = round(100 * fraction)
    return f"{count} point" + ("" if count == 1 else "s")


def duration(seconds: float | None) -> str:
    """A time in s: 4.2 s, 3:05 min, 2:11 h."""
    if seconds is None or math.isnan(seconds):
        return "–"
    if seconds < 59.95:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d} h" if minutes >= 60 else f"{minutes}:{rest:02d} min"


def size(count: float | None) -> str:
    """A number of bytes in decimal units."""
    if count is None or math.isnan(count):
        return "–"
    for unit in ("B", "kB", "MB"):
        if count < 999.5:
            return f"{count:.0f} {unit}"
        count /= 1000
    return f"{count:.1f} GB"


def figure(value: object) -> str:
    """Any other number with three significant digits; – for None and NaN."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    if isinstance(value, int) or float(value).is_integer():
        return f"{int(value):,}".replace(",", " ") if abs(value) < 1e15 else f"{value:.2e}"
    return f"{value:.3g}".replace("-", "−")


def common(values: Iterable[float]) -> float | None:
    """The common value, without NaN; None if there is no value or values differ."""
    different = {value for value in values if not math.isnan(value)}
    return different.pop() if len(different) == 1 else None


def listing(items: list[str]) -> str:
    """A list in words: a, b and c."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}" if items else ""
