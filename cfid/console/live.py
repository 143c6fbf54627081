"""The status line on the terminal during a recording, and the messages above it."""

import os
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from cfid.console.messages import in_options, noted
from cfid.console.screen import Screen

if TYPE_CHECKING:
    from cfid.rig.recorder import Progress, Recorder

_EVERY_S = 0.2
_BARS = "▁▂▃▄▅▆▇█"


class LiveLine:
    """One line on stderr that is overwritten; silent where stderr is not a terminal.

    A closed or stopped terminal loses the line, never the recording.
    """

    def __init__(self, *, quiet: bool = True) -> None:
        """Start with an empty line; `quiet` rings no bell."""
        self._screen = Screen()
        file = self._screen.file
        self._terminal = None if file is None or not os.isatty(file) or os.environ.get("TERM") == "dumb" else file
        self._next_s = 0.0
        self._length = 0
        self._task = ""
        self._quiet = quiet

    def ring(self) -> None:
        """Call the operator, who may look elsewhere."""
        if self._terminal is not None and not self._quiet:
            self._screen.write("\a")

    def task(self, text: str) -> None:
        """Show the present task at the start of the line, from the next block on."""
        self._task = text
        self._next_s = 0.0

    def show(self, recorder: "Recorder") -> None:
        """Show the progress of the recording, a few times a second."""
        now_s = time.monotonic()
        if self._terminal is None or now_s < self._next_s or not self._screen.idle:
            return
        self._next_s = now_s + _EVERY_S
        # The most important first, since the end of a long line is cut.
        progress = recorder.progress
        read = [own.reading(own.latest) for own in progress.values() if own.reading is not None and own.latest]
        states = [own.status for own in progress.values() if own.status]
        lost = sum(own.lost for own in progress.values())
        counts = [f"{name} {_progress_text(own)}" for name, own in progress.items()]
        parts = [self._task, *read, *states, f"{lost} LOST" if lost else "", *counts]
        self._replace(f"{_time_text(recorder)}  " + "  |  ".join(filter(None, parts)))

    def say(self, text: str) -> None:
        """Print a note above the line."""
        self.tell(f"note: {in_options(text)}" if self._terminal is None else noted(text))

    def tell(self, text: str) -> None:
        """Print a message that is not a note above the line."""
        self._replace("")
        self._screen.write(f"{text}\n")

    def end(self) -> None:
        """Clear the line, and call the operator."""
        self._replace("")
        self.ring()
        self._screen.finish()

    def _replace(self, text: str) -> None:
        """Overwrite the line."""
        if self._terminal is None:
            return
        try:
            text = text[: max(os.get_terminal_size(self._terminal).columns - 1, 0)]
        except OSError:  # it was closed
            return
        self._screen.write("\r" + text.ljust(self._length) + ("" if text else "\r"))
        self._length = len(text)


def sparkline(values: Sequence[float]) -> str:
    """Return values as bars between their smallest and their largest."""
    if not values:
        return ""
    least, range_ = min(values), max(values) - min(values)
    if not range_:
        return _BARS[0] * len(values)
    return "".join(_BARS[min(int((value - least) / range_ * len(_BARS)), len(_BARS) - 1)] for value in values)


def _time_text(recorder: "Recorder") -> str:
    """Return the time that is left, else that which has passed."""
    if recorder.for_s is None:
        return f"{recorder.seconds:6.1f} s"
    return f"{max(recorder.for_s - recorder.seconds, 0.0):6.1f} s left"


def _progress_text(progress: "Progress") -> str:
    return f"{progress.rate_hz:.0f} Hz {progress.rows} rows {progress.lost} lost {sparkline(list(progress.trace))}"
