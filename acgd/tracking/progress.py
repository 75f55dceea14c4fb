"""How far a long stage is: a bar on a terminal, plain lines in a log."""

import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Protocol, Self, TextIO

LINE_EVERY_S = 10.0
LINE_EVERY_SHARE = 0.1


class Bar(Protocol):
    """What a stage does with either kind of bar."""

    def update(self, n: int = 1, **shown: float) -> None:
        """`n` more units are done; `shown` are the figures to see beside the bar, e.g. loss=0.31."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Progress:
    """`with progress(total, "fitting the critic") as bar: bar.update(loss=0.3)`"""

    def __init__(self, stream: TextIO | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self.stream = sys.stderr if stream is None else stream
        self.clock = clock

    def __call__(self, total: int, what: str, done: int = 0) -> Bar:
        """`done` units were done before, by the run that this one goes on from: they count for the share, not for the rate."""
        if self.stream.isatty():
            return TerminalBar(self.stream, total, what, done)
        return LogBar(self.stream, self.clock, total, what, done)


class TerminalBar:
    """tqdm, with the time left."""

    def __init__(self, stream: TextIO, total: int, what: str, done: int) -> None:
        from tqdm import tqdm

        self.bar = tqdm(total=total, desc=what, initial=done, file=stream, dynamic_ncols=True, smoothing=0.05)

    def update(self, n: int = 1, **shown: float) -> None:
        if shown:
            self.bar.set_postfix_str(_figures(shown), refresh=False)
        self.bar.update(n)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.bar.close()


class LogBar:
    """One line at the start, one at the end, and between them one each ten seconds, ever more rarely as the stage grows long."""

    def __init__(self, stream: TextIO, clock: Callable[[], float], total: int, what: str, done: int) -> None:
        self.stream, self.clock, self.total, self.what, self.before, self.done = stream, clock, total, what, done, done
        self.shown: dict[str, float] = {}
        self.started = self.told = clock()
        going_on = f", going on from {done}" if done else ""
        self._say(f"{what}: {total} to do{going_on}")

    def update(self, n: int = 1, **shown: float) -> None:
        self.done += n
        self.shown.update(shown)
        now = self.clock()
        if now - self.told >= self._wait(now):
            self._tell(now)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        now = self.clock()
        if error is not None:
            self._say(f"{self.what}: stopped at {self.done}/{self.total} by {type(error).__name__}")
        else:
            self._say(f"{self.what}: done, {self.done}/{self.total} in {_clock_time(now - self.started)}{self._tail()}")

    def _wait(self, now: float) -> float:
        """Seconds between two lines: ten, or a tenth of the time that the stage has run."""
        return max(LINE_EVERY_S, LINE_EVERY_SHARE * (now - self.started))

    def _tell(self, now: float) -> None:
        self.told = now
        elapsed = now - self.started
        rate = (self.done - self.before) / elapsed if elapsed > 0 else 0.0
        left = _clock_time((self.total - self.done) / rate) if rate > 0 else "?"
        share = 100 * self.done / self.total if self.total else 100
        self._say(f"{self.what}: {share:.0f}% ({self.done}/{self.total}), {rate:.3g}/s, {left} left{self._tail()}")

    def _tail(self) -> str:
        return f", {_figures(self.shown)}" if self.shown else ""

    def _say(self, line: str) -> None:
        self.stream.write(line + "\n")
        self.stream.flush()


def _figures(shown: dict[str, float]) -> str:
    return ", ".join(f"{name} {float(value):.4g}" for name, value in shown.items())


def _clock_time(seconds: float) -> str:
    """75 -> "1:15", 3700 -> "1:01:40"."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
