"""Estimate noise that is correlated in time, from the residuals of a least-squares fit.

A fit's parameters follow slow noise, most of all in the data that determine them: the residuals are then smaller than
the noise. The restricted likelihood of the residuals accounts for that (H. D. Patterson, R. Thompson, Recovery of
inter-block information when block sizes are unequal, Biometrika 58, 1971).
"""

import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from cfid.estimate.propagation import widened

Array = npt.NDArray[np.float64]

# Of the variance, the white parts that are tried.
_WHITE = np.array([1.0, 0.5, 0.2, 0.1, 0.03, 0.01, 1e-3, 1e-4, 1e-6])[:, np.newaxis]


def noise_covariance(jacobian: Array, residual: Array, correlations: Iterable[Array]) -> Array:
    """Return the covariance (n, n) of the noise in data, from a fit's Jacobian (n, p) and residuals (n,).

    One part is white, the other has one of `correlations` (n, n): those with the largest restricted likelihood, scaled
    to the size of the residuals. The size is estimated from n - p values and increased so that 1.96 standard
    uncertainties cover 95 % (Student's t).
    """
    count, taken = jacobian.shape
    complement = np.linalg.qr(jacobian, mode="complete")[0][:, taken:]
    left, freedom = complement.T @ residual, count - taken
    best, found = math.inf, np.eye(count)
    for correlation in correlations:
        sizes, directions = np.linalg.eigh(complement.T @ correlation @ complement)
        spread = (1 - _WHITE) * np.maximum(sizes, 0.0) + _WHITE
        squares = (directions.T @ left) ** 2
        variance = np.maximum(np.mean(squares / spread, axis=1), 1e-300)
        deviance = freedom * np.log(variance) + np.log(spread).sum(axis=1)
        place = int(deviance.argmin())
        if deviance[place] < best:
            white, best = float(_WHITE[place, 0]), float(deviance[place])
            size = float(squares.sum() / spread[place].sum())
            found = size * ((1 - white) * correlation + white * np.eye(count))
    return np.asarray(found * widened(1.0, freedom) ** 2)
