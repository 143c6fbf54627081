"""Compare one quantity measured several times, on other days or with other vehicles: agreement and drift.

The mean is weighted with the stated standard uncertainties. These may have causes in common, such as a rig's geometry,
scales or gravity, which repetition does not average out: the mean's standard uncertainty is that of the values. If the
values scatter by more than that explains, it is increased (R. T. Birge, The calculation of errors by the method of
least squares, Physical Review 40, 1932).
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc

from cfid.errors import FitError
from cfid.estimate.linear import fit_linear, weighted_mean

Array = npt.NDArray[np.float64]

LEAST_PROBABILITY = 0.01  # of values that agree, the least probability
_DAY_S = 86400.0


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

    Raises FitError for fewer than two values.
    """
    if len(value) < 2:
        raise FitError(f"{len(value)} value does not repeat: it takes two.")
    stated = bool(np.all(np.isfinite(std) & (std > 0)))
    sigma = std if stated else np.ones(len(value))
    found, freedom = weighted_mean(value, std=sigma), len(value) - 1
    chi_squared = float(np.sum((found.residual / sigma) ** 2))
    shared = float(found.gain[0] @ sigma) if stated else 0.0
    drift, drift_std = _drift(time_s / _DAY_S, value, sigma, stated)
    return Repeats(
        mean=float(found.values[0]),
        mean_std=max(shared, _widened(chi_squared, freedom, stated) * float(found.std[0])),
        scatter=0.0 if np.ptp(value) == 0 else float(np.std(value, ddof=1)),
        chi_squared=chi_squared,
        freedom=freedom,
        probability=float(chdtrc(freedom, chi_squared)) if stated else None,
        drift_per_day=drift,
        drift_std_per_day=drift_std,
    )


def _drift(day: Array, value: Array, sigma: Array, stated: bool) -> tuple[float | None, float | None]:
    if len(np.unique(day)) < 3:
        return None, None
    rows = np.stack([np.ones_like(day), day - day.mean()], axis=1)
    line = fit_linear(rows / sigma[:, np.newaxis], value / sigma, noise_known=True)
    left = float(line.residual @ line.residual)
    return float(line.values[1]), _widened(left, line.degrees_of_freedom, stated) * float(line.std[1])


def _widened(chi_squared: float, freedom: int, stated: bool) -> float:
    ratio = math.sqrt(chi_squared / freedom)
    return max(ratio, 1.0) if stated else ratio
