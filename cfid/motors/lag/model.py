"""The response to commands that are held: a lag with one time constant upwards and one downwards, and a static map."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.estimate.held_lag import follow_held

Array = npt.NDArray[np.float64]

_STRAIGHT_STEPS = 4  # in which a drive goes straight from row to row


class Signal(NamedTuple):
    """Values (n,) at increasing times (n,) in s; those of a command hold until the next."""

    time_s: Array
    value: Array

    def between(self, from_s: float, to_s: float) -> "Signal":
        """Return the part of the signal from one time until before another."""
        inside = (self.time_s >= from_s) & (self.time_s < to_s)
        return Signal(self.time_s[inside], self.value[inside])

    def held(self, time_s: Array) -> Array:
        """Return the values that hold at times (m,); before the signal begins, that is its first value."""
        return np.asarray(self.value[np.maximum(np.searchsorted(self.time_s, time_s, side="right") - 1, 0)])

    def straight(self) -> "Signal":
        """Return a command that goes straight from row to row, in steps that hold."""
        steps = np.arange(_STRAIGHT_STEPS) / _STRAIGHT_STEPS
        at_s = self.time_s[:-1, np.newaxis] + np.diff(self.time_s)[:, np.newaxis] * steps
        middle = self.value[:-1, np.newaxis] + np.diff(self.value)[:, np.newaxis] * (steps + 0.5 / _STRAIGHT_STEPS)
        return Signal(np.append(at_s, self.time_s[-1]), np.append(middle, self.value[-1]))


class InputLag(NamedTuple):
    """The lag dw/dt = (c - w) / tau: tau is `rising_s` where c > w and `falling_s` elsewhere; c is `delay_s` late."""

    rising_s: float
    falling_s: float
    delay_s: float

    def follow(self, target: Signal, time_s: Array) -> Array:
        """Return the response to a target, from its first value on, at times (n,): exact, whatever the two clocks."""
        begin_s = target.time_s + self.delay_s
        step_s = np.diff(target.time_s)
        (late,) = follow_held(
            target.value[np.newaxis], np.exp(-step_s / self.rising_s), np.exp(-step_s / self.falling_s)
        )
        place = np.maximum(np.searchsorted(begin_s, time_s, side="right") - 1, 0)
        to, since_s = target.value[place], np.maximum(time_s - begin_s[place], 0.0)
        left = late[place] - to
        return np.asarray(to + left * np.exp(-since_s / np.where(left < 0, self.rising_s, self.falling_s)))


class Supply(NamedTuple):
    """The power of the voltage with which speeds change, and whether it acts on their drive or on the whole map of it.

    The power is 1 for a motor at a chopped voltage, and 0 for one whose speed is held. `whole` is the part of the power
    that acts on the whole map, an idle speed included. `late` is the part of the delay that applies to the voltage as
    well: 0 where the command is late, as through a radio or a speed controller, and 1 where the speeds were measured
    late. Both are usual.
    """

    power: float = 1.0
    whole: float = 0.0
    late: float = 0.5


class LogSegment(NamedTuple):
    """A part of a record without a break: what drives a rotor, and its speed.

    The drive is a command, relative to about the largest. `volts` is the battery's voltage relative to its usual one,
    None if unknown; it hardly changes between two values of the drive. `gaps_s` (k, 2) are the start and end times of
    gaps without rows, before and after which the drive differs.
    """

    drive: Signal
    measured: Signal
    volts: Signal | None = None
    gaps_s: Array = np.zeros((0, 2))

    def target(self, map_of: Array, lag: InputLag, supply: Supply) -> Signal:
        """Return the speed that a map (3,) of the drive leads to, by the clock of the commands."""
        drive = self.drive
        if self.volts is None:
            return Signal(drive.time_s, map_of[0] + map_of[1] * drive.value + map_of[2] * drive.value**2)
        log_ratio = np.log(self._ratio(lag, supply))
        value = drive.value * np.exp(supply.power * (1 - supply.whole) * log_ratio)
        target = map_of[0] + value * (map_of[1] + map_of[2] * value)
        return Signal(drive.time_s, target * np.exp(supply.power * supply.whole * log_ratio))

    def _ratio(self, lag: InputLag, supply: Supply) -> Array:
        """Return the known voltage relative to its usual one in the middle of each interval of the drive."""
        assert self.volts is not None
        time_s = self.drive.time_s + (1 - supply.late) * lag.delay_s
        time_s[:-1] += np.diff(self.drive.time_s) / 2
        return np.asarray(np.interp(time_s, *self.volts))


def speed_shown(pieces: Sequence[LogSegment]) -> Callable[[Array], Array]:
    """Return the function from map, lag and supply (8,) to speeds (n,): the speed of the map is what lags."""

    def shown(p: Array) -> Array:
        lag, supply = InputLag(*p[3:6].tolist()), Supply(*p[6:].tolist())
        found = []
        for piece in pieces:
            found.append(lag.follow(piece.target(p[:3], lag, supply), piece.measured.time_s))
        return np.concatenate(found)

    return shown
