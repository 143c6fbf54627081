"""Estimate the uncertainty of a fit to flights: correlated residuals, different manoeuvres, older torques."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from cfid.estimate.linear import gain_of, sandwich
from cfid.flight.likelihood import PAST, White
from cfid.flight.rows import AXES

Array = npt.NDArray[np.float64]

_PART = 500  # rows: 5 s, after which a flight's manoeuvres are different ones
_OLDER = 2  # rows, so that the difference of errors and the instrument have no row in common


def excess_of_older_torques(jacobian: Array, residual: Array, white: Sequence[White]) -> Array:
    """Return the change of the last three parameters with torques of two rows before as instruments, less noise.

    The two estimates differ if an autopilot responds to the gyro's noise within a row, or if rotors are not a
    first-order lag. Two standard uncertainties of the difference are subtracted, so that noise alone changes nothing.
    """
    turns = jacobian[:, -len(AXES) :]
    older = np.zeros_like(turns)
    begin = 0
    for one in white:
        for length in one.lengths:
            end = begin + length - PAST
            older[begin + _OLDER : end] = turns[begin : end - _OLDER]
            begin = end
    excess = np.zeros(len(AXES))
    for axis, (now, before) in enumerate(zip(turns.T, older.T, strict=True)):
        if abs(float(before @ now)) > 0:
            influence = (before / float(before @ now) - now / float(now @ now)) * residual
            excess[axis] = max(abs(float(np.sum(influence))) - 2 * math.sqrt(float(influence @ influence)), 0.0)
    return excess


def covariance_of(jacobian: Array, residual: Array, taken: Sequence[Array]) -> Array:
    """Return the covariance (p, p) of a fit to blocks of rows, from each of which other terms (k, q) were removed.

    An imperfect model has a different error in each manoeuvre: where parts of 5 s scatter by more than noise explains,
    the covariance is increased.
    """
    lengths = [len(one) for one in taken]
    freedom = 1 - sum(one.shape[1] for one in taken) / len(residual)
    covariance = sandwich(jacobian, residual, longest=max(len(residual) // (8 * len(lengths)), 10)) / freedom
    influence = gain_of(jacobian).T * residual[:, np.newaxis]
    ends = [end for one in lengths for end in [*range(0, one - _PART // 2, _PART)]]
    starts = np.repeat(np.cumsum([0, *lengths[:-1]]), [len(range(0, one - _PART // 2, _PART)) for one in lengths])
    sums = np.add.reduceat(influence, starts + np.array(ends, dtype=int), axis=0)
    scatter = np.sum(sums**2, axis=0)
    wider = np.sqrt(np.maximum(scatter / np.maximum(np.diag(covariance), 1e-300), 1.0))
    return np.asarray(covariance * np.outer(wider, wider))
