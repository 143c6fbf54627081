"""Judges lines by the clock of the device that sent them: how long after the line before each was sent."""

from collections.abc import Sequence
from typing import NamedTuple

_WRAP = 1 << 32  # of a device's clock
UNLIKE = 0.01  # fraction of this computer's time by which a device's clock may deviate


class Line(NamedTuple):
    """A line's arrival by this computer's clock, and its numbers.

    `step_s` is the time since the line before, by the device's clock; None where that does not show it.
    """

    received_s: float
    numbers: tuple[float, ...]
    step_s: float | None


class Arrivals:
    """Takes lines of a device without a clock."""

    false = in_doubt = 0

    def credible(self, received_s: float, readings: Sequence[tuple[float, ...]]) -> list[Line]:
        """Return the lines that arrived at one time, in order."""
        return [Line(received_s, numbers, None) for numbers in readings]


class DeviceClock:
    """Takes lines whose clock continues that of the line before; `false` counts the others, which are left out.

    Two lines that ran into one have a number of too many digits: the clock jumps back, or ahead of this computer's,
    for one line. Lines come late, never early, so that a true clock is never ahead of the quickest line's. Where the
    next line continues from the new number, the device was restarted, and both count. The first line counts once a
    line continues from it.
    """

    def __init__(self, place: int, *, tick_s: float, early_s: float) -> None:
        """Take the clock's place in a line, how long its tick lasts, and how far ahead of time a line may be."""
        self.false = self.in_doubt = 0  # in_doubt: lines left out since the last that counted
        self._place, self._tick_s, self._early_s = place, tick_s, early_s
        self._last: Line | None = None
        self._late_s = 0.0  # how much later than the quickest line the last one came
        self._doubted: Line | None = None  # the line before, if it did not continue

    def credible(self, received_s: float, readings: Sequence[tuple[float, ...]]) -> list[Line]:
        """Return, in order, the lines that count among those that came together and the doubted one before."""
        return [line for numbers in readings for line in self._judged(Line(received_s, numbers, None))]

    def _judged(self, line: Line) -> list[Line]:
        doubted, self._doubted = self._doubted, None
        for before, late_s, lines in ((self._last, self._late_s, ()), (doubted, 0.0, (doubted,))):
            if before is not None and (step_s := self._step_s(before, late_s, line)) is not None:
                self.false, self.in_doubt, self._last = self.false - len(lines), 0, line
                self._late_s = max(late_s + line.received_s - before.received_s - step_s, 0.0)
                return [*filter(None, lines), line._replace(step_s=step_s)]
        self._doubted = line
        self.false, self.in_doubt = self.false + 1, self.in_doubt + 1
        return []

    def _step_s(self, before: Line, late_s: float, line: Line) -> float | None:
        """Return how long after `before`, which came `late_s` late, a line was sent; None if it does not continue."""
        ticks = round(line.numbers[self._place]) - round(before.numbers[self._place])
        step_s = self._tick_s * ((ticks + _WRAP // 2) % _WRAP - _WRAP // 2)
        here_s = line.received_s - before.received_s
        return step_s if 0 <= step_s < late_s + here_s + self._early_s + UNLIKE * here_s else None
