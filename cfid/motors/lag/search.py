"""The search for a lag: a record's samples, the model of them over map, lag and supply, and where to begin."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import OptimizeResult, least_squares

from cfid.counted import counted
from cfid.errors import FitError
from cfid.estimate.linear import gain_of
from cfid.estimate.signals import block_means
from cfid.motors.lag.model import LogSegment, Signal, Supply, speed_shown
from cfid.motors.lag.plausibility import varies
from cfid.motors.lag.uncertainty import Expected

Array = npt.NDArray[np.float64]

SETTLING_S = 1.0  # of each piece, in which its unknown initial state decays
_FEWEST = 200  # samples
_FINEST_S = 2e-3  # more frequent samples are averaged: rotors take many times longer
_FINEST_VOLTS_S = 5e-3  # voltages change by a few percent
_ROUNDED = 1e-6  # of a row: two of 1 ms, whose times are rounded, are as far apart as 2 ms
_QUICKEST_S, _SLOWEST_S, _EARLIEST_S, _LATEST_S = 1e-3, 2.0, -0.2, 0.5
_STARTS_S, _STARTS_LATE_S = (0.015, 0.04, 0.1, 0.25), (0.0, 0.02, 0.06)
SUPPLY_STD = Supply(power=0.5, whole=1.0, late=0.5)  # uncertainty of a supply about the usual one
_CLOSE = 1e-6  # relative to the cost of thousands of samples: far below the uncertainty
_MOST_STEPS = 60  # of the search; a record that shows a lag needs 10


class Search(NamedTuple):
    """A record to fit: what its pieces measured (n,), the model over parameters (8,), and what is expected of these.

    The search begins at `start` (8,), and `scale` (8,) is the size of each parameter.
    """

    pieces: Sequence[LogSegment]
    measured: Array
    shown: Callable[[Array], Array]
    expected: Expected
    start: Array
    scale: Array

    def fitted(self, begin: Array, white: Callable[[Array], Array], **loss: Any) -> OptimizeResult:
        """Return the parameters with the least errors, whitened by `white`, found from `begin` (8,) on."""
        change = np.diff(white(self.shown(begin) - self.measured))  # a start is off smoothly: this is noise
        noise = max(float(np.std(change)) / math.sqrt(2), 1e-12)
        free = len(self.expected.value)
        return least_squares(
            lambda p: np.append(white(self.shown(p) - self.measured), self.expected.residual(p, noise=noise)),
            begin,
            x_scale=self.scale,
            bounds=(
                np.array([-np.inf] * 3 + [_QUICKEST_S, _QUICKEST_S, _EARLIEST_S] + [-np.inf] * free),
                np.array([np.inf] * 3 + [_SLOWEST_S, _SLOWEST_S, _LATEST_S] + [np.inf] * free),
            ),
            ftol=_CLOSE,
            xtol=_CLOSE,
            max_nfev=_MOST_STEPS,
            **loss,
        )


def search_of(pieces: Sequence[LogSegment]) -> Search:
    """Return what is to be fitted. Raises FitError for fewer than 200 samples."""
    pieces = [found for piece in pieces if (found := _thinned(piece)) is not None]
    measured = np.concatenate([piece.measured.value for piece in pieces]) if pieces else np.zeros(0)
    if len(measured) < _FEWEST:
        raise FitError(
            f"{counted(len(measured), 'sample')} after the first {SETTLING_S:g} s with the rotors running "
            f"(limit {_FEWEST})."
        )
    expected, start = _expected(pieces), start_of(pieces, measured)
    scale = np.concatenate([np.full(3, max(float(np.std(measured)), 1e-12)), start[[3, 4, 3]], expected.scale])
    return Search(pieces, measured, speed_shown(pieces), expected, start, scale)


def _thinned(piece: LogSegment) -> LogSegment | None:
    """Return a piece without unknown values and without its start, with at most one sample in 2 ms."""
    time_s, value = piece.measured
    known = np.isfinite(value) & (time_s >= piece.drive.time_s[0] + SETTLING_S)
    time_s, value = time_s[known], value[known]
    if len(time_s) < 2:
        return None
    length = max(int(_FINEST_S / np.median(np.diff(time_s)) + _ROUNDED), 1)
    measured = Signal(block_means(time_s, length=length), block_means(value, length=length))
    volts = piece.volts
    if volts is not None:
        length = max(int(_FINEST_VOLTS_S / np.median(np.diff(volts.time_s)) + _ROUNDED), 1)
        volts = Signal(*(block_means(series, length=length) for series in volts))
    every_s = math.inf if volts is None else _FINEST_VOLTS_S
    return LogSegment(_changes(piece.drive, every_s=every_s), measured, volts, piece.gaps_s)


def _expected(pieces: Sequence[LogSegment]) -> Expected:
    """Return what is expected of the supply: of no parameter where no voltage is known."""
    volts = [piece.volts for piece in pieces if piece.volts is not None]
    value = np.array(Supply() if volts else ())
    return Expected(value, np.array(SUPPLY_STD[: len(value)]), any(map(varies, volts)))


def _changes(drive: Signal, *, every_s: float) -> Signal:
    """Return a drive without the rows that repeat the one before, but with one row in each interval of `every_s`."""
    kept = np.append(True, (np.diff(drive.value) != 0) | (np.diff(drive.time_s // every_s) > 0))
    return Signal(drive.time_s[kept], drive.value[kept])


def start_of(pieces: Sequence[LogSegment], measured: Array) -> Array:
    """Return the best map and lag on a coarse grid, equally fast upwards and downwards, with the usual supply (8,).

    Without a voltage, the supply is left out (6,).
    """
    usual = () if pieces[0].volts is None else Supply()
    shown, best, found = speed_shown(pieces), np.inf, np.zeros(6)
    for tau_s in _STARTS_S:
        for late_s in _STARTS_LATE_S:
            lag = [tau_s, tau_s, late_s, *usual]
            rows = np.column_stack([shown(np.array([*power, *lag])) for power in np.eye(3)])
            values = gain_of(rows) @ measured
            left = float(np.sum((measured - rows @ values) ** 2))
            if left < best:
                best, found = left, np.concatenate([values, lag])
    return found
