"""One quantity measured several times, on other days or with other vehicles: do the values agree, and do they drift?

The mean is weighted with the deviations that were stated. They may have causes in common, a rig's geometry, scales,
gravity, which no repetition averages out: the mean's deviation is theirs. Where the values scatter by more than they
explain it is widened (R. T. Birge, The calculation of errors by the method of least squares, Physical Review 40, 1932).
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc

from cfid.errors import FitError

Array = npt.NDArray[np.float64]

LEAST_PROBABILITY = 0.01  # of values that are said to agree
_DAY_S = 86400.0


@dataclass(frozen=True, kw_only=True)
class Repeats:
    """The mean of n values and its deviation, how far they scatter, and by how much they change a day.

    `probability` is how likely values of one quantity with the deviations stated differ as much; None where a value
    has no deviation, and the scatter alone counts. The drift is None with fewer than three times.
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
        """Whether the deviations stated explain the differences, as far as they can tell."""
        return self.probability is None or self.probability >= LEAST_PROBABILITY


def repeats(*, time_s: Array, value: Array, std: Array) -> Repeats:
    """Compare values (n,) found at times (n,), with one standard deviation each, nan where there is none.

    Raises FitError for fewer than two values.
    """
    if len(value) < 2:
        raise FitError(f"{len(value)} value does not repeat: it takes two.")
    stated = bool(np.all(np.isfinite(std) & (std > 0)))
    sigma = std if stated else np.ones(len(value))
    weight = 1 / sigma**2
    mean = float(weight @ value / weight.sum())
    chi_squared, freedom = float(weight @ (value - mean) ** 2), len(value) - 1
    shared = float(weight @ sigma / weight.sum()) if stated else 0.0
    drift, drift_std = _drift(time_s / _DAY_S, value, weight, stated)
    return Repeats(
        mean=mean,
        mean_std=max(shared, _widened(chi_squared, freedom, stated) / math.sqrt(weight.sum())),
        scatter=float(np.std(value, ddof=1)),
        chi_squared=chi_squared,
        freedom=freedom,
        probability=float(chdtrc(freedom, chi_squared)) if stated else None,
        drift_per_day=drift,
        drift_std_per_day=drift_std,
    )


def _drift(day: Array, value: Array, weight: Array, stated: bool) -> tuple[float | None, float | None]:
    if len(np.unique(day)) < 3:
        return None, None
    place = day - weight @ day / weight.sum()
    level = weight @ value / weight.sum()
    spread = float(weight @ place**2)
    slope = float(weight @ (place * (value - level))) / spread
    left = float(weight @ (value - level - slope * place) ** 2)
    return slope, _widened(left, len(day) - 2, stated) / math.sqrt(spread)


def _widened(chi_squared: float, freedom: int, stated: bool) -> float:
    ratio = math.sqrt(chi_squared / freedom)
    return max(ratio, 1.0) if stated else ratio
