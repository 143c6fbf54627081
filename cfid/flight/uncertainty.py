"""How uncertain a fit to flights is: residuals that hang together, manoeuvres that differ, older torques."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from cfid.estimate.linear import gain_of, sandwich
from cfid.flight.likelihood import PAST, White
from cfid.flight.rows import AXES

Array = npt.NDArray[np.float64]

_PART = 500  # rows: 5 s, in which a flight's manoeuvres change
_OLDER = 2  # rows, so that no row of an error's difference is in an instrument's


def excess_of_older_torques(jacobian: Array, residual: Array, white: Sequence[White]) -> Array:
    """Return by how much the last three parameters change if torques of two rows before are instruments, less noise.

    An autopilot that answers to the gyro's noise within a row, or rotors that are no first-order lag, make the two
    differ. Less two standard uncertainties of the difference, so that noise alone changes nothing.
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
    """Return the covariance (p, p) of a fit to blocks of rows, from each of which other terms (k, q) were taken.

    A model that is not quite right errs otherwise in each manoeuvre: where parts of 5 s scatter by more than noise
    explains, it is wider.
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
