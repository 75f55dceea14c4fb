"""Progress of a stage: a bar on a terminal, lines of text in a log."""

import sys
from types import TracebackType
from typing import Any, Self, TextIO

from tqdm import tqdm

LINE_EVERY_S = 10.0
LINE_EVERY_SHARE = 0.1
"""Time between two lines of a log: the greater of ten seconds and a tenth of the stage's run time."""

LOG = "{desc}: {share:.0f}% ({n}/{total_fmt}), {rate_noinv_fmt}, {remaining} left{postfix}"


class Progress:
    """Makes progress bars: `with progress(total, "fitting the critic") as bar: bar.update(loss=0.3)`."""

    def __init__(self, stream: TextIO | None = None, line_every_s: float = LINE_EVERY_S) -> None:
        self.stream = sys.stderr if stream is None else stream
        self.line_every_s = line_every_s

    def __call__(self, total: int, what: str, done: int = 0) -> "Bar":
        """A bar over `total` units. `done`: units of an earlier run. They count for the share, not for the rate."""
        if self.stream.isatty():
            return Bar(tqdm(total=total, desc=what, initial=done, file=self.stream, dynamic_ncols=True, smoothing=0.05))
        return LogBar(self.stream, self.line_every_s, total, what, done)


class Bar:
    """A progress bar of a stage, used as a context manager."""

    def __init__(self, bar: tqdm) -> None:
        self.bar = bar

    def update(self, n: int = 1, **shown: float) -> None:
        """Adds `n` finished units. `shown`: figures beside the bar, e.g. loss=0.31."""
        if shown:
            self.bar.set_postfix_str(_figures(shown), refresh=False)
        self.bar.update(n)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.bar.close()


class LogBar(Bar):
    """Writes a line at the start, lines in between, and a line at the end. A long stage writes lines less often."""

    def __init__(self, stream: TextIO, line_every_s: float, total: int, what: str, done: int) -> None:
        resumed = f", going on from {done}" if done else ""
        first_line = f"{{desc}}: {{total}} to do{resumed}"
        super().__init__(
            _Shares(total=total, desc=what, initial=done, file=_Lines(stream), bar_format=first_line,
                    unit="", mininterval=line_every_s, miniters=1, smoothing=0)
        )  # fmt: skip
        self.line_every_s = line_every_s
        self.bar.bar_format = LOG

    def update(self, n: int = 1, **shown: float) -> None:
        elapsed_s = self.bar.format_dict["elapsed"]
        self.bar.mininterval = max(self.line_every_s, LINE_EVERY_SHARE * elapsed_s)
        super().update(n, **shown)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        counts = f"{self.bar.n}/{self.bar.total}"
        if error is not None:
            self.bar.bar_format = f"{{desc}}: stopped at {counts} by {type(error).__name__}"
        else:
            self.bar.bar_format = f"{{desc}}: done, {counts} in {{elapsed}}{{postfix}}"
        super().__exit__(kind, error, trace)


class _Shares(tqdm):
    """tqdm with the field `share` (percent). tqdm's `percentage` is missing where the total is zero."""

    monitor_interval = 0  # no monitor thread: every update reads the clock

    @property
    def format_dict(self) -> dict[str, Any]:
        fields = super().format_dict
        return fields | {"share": 100 * fields["n"] / fields["total"] if fields["total"] else 100.0}


class _Lines:
    """The stream of a log. It turns each state of the bar, which begins with a carriage return, into a line."""

    encoding = "utf-8"

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str) -> None:
        line = " ".join(text.split())
        if line:
            self.stream.write(line + "\n")

    def flush(self) -> None:
        self.stream.flush()


def _figures(shown: dict[str, float]) -> str:
    return ", ".join(f"{name} {float(value):.4g}" for name, value in shown.items())
