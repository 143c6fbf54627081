"""Compute the response to held values with one time constant for rising and another for falling."""

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dtbtrs

Array = npt.NDArray[np.float64]

_ROUNDING = 1e-15  # of the largest value: changes this small are rounding, which may decide what rises


def follow_held(to: Array, rising: Array | float, falling: Array | float) -> Array:
    """Return the response to values (k, n), each held for a step, at the start of each step; it starts settled.

    `rising` and `falling`, (n - 1,) or the same for all steps, are the shares of a distance that remain after a step
    where the value is above the response and where it is not.

    The equations are linear once it is known where the response rises. Each solution shows where the next one rises. A
    solution that is right up to a place makes the next one right at least one place further, and in practice much
    further: earlier errors fade within a few time constants.
    """
    rises = np.zeros((len(to), to.shape[1] - 1), bool)
    rises[:, 1:] = np.diff(to[:, :-1]) > 0
    begins = np.zeros_like(to)
    begins[:, 0] = to[:, 0]
    band, late = np.ones((2, to.size), order="F"), np.full_like(to, np.inf)
    least_change = _ROUNDING * np.abs(to).max()
    while True:
        before, left = late, np.zeros_like(to)  # nothing carries over from one sequence to the next
        left[:, :-1] = np.where(rises, rising, falling)
        begins[:, 1:] = (1 - left[:, :-1]) * to[:, :-1]
        band[1] = -left.ravel()
        late = dtbtrs(band, begins.reshape(-1, 1), uplo="L", diag="U")[0].reshape(to.shape)
        seen = to[:, :-1] > late[:, :-1]
        if np.array_equal(seen, rises) or np.abs(late - before).max() <= least_change:
            return np.asarray(late)
        rises = seen
