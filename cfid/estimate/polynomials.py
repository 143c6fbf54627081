"""Fit polynomials to measured points: coefficients with uncertainties, and bands.

`scattered_std` increases the points' uncertainties by their scatter about a curve. `joint_covariance` is that of
several fits to the same points: each coefficient is a weighted sum of the points, so two fits covary if the errors of
their points do. Thrust over command and thrust over voltage share the thrust's error, thrust over command and thrust
over speed may not. The residuals show this (seemingly unrelated regressions [Zel]).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri, stdtrit

from cfid.errors import FitError
from cfid.estimate.linear import Estimate, fit_linear
from cfid.estimate.propagation import widened

Array = npt.NDArray[np.float64]

_CUTOFF = 1.345  # standard deviations from which Huber's loss grows linearly: 95 % efficient for normal noise [Hub]
_MEAN_SQUARE = 0.7101645  # of normal noise with standard deviation 1, clipped there
_ROUNDS, _SETTLED = 100, 1e-9
_DEPENDENT = 1e-10  # ratio of the smallest to the largest diagonal entry of R for columns that are linearly dependent
_ROUNDING = 1e-12  # of the values: a smaller misfit counts as none
_SHARES = np.append(0.0, np.geomspace(5e-4, 0.05, 7))  # of the curve: the proportional scatters that are tried
_FEWEST = 3  # degrees of freedom that determine a scatter's form, or a correlation between two fits
_APART = 0.34  # weight of Huber's loss: points four standard uncertainties off are left out of the scatter's form


@dataclass(frozen=True, kw_only=True)
class PolynomialFit:
    """y(x) of `coefficients` (order + 1,) in plain powers of x, highest first; a power left out has a zero.

    `covariance` (order + 1, order + 1) is NaN if no standard uncertainties were stated and no degrees of freedom
    remain. `moved` times its transpose equals it, or less where a constraint was active; each column is an independent
    error, first of each point alone, then of what points share. `by_point` (order + 1, n) is the change of the
    coefficients per unit of each y. Per point (n,): `residual` in units of y, `weight` of Huber's loss (1: counts in
    full), and `point_std`, one standard deviation about the curve. `inflation` is the ratio of the observed to the
    stated scatter, never below 1, or None where no uncertainties were stated. `scale` is one standard deviation
    according to Huber's loss, in units of y, or of the stated uncertainties; None for plain least squares. `quantile`
    times a standard uncertainty covers 95 %. `aicc` compares orders on the same points.
    """

    coefficients: Array
    covariance: Array
    moved: Array
    by_point: Array
    x: Array
    residual: Array
    weight: Array
    point_std: Array
    degrees_of_freedom: int
    inflation: float | None
    scale: float | None
    quantile: float
    aicc: float

    @property
    def order(self) -> int:
        """The highest power."""
        return len(self.coefficients) - 1

    @property
    def std(self) -> Array:
        """The standard uncertainty of each coefficient (order + 1,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def hat(self) -> Array:
        """The effect (n, n) of each point's standard deviation on the curve at all points, in standard deviations."""
        powers = np.vander(self.x, self.order + 1)
        return np.asarray(powers @ self.by_point * self.point_std / self.point_std[:, np.newaxis])

    @property
    def residual_norm(self) -> float:
        """MATLAB's S.normr: the 2-norm of the unweighted residuals."""
        return float(np.linalg.norm(self.residual))

    def at(self, x: npt.ArrayLike) -> Array:
        """Return the curve at x of any shape."""
        return np.asarray(np.polyval(self.coefficients, np.asarray(x, dtype=np.float64)))

    def slope_at(self, x: npt.ArrayLike) -> Array:
        """Return the curve's derivative at x of any shape."""
        return np.asarray(np.polyval(np.polyder(self.coefficients), np.asarray(x, dtype=np.float64)))

    def std_at(self, x: npt.ArrayLike) -> Array:
        """Return the standard uncertainty of the curve at x (m,)."""
        powers = np.vander(np.atleast_1d(np.asarray(x, dtype=np.float64)), self.order + 1)
        return np.asarray(np.sqrt(np.einsum("mi,ij,mj->m", powers, self.covariance, powers)))

    def confidence(self, x: npt.ArrayLike) -> Array:
        """Return half the width (m,) of the band that contains the true curve at an x in 95 of 100 experiments."""
        return self.quantile * self.std_at(x)

    def prediction(self, x: npt.ArrayLike) -> Array:
        """Return half the width (m,) of the band that contains another point at x in 95 of 100 cases.

        The noise of that point is that of the points measured around x.
        """
        along = np.argsort(self.x)
        noise = np.interp(np.atleast_1d(np.asarray(x, dtype=np.float64)), self.x[along], self.point_std[along])
        return self.quantile * np.hypot(self.std_at(x), noise)


def fit_polynomial(
    x: Array,
    y: Array,
    *,
    order: int,
    std: Array | None = None,
    shared: Array | None = None,
    robust: bool = False,
) -> PolynomialFit:
    """Fit a polynomial to points x, y (n,), in its units.

    `std` (n,) is the standard uncertainty of each y. It contains the noise within a window; what changes between
    windows (drift, a sagging battery, a shape that is not a polynomial) only shows in the scatter of the points about
    the curve. Therefore the covariance grows with chi-squared per degree of freedom where that is above 1, and bands
    then use Student's t; it never shrinks, as a few points may lie closer than stated by chance. Without `std`, all
    points count equally and their scatter is the noise. `robust` uses Huber's loss, with the scale of his proposal 2
    [Hub].

    `shared` (n, m) are parts of `std` that several points have in common, such as points between the same tares: a
    column is the effect of one standard uncertainty of a cause on each point. They increase the covariance, and do not
    change the weights.

    Raises FitError when the points cannot determine the coefficients.
    """
    return _fit(x, y, powers=range(order, -1, -1), std=std, shared=shared, robust=robust)


def fit_power(
    x: Array, y: Array, *, power: int, std: Array | None = None, shared: Array | None = None, robust: bool = False
) -> PolynomialFit:
    """Fit y = k x^power alone, with k as the first coefficient; see `fit_polynomial`."""
    return _fit(x, y, powers=(power,), std=std, shared=shared, robust=robust)


class _Solved(NamedTuple):
    """Solution (p,) of rows in units of their standard deviation, residual and weight (n,), and the points' scatter."""

    solution: Array
    residual: Array
    weight: Array
    scale: float | None
    scatter: float  # variance of a point
    variance: float  # factor from the inverse of the normal matrix to a covariance


def _fit(
    x: Array, y: Array, *, powers: Sequence[int], std: Array | None, shared: Array | None, robust: bool
) -> PolynomialFit:
    given = np.ones_like(y) if std is None else std
    _check(x, y, given, powers)
    size = float(np.max(np.abs(x))) or 1.0
    rows = (x[:, np.newaxis] / size) ** np.array(powers) / given[:, np.newaxis]
    _check_places(rows, x, powers)
    plain = fit_linear(rows, y / given, noise_known=False)
    freedom, gain = plain.degrees_of_freedom, plain.gain  # per standard deviation of each point
    solved = _solved(rows, y / given, plain, robust=robust and freedom > 0, least=0.0 if std is None else 1.0)
    variance = solved.variance if std is None else float(np.nanmax([1.0, solved.variance]))
    scatter = solved.scatter if std is None else float(np.nanmax([1.0, solved.scatter]))
    order = max(powers)
    places, units = order - np.array(powers), size ** -np.array(powers, dtype=np.float64)
    coefficients, covariance = np.zeros(order + 1), np.zeros((order + 1, order + 1))
    coefficients[places] = solved.solution * units
    by_point = np.zeros((order + 1, len(x)))
    by_point[places] = gain * units[:, np.newaxis] / given
    # Per standard deviation of each point: what it shares with others, and the rest.
    parts = np.zeros((len(x), 0)) if shared is None or std is None else shared / given[:, np.newaxis]
    alone = np.sqrt(np.maximum(1 - np.sum(parts**2, axis=1), 0.0))
    moved = np.zeros((order + 1, len(x) + parts.shape[1]))
    moved[places] = np.hstack([gain * alone, gain @ parts])
    few = 1.0
    if std is None and robust and freedom:
        # With a scatter estimated from few points, 1.96 standard uncertainties cover 95 % only if these are increased.
        # It is not known whether the scatter is constant or proportional: where a proportional one is larger, half of
        # the variance is assumed to be proportional.
        few, curve = widened(1.0, freedom), rows @ solved.solution
        if curve.any():
            moved[places] *= np.sqrt((np.maximum(curve**2 / np.mean(curve**2), 1.0) + 1) / 2)
    moved[places] *= few * math.sqrt(variance) * units[:, np.newaxis]
    covariance[np.ix_(places, places)] = moved[places] @ moved[places].T
    known = few > 1 or (std is not None and variance == 1.0)
    return PolynomialFit(
        coefficients=coefficients,
        covariance=covariance,
        moved=moved,
        by_point=by_point,
        x=x,
        residual=solved.residual * given,
        weight=solved.weight,
        point_std=few * math.sqrt(scatter) * given,
        degrees_of_freedom=freedom,
        inflation=None if std is None else math.sqrt(variance),
        scale=solved.scale,
        quantile=float(ndtri(0.975) if known else stdtrit(freedom, 0.975)) if known or freedom else math.nan,
        aicc=_aicc(solved, y / given, len(powers)),
    )


def _check(x: Array, y: Array, std: Array, powers: Sequence[int]) -> None:
    if not np.all(np.isfinite(x) & np.isfinite(y)):
        raise FitError("a point that is no finite number cannot be fitted: leave it out.")
    if not np.all((std > 0) & np.isfinite(std)):
        row = int(np.flatnonzero(~((std > 0) & np.isfinite(std)))[0])
        raise FitError(f"the standard uncertainty of point {row + 1} is {std[row]:g}: it has to be above zero.")
    if len(x) < len(powers):
        raise FitError(
            f"{len(x)} points are too few for a polynomial of order {max(powers)}, which has {len(powers)} "
            "coefficients: measure more points, or take a lower order."
        )


def _check_places(rows: Array, x: Array, powers: Sequence[int]) -> None:
    diagonal = np.abs(np.diag(np.linalg.qr(rows, mode="r")))
    if diagonal.min() <= _DEPENDENT * diagonal.max():
        raise FitError(
            f"{len(x)} points at {len(np.unique(x))} different places do not determine {len(powers)} coefficients: "
            "measure at more places, or take a lower order."
        )


def _solved(rows: Array, y: Array, plain: Estimate, *, robust: bool, least: float) -> _Solved:
    """Return plain least squares, or the result of Huber's loss with a scale of at least `least`."""
    residual, freedom = plain.residual, plain.degrees_of_freedom
    rounding = _ROUNDING * float(np.linalg.norm(y))
    if robust and float(np.linalg.norm(residual)) > rounding:
        return _huber(rows, y, plain.values, least=max(least, rounding / math.sqrt(len(y))))
    variance = float(residual @ residual) / freedom if freedom else math.nan
    return _Solved(plain.values, residual, np.ones(len(y)), None, variance, variance)


def _huber(rows: Array, y: Array, solution: Array, *, least: float) -> _Solved:
    """Update the weights until solution and scale converge; both together are one convex problem [Hub]."""
    count, unknowns = rows.shape
    freedom = count - unknowns
    residual = y - rows @ solution
    scale = max(float(np.linalg.norm(residual)) / math.sqrt(freedom), least)
    for _ in range(_ROUNDS):
        before = scale
        cut = np.minimum(np.abs(residual), _CUTOFF * scale)
        scale = max(math.sqrt(float(cut @ cut) / (freedom * _MEAN_SQUARE)), least)
        weight = _CUTOFF * scale / np.maximum(np.abs(residual), _CUTOFF * scale)
        root = np.sqrt(weight)
        moved = np.linalg.lstsq(rows * root[:, np.newaxis], residual * root, rcond=None)[0]
        solution = solution + moved
        residual = y - rows @ solution
        if max(float(np.linalg.norm(rows @ moved)), abs(scale - before)) <= _SETTLED * scale:
            break
    cut = np.minimum(np.abs(residual), _CUTOFF * scale)
    inside = float(np.mean(np.abs(residual) <= _CUTOFF * scale))
    correction = 1 + unknowns / count * (1 - inside) / inside  # for few points [Hub]
    variance = float(cut @ cut) / freedom * (correction / inside) ** 2
    return _Solved(solution, residual, weight, scale, scale**2, variance)


def _aicc(solved: _Solved, y: Array, unknowns: int) -> float:
    """Return the corrected AIC [HT]; the size of the noise is estimated too, so it counts as an unknown."""
    count, taken = len(y), unknowns + 1
    if count <= taken + 1:
        return math.inf
    size = np.abs(solved.residual)
    cut = size if solved.scale is None else np.minimum(size, _CUTOFF * solved.scale)
    loss = float(cut @ (2 * size - cut))  # quadratic up to the cutoff, linear beyond
    floor = (_ROUNDING * float(np.linalg.norm(y))) ** 2 + np.finfo(np.float64).tiny
    return float(count * math.log((loss + floor) / count) + 2 * taken * (1 + (taken + 1) / (count - taken - 1)))


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
    variances = [
        part @ part / max(each.fit.degrees_of_freedom, 1)
        for part, each in zip((first, second), (one, other), strict=True)
    ]
    size = math.sqrt(math.prod(variances))
    if not (freedom >= _FEWEST and size > 0):  # also false for NaN
        return 0.0
    return float(np.clip(first @ overlap @ second / freedom / size, -1.0, 1.0))
