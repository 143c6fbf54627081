"""A battery's voltage under the load of its rotors: it sags, which their speeds show better than its readings."""

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from cfid.estimate.linear import gain_of
from cfid.motors.rotor.model import Signal

Array = npt.NDArray[np.float64]

_FEWEST = 10  # readings for each value that is taken from them
_EXPLAINED = 0.5  # of the variance of the readings about a slow change: less is no sag under load
_HALVES_S = (4.0, 2.0, 1.0, 0.5, 0.2, 0.1)  # half widths over which the part that no speed explains is averaged
_NOISE = 1.1  # times the variance of neighbours' differences: an average that leaves more has lost a change


def volts_at(volts: Signal, loads: Sequence[Signal], own: int, time_s: Array) -> tuple[Array, float]:
    """Return the volts (n,) of a battery at times (n,) without the load of one rotor, and the volts that this adds.

    The latter are per square of its speed. The voltage changes with the squares of the speeds of all `loads`, as far as
    its readings show that, and in addition slowly. If the readings were taken as they are, their noise and what happens
    between two of them would make speeds seem hardly to depend on the voltage; and if it were calculated from the
    measured speed of the rotor itself, whose noise is what a fit explains, the fit would avoid it.
    """
    squares = [Signal(load.time_s, load.value**2) for load in loads]
    sag = _sag(volts, squares)
    if sag is None:
        return np.interp(time_s, *volts), 0.0
    slow = _smooth(Signal(volts.time_s, volts.value - _at(squares, volts.time_s) @ sag))
    others = np.where(np.arange(len(sag)) == own, 0.0, sag)
    return np.interp(time_s, *slow) + _at(squares, time_s) @ others, float(sag[own])


def _sag(volts: Signal, squares: Sequence[Signal]) -> Array | None:
    """Return the volts (k,) per square of each of k speeds, None where the readings do not follow these."""
    time_s, value = volts
    if len(time_s) < _FEWEST * (len(squares) + 3):
        return None
    slow, fast = (time_s - time_s.mean())[:, np.newaxis] ** np.arange(3), _at(squares, time_s)
    sag = (gain_of(np.column_stack([slow, fast])) @ value)[3:]
    left = np.var(_beside(value - fast @ sag, slow))
    return sag if left <= (1 - _EXPLAINED) * np.var(_beside(value, slow)) else None


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
    for half_s in _HALVES_S:
        first = np.searchsorted(time_s, time_s - half_s)
        last = np.searchsorted(time_s, time_s + half_s, side="right")
        mean = (total[last] - total[first]) / (last - first)
        if np.var(value - mean) <= _NOISE * noise:
            return Signal(time_s, mean)
    return signal
