"""A battery's voltage under the load of its rotors: it sags, which their speeds show better than its readings."""

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from cfid.estimate.linear import gain_of
from cfid.large import empty, parts, stored
from cfid.motors.lag.model import Signal
from cfid.motors.lag.plausibility import clipped

Array = npt.NDArray[np.float64]

_FEWEST = 10  # readings for each value that is taken from them
_RANKED = 100_000  # most readings that are used to see how speeds affect them
_EXPLAINED = 0.5  # of the variance of the readings about a slow change: less is no sag under load
_HALVES_S = (4.0, 2.0, 1.0, 0.5, 0.2, 0.1)  # half widths over which the part that no speed explains is averaged
_NOISE = 1.1  # times the variance of neighbours' differences: an average that leaves more has lost a change


def volts_at(volts: Signal, speeds: Iterable[Signal], time_s: Array) -> Array:
    """Return the volts (n,) of a battery at times (n,), from its readings and from the speeds under which it sags.

    The voltage changes with the squares of speeds, as far as its readings show that, and in addition slowly. If the
    readings were taken as they are, their noise and what happens between two of them would make speeds seem hardly to
    depend on the voltage.
    """
    squares = [square for one in speeds if len((square := _square(one)).time_s)]
    sag = _sag(volts, squares)
    if sag is None:
        return np.interp(time_s, *volts)
    left = empty(len(volts.time_s))
    for part in parts(len(left)):
        left[part] = volts.value[part] - _at(squares, volts.time_s[part]) @ sag
    slow, found = _smooth(Signal(volts.time_s, left)), empty(len(time_s))
    for part in parts(len(found)):
        found[part] = np.interp(time_s[part], *slow) + _at(squares, time_s[part]) @ sag
    return found


def _sag(volts: Signal, squares: Sequence[Signal]) -> Array | None:
    """Return the volts (k,) per square of each of k speeds, None where the readings do not follow these."""
    time_s, value = (one[:: len(one) // _RANKED + 1] for one in volts)
    if len(time_s) < _FEWEST * (len(squares) + 3):
        return None
    slow, fast = (time_s - time_s.mean())[:, np.newaxis] ** np.arange(3), _at(squares, time_s)
    sag = (gain_of(np.column_stack([slow, fast])) @ value)[3:]
    left = np.var(_beside(value - fast @ sag, slow))
    return sag if left <= (1 - _EXPLAINED) * np.var(_beside(value, slow)) else None


def _square(speed: Signal) -> Signal:
    """Return the square of a speed where it is known; values far from most are clipped."""
    there = np.isfinite(speed.value)
    time_s, value = speed if there.all() else (speed.time_s[there], speed.value[there])
    return Signal(stored(time_s), stored(clipped(value) ** 2))


def _at(squares: Iterable[Signal], time_s: Array) -> Array:
    """Return squares of speeds (n, k) at times (n,)."""
    return np.column_stack([np.zeros((len(time_s), 0)), *(np.interp(time_s, *square) for square in squares)])


def _beside(value: Array, rows: Array) -> Array:
    """Return values (n,) without the part that rows (n, m) explain."""
    return np.asarray(value - rows @ (gain_of(rows) @ value))


def _smooth(signal: Signal) -> Signal:
    """Return a signal without its noise: averaged over the longest time that removes nothing else."""
    time_s, value = signal
    noise, total = np.var(np.diff(value)) / 2, np.append(0.0, np.cumsum(value))
    mean = empty(len(value))
    for half_s in _HALVES_S:
        for part in parts(len(mean)):
            first = np.searchsorted(time_s, time_s[part] - half_s)
            last = np.searchsorted(time_s, time_s[part] + half_s, side="right")
            mean[part] = (total[last] - total[first]) / (last - first)
        if np.var(value - mean) <= _NOISE * noise:
            return Signal(time_s, mean)
    return signal
