"""The line on the terminal while a run is recorded, and the sentences that come in between."""

import contextlib
import os
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import typer

from cfid.cli.speech import note

if TYPE_CHECKING:
    from cfid.rig.recorder import Progress, Recorder

_EVERY_S = 0.2
_BARS = "▁▂▃▄▅▆▇█"


class LiveLine:
    """One line on stderr that is written over and over; silent where stderr is no terminal.

    A terminal that was closed costs its line, never the recording.
    """

    def __init__(self) -> None:
        """Start with an empty line."""
        self._shown = sys.stderr is not None and sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
        self._next_s = 0.0
        self._length = 0
        self._task = ""

    def task(self, text: str) -> None:
        """Put before the line what is being done, at the next block."""
        self._task = text
        self._next_s = 0.0

    def show(self, recorder: "Recorder") -> None:
        """Show how the recording does, a few times a second."""
        now_s = time.monotonic()
        if not self._shown or now_s < self._next_s:
            return
        self._next_s = now_s + _EVERY_S
        told = [f"{name} {_told(progress)}" for name, progress in recorder.progress.items()]
        if self._task:
            told.insert(0, self._task)
        self._write(f"{recorder.seconds:6.1f} s  " + "  |  ".join(told))

    def say(self, text: str) -> None:
        """Say a sentence above the line."""
        self._write("")
        with contextlib.suppress(OSError):
            note(text)

    def tell(self, text: str) -> None:
        """Say above the line what is no note: where it is recorded to."""
        self._write("")
        with contextlib.suppress(OSError):
            typer.echo(text, err=True)

    def end(self) -> None:
        """Clear the line."""
        self._write("")

    def _write(self, text: str) -> None:
        if not self._shown:
            return
        with contextlib.suppress(OSError):
            text = text[: max(os.get_terminal_size(sys.stderr.fileno()).columns - 1, 0)]
            typer.echo("\r" + text.ljust(self._length), nl=False, err=True)
            self._length = len(text)
            if not text:
                typer.echo("\r", nl=False, err=True)


def sparkline(values: Sequence[float]) -> str:
    """Return values as bars between their least and their greatest."""
    if not values:
        return ""
    least, range_ = min(values), max(values) - min(values)
    if not range_:
        return _BARS[0] * len(values)
    return "".join(_BARS[min(int((value - least) / range_ * len(_BARS)), len(_BARS) - 1)] for value in values)


def _told(progress: "Progress") -> str:
    latest = " ".join(f"{value:.6g}" for value in progress.latest[:6])
    rate = f"{progress.rate_hz:5.0f} Hz {progress.rows} rows {progress.lost} lost"
    return f"{rate} {sparkline(list(progress.trace))} {latest}"
