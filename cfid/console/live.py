"""The status line on the terminal during a recording, and the messages above it."""

import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from cfid.console.messages import clock, fitted, in_options, noted, printable, printable_lines
from cfid.console.program import program
from cfid.console.screen import Screen

if TYPE_CHECKING:
    from cfid.rig.progress import Progress
    from cfid.rig.recorder import Recorder

_EVERY_S = 0.2
_MINUTES_FROM_S = 100.0
_SLOWEST_HZ = 0.5
_USUAL_COLUMNS = 80  # the assumed width of a terminal that reports none, such as a serial line
_INDENT = 2  # of the second and later lines of a message
_BARS = "▁▂▃▄▅▆▇█"
_FEWEST_BARS = 8  # fewer show no course


class LiveLine:
    """One line on stderr that is overwritten again and again; nothing where stderr is not a terminal.

    A terminal that is closed or stopped costs the line, never the recording.
    """

    def __init__(self) -> None:
        """Start with an empty line."""
        self._screen = Screen()
        file = self._screen.file
        self._terminal = None if file is None or not os.isatty(file) or os.environ.get("TERM") == "dumb" else file
        self._next_s = 0.0
        self._length = 0
        self._task = self._question = ""
        self._left: Callable[[], str] = str

    def ring(self) -> None:
        """Ring the bell for the operator, who may be looking elsewhere."""
        if self._terminal is not None and not program().quiet:
            self._screen.write("\a")

    def task(self, text: str) -> None:
        """Show the current task at the end of the line from the next block of samples on; drop any open question."""
        self._task, self._question = text, ""
        self._next_s = 0.0

    def left(self, text: str | Callable[[], str]) -> None:
        """Show `text`, which states what remains to do, instead of the time; for work of unknown duration."""
        self._left = (lambda: text) if isinstance(text, str) else text

    def ask(self, text: str) -> None:
        """Show a question, and the answer as it is typed, after the remaining time, until the next task."""
        self._question = text
        self._next_s = 0.0

    def show(self, recorder: "Recorder") -> None:
        """Show the progress of the recording, a few times a second."""
        now_s = recorder.now_s
        if self._terminal is None or now_s < self._next_s or not self._screen.idle:
            return
        self._next_s = now_s + _EVERY_S
        parts = [
            printable(part) for part in line_of(recorder, task=self._task, question=self._question, left=self._left())
        ]
        columns = self._columns()
        if self._question and len(parts[0]) > columns:  # its end, where the answer appears as the operator types it
            parts = [f"…{parts[0][1 - columns :]}"]
        self._replace(fitting(parts, columns))

    def say(self, text: str) -> None:
        """Print a note above the line."""
        self._print(f"note: {in_options(text)}" if self._terminal is None else noted(text))

    def tell(self, text: str) -> None:
        """Print a message that is not a note above the line."""
        self._print(fitted(printable_lines(text), indent=_INDENT, err=True))

    def _print(self, text: str) -> None:
        self._replace("")
        self._screen.write(f"{text}\n")

    def end(self) -> None:
        """Clear the line, and ring the bell for the operator."""
        self._replace("")
        self.ring()
        self._screen.finish()

    def _replace(self, text: str) -> None:
        """Overwrite the line."""
        if self._terminal is None:
            return
        text = text[: self._columns()]
        self._screen.write("\r" + text.ljust(self._length) + ("" if text else "\r"))
        self._length = len(text)

    def _columns(self) -> int:
        """Return how many characters the line may have, 0 where the terminal was closed."""
        try:
            return 0 if self._terminal is None else (os.get_terminal_size(self._terminal).columns or _USUAL_COLUMNS) - 1
        except OSError:
            return 0


def fitting(parts: Sequence[str], columns: int) -> str:
    """Return as many whole parts as fit on a line, at least a beginning of the first; of bars, the latest that fit."""
    line = parts[0][:columns]
    for part in parts[1:]:
        room = columns - len(line) - 2
        shown = part[-room:] if part[0] in _BARS and room >= _FEWEST_BARS else part
        if len(shown) > room:
            break
        line = f"{line}  {shown}"
    return line


def line_of(recorder: "Recorder", *, task: str = "", question: str = "", left: str = "") -> list[str]:
    """Return the parts of the line, the most important first, since a narrow terminal cuts off the end.

    The question shares the first part with what remains, by default the time, so both stay on a narrow line. Readings,
    such as an angle, and rates are those of the devices that show something, losses those of all.
    """
    devices = list(recorder.progress.values())
    shown = [progress for progress in devices if progress.reading is not None] or devices
    read = [text for name, progress in recorder.progress.items() if (text := _read(name, progress))]
    states = [progress.status for progress in devices if progress.status]
    lost = sum(progress.lost or 0 for progress in devices)
    losses = (
        f"{lost} LOST" if lost else "losses unknown" if None in [progress.lost for progress in devices] else "0 lost"
    )
    rates = "+".join(f"{progress.rate_hz:.0f}" for progress in shown if progress.rate_hz >= _SLOWEST_HZ)
    first = "  ".join(filter(None, [left or _time_text(recorder), question]))
    parts = [first, *read, *states, losses, f"{rates} Hz" if rates else ""]
    trace = sparkline(list(shown[0].trace)) if shown else ""
    return [part for part in (*parts, task, trace) if part]


def _read(name: str, progress: "Progress") -> str:
    """Return the latest reading of an instrument, or for how long it has sent no row: the last reading is then old."""
    if progress.reading is None:
        return ""
    if progress.silent_s:
        return f"{name}: no data {progress.silent_s:.1f} s"
    return progress.reading.of(progress) if progress.latest else ""


def sparkline(values: Sequence[float]) -> str:
    """Return values as bars, scaled from the smallest value to the largest."""
    if not values:
        return ""
    least, range_ = min(values), max(values) - min(values)
    if not range_:
        return _BARS[0] * len(values)
    return "".join(_BARS[min(int((value - least) / range_ * len(_BARS)), len(_BARS) - 1)] for value in values)


def _time_text(recorder: "Recorder") -> str:
    """Return the remaining time, or the elapsed time of a recording without a set end."""
    left = recorder.for_s is not None
    seconds = max(recorder.for_s - recorder.seconds, 0.0) if recorder.for_s is not None else recorder.seconds
    shown = f"{seconds:.1f} s" if seconds < _MINUTES_FROM_S else clock(seconds)
    return f"{shown:>6}{' left' * left}"
