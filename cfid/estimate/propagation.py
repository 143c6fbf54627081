"""Uncertainties by the GUM: common weights, degrees of freedom, and repeated measurements."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc, ndtri, stdtrit

from cfid.errors import FitError

Array = npt.NDArray[np.float64]

LEAST_PROBABILITY = 0.01  # of values that agree, the least probability
_DAY_S = 86400.0


def covariance_of_weights(weight: Array, std: Array) -> Array:
    """Return the covariance (n, n) of weights (n,) with standard uncertainties (n,): equal ones are one weight."""
    return np.asarray(np.outer(std, std) * (weight[:, np.newaxis] == weight))


def widened(std: float, freedom: float) -> float:
    """Return a standard uncertainty whose 1.96-fold covers 95 %, from one estimated from few residuals."""
    return float(std * widening(freedom))


def widening(freedom: npt.ArrayLike) -> Array:
    """Return the factor (...) from an estimated standard uncertainty to one whose 1.96-fold covers 95 % (Student's t).

    Readers of a standard uncertainty multiply it by 1.96; with two degrees of freedom the factor would be 4.3.
    """
    return np.asarray(stdtrit(freedom, 0.975) / ndtri(0.975))


def effective_freedom(stds: Array, freedom: Array) -> Array:
    """Return the degrees of freedom (...) of a sum of independent errors, by Welch and Satterthwaite (GUM G.4).

    Each of the errors (m, ...) has its standard uncertainty and the degrees of freedom that this was estimated with.
    """
    squares = np.asarray(stds) ** 2
    total, fourth = squares.sum(axis=0), (squares**2 / freedom).sum(axis=0)
    return np.asarray(np.divide(total**2, fourth, out=np.full_like(total, np.inf), where=fourth > 0))


@dataclass(frozen=True, kw_only=True)
class Repeats:
    """The mean of n values and its standard uncertainty, their scatter, and their change per day.

    `probability` is that of values of one quantity with the stated uncertainties differing at least as much; None where
    a value has no uncertainty, and only the scatter counts. The drift is None with fewer than three times.
    """

    mean: float
    mean_std: float
    scatter: float
    chi_squared: float
    freedom: int
    probability: float | None
    drift_per_day: float | None
    drift_std_per_day: float | None

    @property
    def agree(self) -> bool:
        """Whether the stated uncertainties explain the differences, or cannot exclude it."""
        return self.probability is None or self.probability >= LEAST_PROBABILITY


def repeats(*, time_s: Array, value: Array, std: Array) -> Repeats:
    """Compare values (n,) measured at times (n,), each with its standard uncertainty, NaN where there is none.

    The mean is weighted with the stated uncertainties. These may have causes in common, such as a rig's geometry,
    scales or gravity, which repetition does not average out: the mean's standard uncertainty is that of the values. If
    the values scatter by more than that explains, it is increased (R. T. Birge, The calculation of errors by the method
    of least squares, Physical Review 40, 1932).

    Raises FitError for fewer than two values.
    """
    if len(value) < 2:
        raise FitError(f"{len(value)} value does not repeat: it takes two.")
    stated = bool(np.all(np.isfinite(std) & (std > 0)))
    weight = 1 / std if stated else np.ones(len(value))

    def birge(residual: Array, freedom: int) -> float:
        ratio = math.sqrt(float(np.sum((weight * residual) ** 2)) / freedom)
        return max(ratio, 1.0) if stated else ratio

    mean, freedom = float(np.average(value, weights=weight**2)), len(value) - 1
    chi_squared = float(np.sum((weight * (value - mean)) ** 2))
    alone = birge(value - mean, freedom) / float(np.linalg.norm(weight))
    drift = drift_std = None
    day = time_s / _DAY_S
    if len(np.unique(day)) > 2:
        line, covariance = np.polyfit(day - day.mean(), value, 1, w=weight, cov="unscaled")
        left = value - np.polyval(line, day - day.mean())
        drift, drift_std = float(line[0]), birge(left, len(value) - 2) * math.sqrt(covariance[0, 0])
    return Repeats(
        mean=mean,
        mean_std=max(float(weight.sum() / (weight @ weight)), alone) if stated else alone,
        scatter=0.0 if np.ptp(value) == 0 else float(np.std(value, ddof=1)),
        chi_squared=chi_squared,
        freedom=freedom,
        probability=float(chdtrc(freedom, chi_squared)) if stated else None,
        drift_per_day=drift,
        drift_std_per_day=drift_std,
    )
