"""Estimate linearly with covariances: least squares, means, correlated residuals, and propagation to other values.

Residuals of a record are correlated in time: `sandwich` estimates the correlation from the residuals themselves.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cfid.estimate.signals import correlation_inflation

Array = npt.NDArray[np.float64]

# Of a value, to either side: rounding of the difference and curvature both cause errors of about 1e-10.
_STEP = 1e-6
_SMALLEST = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """Values (p,) with their covariance (p, p), NaN without degrees of freedom to estimate it from.

    `gain` (p, n) maps the data to the values. `residual` (n,) is the rest of the data, in their unit, and
    `degrees_of_freedom` is n - p.
    """

    values: Array
    covariance: Array
    gain: Array
    residual: Array
    degrees_of_freedom: int

    @property
    def std(self) -> Array:
        """The standard uncertainty of each value (p,)."""
        return std_of(self.covariance)


def std_of(covariance: Array) -> Array:
    """Return the standard uncertainties (p,) of a covariance (p, p); rounding below zero counts as zero."""
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def gain_of(rows: Array, *, covariance: Array | None = None) -> Array:
    """Return the gain (p, n) that maps data (n,) to the least-squares solution of rows (n, p).

    With the data's covariance (n, n), which has to be positive definite, it is that of generalised least squares. For
    linearly dependent columns, it gives the smallest solution.
    """
    if covariance is not None:
        white = np.linalg.inv(np.linalg.cholesky(covariance))
        return np.asarray(gain_of(white @ rows) @ white)
    length = np.linalg.norm(rows, axis=0)
    length[length == 0] = 1.0
    return np.asarray(np.linalg.pinv(rows / length) / length[:, np.newaxis])


def fit_linear(rows: Array, data: Array, *, noise_known: bool) -> Estimate:
    """Solve rows (n, p) times values = data (n,) by least squares.

    With `noise_known`, rows and data are in units of the data's standard uncertainties; otherwise the scatter of the
    residuals is the noise, equal for all data.
    """
    gain = gain_of(rows)
    values = gain @ data
    values += gain @ (data - rows @ values)  # corrects for rounding
    residual, freedom = data - rows @ values, len(data) - rows.shape[1]
    variance = 1.0 if noise_known else float(residual @ residual) / freedom if freedom else np.nan
    covariance = variance * (gain @ gain.T)
    return Estimate(values=values, covariance=covariance, gain=gain, residual=residual, degrees_of_freedom=freedom)


def mean_of(data: Array) -> Estimate:
    """Return the mean of data (n,); their scatter (with n - 1) is the noise."""
    return fit_linear(np.ones((len(data), 1)), data, noise_known=False)


def weighted_mean(data: Array, *, std: Array) -> Estimate:
    """Return the mean of data (n,) weighted by their independent standard uncertainties (n,)."""
    found = fit_linear(1 / std[:, np.newaxis], data / std, noise_known=True)
    return replace(found, gain=found.gain / std, residual=found.residual * std)


def sandwich(jacobian: Array, residual: Array, *, longest: int) -> Array:
    """Return the covariance (p, p) of a least-squares fit whose residuals (n,) are correlated with each other.

    `jacobian` (n, p) has the residuals' derivatives with respect to the values. An estimate is a weighted sum of
    residuals: their correlation along the record, up to `longest` samples apart, determines how much less they average
    out than white noise would.
    """
    count, estimates = jacobian.shape
    influence = gain_of(jacobian).T * residual[:, np.newaxis]
    inflation = np.array([correlation_inflation(column, longest=longest) for column in influence.T])
    widening = np.sqrt(inflation * count / max(count - estimates, 1))
    return np.asarray(influence.T @ influence * np.outer(widening, widening))


def slopes(function: Callable[[Array], Array], values: Array) -> Array:
    """Return the central differences (m, p) of a function of values (p,)."""
    columns = []
    for place, size in enumerate(np.maximum(np.abs(values), _SMALLEST)):
        step = np.zeros(len(values))
        step[place] = _STEP * size
        columns.append((function(values + step) - function(values - step)) / (2 * _STEP * size))
    return np.stack(columns, axis=1)


def propagated(function: Callable[[Array], Array], values: Array, covariance: Array) -> Array:
    """Return the covariance (m, m) of a function of values (p,) with covariance (p, p), to first order."""
    outward = slopes(function, values)
    return np.asarray(outward @ covariance @ outward.T)
