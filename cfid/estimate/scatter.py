"""Estimate the scatter of points about a curve beyond stated uncertainties: a constant and a proportional part."""

import math

import numpy as np
import numpy.typing as npt

from cfid.estimate.polynomials import PolynomialFit, fit_polynomial
from cfid.estimate.propagation import widened

Array = npt.NDArray[np.float64]

_SHARES = np.append(0.0, np.geomspace(5e-4, 0.05, 7))  # of the curve: the proportional parts that are tried
_FEWEST = 3  # degrees of freedom that are needed to choose between two parts
_APART = 0.34  # weight of Huber's loss: points four standard uncertainties off are left out of the choice


def scattered_std(x: Array, y: Array, std: Array, *, order: int, robust: bool) -> Array:
    """Return the standard uncertainties (n,) of points: `std` (n,), increased by their scatter about a polynomial.

    The variance is v (std^2 + share^2 y^2), with the curve y and v of at least 1; both come from the restricted
    likelihood (H. D. Patterson, R. Thompson, Recovery of inter-block information when block sizes are unequal,
    Biometrika 58, 1971). An uncertainty estimated from few points is increased so that 1.96 times it covers 95 %
    (Student's t). Points that scatter hardly more than stated keep their uncertainties.
    """
    if len(x) < order + 1 + _FEWEST:
        return std
    first = fit_polynomial(x, y, order=order, std=std, robust=robust)
    kept = first.weight > _APART
    if first.inflation is None or kept.sum() < order + 1 + _FEWEST:
        return std
    if first.inflation**2 <= 1 + math.sqrt(2 / first.degrees_of_freedom):  # within the scatter by chance
        return std
    curve = np.abs(first.at(x))
    tried = [np.hypot(std, share * curve) for share in _SHARES]

    def deviance(each: Array) -> float:
        return _deviance(fit_polynomial(x[kept], y[kept], order=order, std=each[kept]), each[kept])

    best = min(tried, key=deviance)
    found = fit_polynomial(x, y, order=order, std=best, robust=robust)
    return np.asarray(best * widened(found.inflation or 1.0, first.degrees_of_freedom))


def _deviance(fit: PolynomialFit, std: Array) -> float:
    """Return minus twice the logarithm of the restricted likelihood of points with these uncertainties (n,)."""
    variance = (fit.inflation or 1.0) ** 2
    size = fit.residual / (std * np.sqrt(variance))
    used = np.diag(fit.covariance) > 0
    determined = np.linalg.slogdet(fit.covariance[np.ix_(used, used)] / variance)[1]
    return float(fit.degrees_of_freedom * np.log(variance) + size @ size + 2 * np.sum(np.log(std)) - determined)
