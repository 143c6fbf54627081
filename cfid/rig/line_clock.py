"""Judges lines by the clock of the device that sent them, and counts lines that are missing between others."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from cfid.rig.line_summary import OFF, UNLIKE

_WRAP = 1 << 32  # of a device's clock
_MOST_FALSE = 3  # lines in a row: more show that the number is no clock
_WINDOW, _FEWEST = 64, 20  # lines that show the usual interval
_USUAL = 0.75  # quantile of the intervals: lines sent twice, or a device that waits, are no losses


class Line(NamedTuple):
    """A line's arrival by this computer's clock, and its numbers.

    `step_s` is the time since the line before, by the device's clock where it sends one; None where it is unknown.
    """

    received_s: float
    numbers: tuple[float, ...]
    step_s: float | None


class Arrivals:
    """Takes lines of a device without a clock: their times are those of arrival."""

    false = repeats = 0

    def __init__(self) -> None:
        """Start with no line."""
        self._last_s: float | None = None

    def credible(self, received_s: float, readings: Sequence[tuple[float, ...]]) -> list[Line]:
        """Return the lines that arrived at one time, in order."""
        found = []
        for numbers in readings:
            found.append(Line(received_s, numbers, None if self._last_s is None else received_s - self._last_s))
            self._last_s = received_s
        return found

    def settle(self) -> list[Line]:
        """Return no line at the end, since none was unconfirmed."""
        return []


class DeviceClock:
    """Takes lines whose clock continues that of earlier lines; `false` counts the others, which are left out.

    `repeats` counts lines that repeat the line before, its clock included.

    Two lines that ran into one have a number of too many digits: the clock jumps back, or ahead of this computer's,
    for one line. Lines come late, never early, so that a true clock is never ahead of the quickest line's. Where later
    lines continue from the new number, the device was restarted, and all of them count. The first lines count once
    a line continues from one of them.
    """

    def __init__(self, place: int, *, tick_s: float, early_s: float) -> None:
        """Take the clock's place in a line, how long its tick lasts, and how far ahead of time a line may be."""
        self.false = self.repeats = 0
        self._place, self._tick_s, self._early_s = place, tick_s, early_s
        self._last: Line | None = None
        self._late_s = 0.0  # how much later than the quickest line the last one came
        self._unconfirmed: list[Line] = []
        self._is_clock = True

    def credible(self, received_s: float, readings: Sequence[tuple[float, ...]]) -> list[Line]:
        """Return, in order, the lines that count among those that came together and the unconfirmed ones before."""
        return [line for numbers in readings for line in self._judged(Line(received_s, numbers, None))]

    def settle(self) -> list[Line]:
        """Count lines unconfirmed at the end as false, but return a single first one, which no other refutes."""
        if self._last is None and len(self._unconfirmed) == 1:
            return self._begun(self._unconfirmed)
        self._leave_out()
        return []

    def _leave_out(self) -> None:
        self.false += len(self._unconfirmed)
        self._unconfirmed = []

    def _judged(self, line: Line) -> list[Line]:
        if not self._is_clock:
            return self._begun([line])
        if self._last is None:
            for place, before in enumerate(self._unconfirmed):
                if self._after(before, 0.0, line) is not None:
                    self._last = self._unconfirmed.pop(place)
                    return [before, *self._judged(line)]
        elif (late_s := self._after(self._last, self._late_s, line)) is not None:
            self._leave_out()
            step_s = self._step_s(self._last, line)
            self.repeats += int(line.numbers == self._last.numbers)
            self._last, self._late_s = line, max(late_s, 0.0)
            return [line._replace(step_s=step_s)]
        anew = bool(self._unconfirmed) and self._after(self._unconfirmed[-1], 0.0, line) is not None
        self._unconfirmed.append(line)
        self._is_clock = len(self._unconfirmed) <= _MOST_FALSE
        return self._begun(self._unconfirmed) if anew or not self._is_clock else []

    def _begun(self, lines: list[Line]) -> list[Line]:
        """Continue from the last of some lines, with which the clock started anew."""
        self._last, self._late_s, self._unconfirmed = lines[-1], 0.0, []
        return lines

    def _step_s(self, before: Line, line: Line) -> float:
        ticks = round(line.numbers[self._place]) - round(before.numbers[self._place])
        return self._tick_s * ((ticks + _WRAP // 2) % _WRAP - _WRAP // 2)

    def _after(self, before: Line, late_s: float, line: Line) -> float | None:
        """Return how much later than the quickest a line came; None if it does not continue `before`, `late_s` late."""
        here_s, step_s = line.received_s - before.received_s, self._step_s(before, line)
        now_late_s = late_s + here_s - step_s
        return now_late_s if step_s >= 0 and now_late_s > -self._early_s - UNLIKE * here_s else None


class Spacing:
    """Counts lines that are missing between those that came, by their usual interval.

    A usual interval below a limit is not used: the clock is too coarse, or the computer delays arrivals too much. Nor
    is one shorter than `rate_hz` implies: after a pause a device may send overdue lines all at once.
    """

    def __init__(self, rate_hz: float, *, shortest_s: float) -> None:
        """Take the stated rate, and the shortest usual interval by which lines can be counted."""
        self.missing = 0
        self._stated_s, self._shortest_s = 1 / rate_hz, shortest_s
        self._steps_s: list[float] = []
        self._known = self._open = 0

    def add(self, steps_s: Iterable[float], *, known: int) -> None:
        """Take the intervals (n,) between lines, and how many of the missing lines are already counted as lost."""
        self._steps_s += steps_s
        self._known += known
        if len(self._steps_s) >= _WINDOW:
            self._count()

    def settle(self) -> None:
        """Count what is still open at the end."""
        if len(self._steps_s) >= _FEWEST:
            self._count()
        self.missing, self._open = self.missing + self._open, 0

    def _count(self) -> None:
        """Count lines missing since the last count; late lines, in this count or the next, make up for them."""
        steps_s, known = np.array(self._steps_s), self._known
        self._steps_s, self._known = [], 0
        usual_s = max(float(np.quantile(steps_s, _USUAL)), (1 - OFF) * self._stated_s)
        if usual_s < self._shortest_s:
            return
        here = int(np.sum(np.rint(steps_s / usual_s) - 1)) - known
        if here >= 0:
            self.missing, self._open = self.missing + self._open, here
        else:
            self._open = max(self._open + here, 0)
