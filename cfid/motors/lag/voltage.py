"""A battery's voltage under its rotors: it gives way as they need, which their speeds show better than its readings."""

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from cfid.estimate.linear import gain_of
from cfid.motors.lag.model import Signal
from cfid.motors.lag.plausibility import clipped

Array = npt.NDArray[np.float64]

_FEWEST = 10  # readings to each value that they show
_EXPLAINED = 0.5  # of the variance of the readings, beside a slow change: less is no sag under load
_HALVES_S = (4.0, 2.0, 1.0, 0.5, 0.2, 0.1)  # to either side, over which what no speed explains is averaged
_NOISE = 1.1  # times the variance of neighbours' differences: an average that leaves more has lost a change


def volts_at(volts: Signal, speeds: Iterable[Signal], time_s: Array) -> Array:
    """Return the volts (n,) of a battery at times (n,), by its readings and by the speeds under which it gives way.

    It changes with the squares of speeds, as far as its readings show that, and slowly beside this. With its readings
    as they are, their noise, and what happens between two of them, would look as if speeds hardly felt the voltage.
    """
    each = [known for one in speeds if len((known := _known(one)).time_s)]
    if len(volts.time_s) < _FEWEST * (len(each) + 3):
        return np.interp(time_s, *volts)
    slow, squares = (volts.time_s - volts.time_s.mean())[:, np.newaxis] ** np.arange(3), _squares(each, volts.time_s)
    sag = (gain_of(np.column_stack([slow, squares])) @ volts.value)[3:]
    left = volts.value - squares @ sag
    if np.var(_beside(left, slow)) > (1 - _EXPLAINED) * np.var(_beside(volts.value, slow)):
        return np.interp(time_s, *volts)
    return np.asarray(np.interp(time_s, *_smooth(Signal(volts.time_s, left))) + _squares(each, time_s) @ sag)


def _known(speed: Signal) -> Signal:
    there = np.isfinite(speed.value)
    return Signal(speed.time_s[there], speed.value[there])


def _squares(speeds: Iterable[Signal], time_s: Array) -> Array:
    """Return the squares (n, k) of speeds at times (n,), those that are far from most as if nearer."""
    none = np.zeros((len(time_s), 0))
    return np.column_stack([none, *(np.interp(time_s, at_s, clipped(speed)) ** 2 for at_s, speed in speeds)])


def _beside(value: Array, rows: Array) -> Array:
    """Return values (n,) without what rows (n, m) explain of them."""
    return np.asarray(value - rows @ (gain_of(rows) @ value))


def _smooth(signal: Signal) -> Signal:
    """Return a signal without its noise: averaged over as long as that takes nothing else away."""
    time_s, value = signal
    noise, total = np.var(np.diff(value)) / 2, np.append(0.0, np.cumsum(value))
    for half_s in _HALVES_S:
        first, last = np.searchsorted(time_s, time_s - half_s), np.searchsorted(time_s, time_s + half_s, side="right")
        mean = (total[last] - total[first]) / (last - first)
        if np.var(value - mean) <= _NOISE * noise:
            return Signal(time_s, mean)
    return signal
