"""How far points scatter about a curve beyond their stated uncertainties: by a constant and in proportion to it."""

import math

import numpy as np
import numpy.typing as npt

from cfid.estimate.polynomials import PolynomialFit, fit_polynomial
from cfid.estimate.propagation import widened

Array = npt.NDArray[np.float64]

_SHARES = np.append(0.0, np.geomspace(5e-4, 0.05, 7))  # of the curve, that are tried as proportional part
_FEWEST = 3  # degrees of freedom, to choose between two parts
_APART = 0.34  # of Huber's loss: points four standard uncertainties off are left out of the choice


def scattered_std(x: Array, y: Array, std: Array, *, order: int, robust: bool) -> Array:
    """Return the standard uncertainties (n,) of points, widened by what a polynomial with stated ones (n,) leaves.

    The variance is v (std^2 + share^2 y^2), with the curve y and v of at least 1; both come from the restricted
    likelihood (H. D. Patterson, R. Thompson, Recovery of inter-block information when block sizes are unequal,
    Biometrika 58, 1971). Of an uncertainty that was estimated from few points 1.96 cover 95 % (Student's t). Points
    that scatter hardly more than stated keep theirs.
    """
    if len(x) < order + 1 + _FEWEST:
        return std
    first = fit_polynomial(x, y, order=order, std=std, robust=robust)
    kept = first.weight > _APART
    if first.inflation is None or kept.sum() < order + 1 + _FEWEST:
        return std
    if first.inflation**2 <= 1 + math.sqrt(2 / first.degrees_of_freedom):  # as far as luck makes points scatter
        return std
    curve = np.abs(first.at(x))
    tried = [np.hypot(std, share * curve) for share in _SHARES]

    def deviance(each: Array) -> float:
        return _deviance(fit_polynomial(x[kept], y[kept], order=order, std=each[kept]), each[kept])

    best = min(tried, key=deviance)
    found = fit_polynomial(x, y, order=order, std=best, robust=robust)
    return np.asarray(best * widened(found.inflation or 1.0, first.degrees_of_freedom))


def _deviance(fit: PolynomialFit, std: Array) -> float:
    """Return minus twice the logarithm of the restricted likelihood of points with such uncertainties (n,)."""
    variance = (fit.inflation or 1.0) ** 2
    size = fit.residual / (std * np.sqrt(variance))
    used = np.diag(fit.covariance) > 0
    determined = np.linalg.slogdet(fit.covariance[np.ix_(used, used)] / variance)[1]
    return float(fit.degrees_of_freedom * np.log(variance) + size @ size + 2 * np.sum(np.log(std)) - determined)
