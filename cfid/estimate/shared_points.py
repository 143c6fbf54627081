"""Compute covariances between polynomials that were fitted to the same points.

Each coefficient is a weighted sum of the points. Two fits therefore covary if the errors of their points do: thrust
over command and thrust over voltage share the thrust's error, thrust over command and thrust over speed may not. The
residuals show this (seemingly unrelated regressions [Zel]).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.estimate.polynomials import PolynomialFit

Array = npt.NDArray[np.float64]

_FEWEST = 3.0  # common degrees of freedom of two fits: fewer do not determine a correlation


class PointFit(NamedTuple):
    """A fit, and the parts of all N windows in each of its points (n, N), in units of their standard deviations."""

    fit: PolynomialFit
    windows: Array


def joint_covariance(fits: Sequence[PointFit]) -> Array:
    """Return the covariance (p, p) of the coefficients of several fits, one fit after the other.

    Within a fit, it is the fit's own. Between two fits, it uses the correlation of their points' errors from the
    residuals, zero if too few points are in both, and adds the errors that points share (a tare): these causes have to
    be the same in the same order, in all fits that have any. Windows that the first fit does not use do not correlate
    other fits.
    """
    known = np.any(fits[0].windows, axis=0)
    alone = [one.fit.moved[:, : len(one.fit.x)] @ (one.windows * known) for one in fits]
    shared = [one.fit.moved[:, len(one.fit.x) :] for one in fits]
    correlation = _correlations([PointFit(one.fit, one.windows * known) for one in fits])
    blocks = []
    for i, one in enumerate(fits):
        row = []
        for j in range(len(fits)):
            causes = min(shared[i].shape[1], shared[j].shape[1])
            between = correlation[i, j] * alone[i] @ alone[j].T + shared[i][:, :causes] @ shared[j][:, :causes].T
            row.append(one.fit.covariance if i == j else between)
        blocks.append(row)
    return np.block(blocks)


def _correlations(fits: Sequence[PointFit]) -> Array:
    """Return the correlations (k, k) of the errors of the fits' points, as the nearest possible correlation matrix."""
    found = np.eye(len(fits))
    for i, one in enumerate(fits):
        for j, other in enumerate(fits[:i]):
            found[i, j] = found[j, i] = _correlation(one, other)
    sizes, directions = np.linalg.eigh(found)
    possible = directions * np.maximum(sizes, 0.0) @ directions.T
    unit = np.sqrt(np.diag(possible))
    return np.asarray(possible / np.outer(unit, unit))


def _correlation(one: PointFit, other: PointFit) -> float:
    """Return the correlation of the errors of two fits' points, 0 where it is unknown.

    The residuals r = M e of a fit have fewer degrees of freedom than errors e. Where errors correlate by rho W, the
    residuals' product r1' W r2 is rho trace(W' M1 W M2') on average.
    """
    overlap = one.windows @ other.windows.T
    left, right = (np.eye(len(each.fit.x)) - each.fit.hat for each in (one, other))
    freedom = float(np.sum((left @ overlap) * (overlap @ right)))
    first, second = (each.fit.weight * each.fit.residual / each.fit.point_std for each in (one, other))
    size = float(
        np.sqrt(
            first
            @ first
            / max(one.fit.degrees_of_freedom, 1)
            * (second @ second)
            / max(other.fit.degrees_of_freedom, 1)
        )
    )
    if not (freedom >= _FEWEST and size > 0):  # also false for NaN
        return 0.0
    return float(np.clip(first @ overlap @ second / freedom / size, -1.0, 1.0))
