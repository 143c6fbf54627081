"""The coefficients of the complex model of drag (eq. 4.5) made comparable with each other (eq. 4.10)."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Normalised(NamedTuple):
    """Coefficients (6, 3), each times the mean of what it is multiplied with, over the sum of these means.

    The third term is multiplied with the square of the speed sum. C.3.1 weights it with the speed sum itself
    (norm3), which makes `thesis`, eq. 4.10; `squared` takes the square, which changes the sum and so all others.
    """

    thesis: Array
    squared: Array


def normalise(coefficients: Array, *, wind_mps: npt.ArrayLike, speed_sum_rad_s: npt.ArrayLike) -> Normalised:
    """Return k1 to k6 (6, 3), or their deviations, normalised by winds and speed sums of experiments (n,)."""
    wind, speed = (np.asarray(given, dtype=np.float64).mean() for given in (wind_mps, speed_sum_rad_s))
    thesis = np.array([speed * wind, wind**2, speed, wind, speed, 1.0])
    squared = np.array([speed * wind, wind**2, speed**2, wind, speed, 1.0])
    return Normalised(*(coefficients * (means / means.sum())[:, np.newaxis] for means in (thesis, squared)))
