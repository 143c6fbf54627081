"""Fit a thrust cubic that rises over all motor voltages, as the Crazyflie's firmware needs to find a voltage.

The firmware inverts the cubic by Cardano's formula for one real root. That root exists for every thrust where the slope
c1 + 2 c2 V + 3 c3 V^2 is above zero at every V: c1 > 0, c3 > 0 and c2^2 < 3 c1 c3, a convex cone. The constrained
least-squares solution is the unconstrained one if that lies inside, else the nearest point of the cone's surface in the
metric of the normal matrix; the surface has one angle as its only nonlinear parameter.

Single precision requires a distance from the surface, because the formula subtracts nearly equal numbers there; the
distance depends on the cubic. The cone is narrowed until the firmware's inverse, calculated in single precision, is
accurate.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq
from scipy.special import ndtri

from cfid.errors import FitError
from cfid.estimate.polynomials import PolynomialFit, fit_polynomial
from cfid.estimate.voltage_cubic import FALL, IDLE, cubic_fault

Array = npt.NDArray[np.float64]

LEVEL = 0.01  # level of the one-sided test by which the data reject a cubic
TOLERANCE = 0.01  # of the largest thrust: a smaller departure does not matter, as a motor's own scatter is larger

_STEP = 0.004  # of the angles that are tried
_ANGLES = np.concatenate([np.arange(-1.57, -0.3, _STEP), np.arange(0.02, 1.57, _STEP)])
_MARGINS = (0.0, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3)  # of 1 - c2^2 / (3 c1 c3), tried until rounding does no harm
_FLAT_MARGIN = 1e-3  # the smallest margin where the flat point can be reached, c2 < 0
_FALL = FALL / 2  # half of the allowed fall, because coefficients are rounded when they are written
_DRAWS, _SEED = 400, 1


@dataclass(frozen=True, kw_only=True)
class MonotoneCubic:
    """A cubic `fit` that rises over all voltages.

    `bound` states whether the constraint is active. `departure` is the largest distance from the unconstrained cubic,
    relative to the largest thrust, from the idle thrust up. `refusal` states why the data contradict every such cubic,
    "" where they do not.
    """

    fit: PolynomialFit
    bound: bool
    departure: float
    refusal: str


def constrain(
    free: PolynomialFit,
    *,
    thrust_n: Array,
    std_n: Array | None = None,
    shared_n: Array | None = None,
    max_thrust_n: float | None = None,
) -> MonotoneCubic:
    """Return the best-fitting cubic that rises over all voltages.

    `free` is the unconstrained fit, by least squares without Huber's loss, of thrusts (n,) over motor voltages. Its
    weights come from `std_n` (n,), of which `shared_n` (n, m) are common parts; `max_thrust_n` is the firmware's
    largest thrust, as in `cubic_fault`. If the constraint is active, the covariance is that of 400 unconstrained
    estimates, drawn from their own distribution and then constrained; it is increased if the points scatter more about
    the cubic.

    A cubic is refused where, at some voltage from the idle thrust up to the largest that was measured, it departs from
    the unconstrained one by more than 1 % of the largest thrust and the points exclude that (one-sided, 1 %).

    Raises FitError for an order other than three, and where thrust does not rise with the voltage at all.
    """
    if free.order != 3:
        raise FitError(f"the firmware takes a cubic of motor voltage, and this polynomial has order {free.order}.")
    if _inside(free.coefficients[::-1]) and not _fault(free, max_thrust_n):
        return MonotoneCubic(fit=free, bound=False, departure=0.0, refusal="")

    def bound(margin: float, missed_n: float = 0.0) -> _Bound:
        return _bound(free.x, thrust_n, std_n, shared_n, margin, missed_n=missed_n)

    for margin in _MARGINS:
        found = bound(margin)
        if std_n is not None and found.excess > 0:  # it misses points by more than their scatter: all weigh more alike
            most_n = 2 * float(np.max(np.abs(found.fit.residual)))
            missed_n = brentq(lambda missed_n, margin=margin: bound(margin, missed_n).excess, 0.0, most_n, rtol=1e-3)
            found = bound(margin, float(missed_n))
        if not (fault := _fault(found.fit, max_thrust_n)):
            break
    departure, refusal = _judge(free, found.fit)
    refusal = refusal or (fault and f"no voltage cubic for the firmware: {fault}")
    return MonotoneCubic(fit=found.with_spread(), bound=True, departure=departure, refusal=refusal)


def _fault(fit: PolynomialFit, max_thrust_n: float | None) -> str:
    return cubic_fault(fit.coefficients[::-1].tolist(), max_thrust_n=max_thrust_n, fall=_FALL)


class _Bound(NamedTuple):
    """A cubic on the cone's surface, the unconstrained one of the same weights, and the points' uncertainties (n,)."""

    fit: PolynomialFit
    free: PolynomialFit
    std_n: Array
    cone: "_Cone"

    @property
    def excess(self) -> float:
        """The excess of chi-squared over its degrees of freedom."""
        return float(np.sum((self.fit.residual / self.std_n) ** 2)) - self.fit.degrees_of_freedom

    def with_spread(self) -> PolynomialFit:
        """Return the cubic with the covariance of other unconstrained estimates after the constraint."""
        about, about_free = (float(np.sum((part.residual / self.std_n) ** 2)) for part in (self.fit, self.free))
        known = self.fit.inflation is not None  # the stated uncertainties then give the scatter of the points
        widened = 1.0 if known or about_free == 0 else about / about_free
        free = np.sqrt(widened) * self.free.moved[::-1] * self.cone.powers[:, np.newaxis]
        sizes, directions = np.linalg.eigh(free @ free.T)
        factor = directions * np.sqrt(np.maximum(sizes, 0.0))
        causes = _independent_causes()
        draws = self.free.coefficients[::-1] * self.cone.powers + causes @ factor.T
        drawn = np.where(_inside(draws)[:, np.newaxis], draws, self.cone.nearest(draws)[0])
        # Linear regression on the unconstrained cubic.
        follows = drawn.T @ causes / (_DRAWS - 1) @ np.linalg.pinv(factor)
        own = (follows * self.cone.powers / self.cone.powers[:, np.newaxis])[::-1, ::-1]
        return replace(
            self.fit,
            covariance=(np.cov(drawn.T) / np.outer(self.cone.powers, self.cone.powers))[::-1, ::-1],
            moved=np.sqrt(widened) * own @ self.free.moved,
            by_point=own @ self.free.by_point,
            point_std=np.sqrt(widened) * self.fit.point_std,
        )


def _bound(
    volts: Array, thrust_n: Array, std_n: Array | None, shared_n: Array | None, margin: float, *, missed_n: float
) -> _Bound:
    """Return the best cubic on the cone's surface, weighted by the points' scatter and the cubic's own misfit."""
    std = None if std_n is None else np.hypot(std_n, missed_n)
    free = fit_polynomial(volts, thrust_n, order=3, std=std, shared=shared_n)
    weights = np.ones_like(thrust_n) if std is None else std
    cone = _Cone(volts, weights, margin)
    nearest = cone.nearest_exactly(free.coefficients[::-1] * cone.powers)
    if nearest[1] <= 0:
        raise FitError("thrust does not rise with motor voltage: look at the points, and at the sign of Fz.")
    coefficients = (nearest / cone.powers)[::-1]
    fit = replace(free, coefficients=coefficients, residual=thrust_n - np.polyval(coefficients, volts))
    return _Bound(fit, free, weights, cone)


class _Cone:
    """The surface of the cone of rising cubics, in the metric of points; cubics are in units of the largest voltage.

    Distances are lengths of R c, where R' R is the points' normal matrix. The `margin` narrows the cone.
    """

    def __init__(self, volts: Array, std: Array, margin: float) -> None:
        self._margin = margin
        size = float(np.max(np.abs(volts)))
        self.powers = size ** np.arange(4.0)
        rows = (volts[:, np.newaxis] / size) ** np.arange(4) / std[:, np.newaxis]
        self._triangle = np.asarray(np.linalg.qr(rows, mode="r"))

    def nearest(self, cubics: Array, angles: Array = _ANGLES) -> tuple[Array, Array]:
        """Return the points (n, 4) of the surface that are nearest to cubics (n, 4), and their angles (n,) of these.

        Where no rising cubic is nearer than a constant, the constant is returned.
        """
        cosine, sine = np.cos(angles), np.sin(angles)
        margin = np.maximum(self._margin, np.where(angles < 0, _FLAT_MARGIN, 1e-6))
        # Cubics on the surface without a constant; the constant changes only the first row, as R is triangular.
        surface = np.stack([0 * sine, cosine**2, np.sqrt(1 - margin) * cosine * sine, sine**2 / 3], axis=-1)
        shapes, wanted = surface @ self._triangle.T, cubics @ self._triangle.T
        rising = shapes * (0.0, 1.0, 1.0, 1.0)
        rising /= np.linalg.norm(rising, axis=-1, keepdims=True)
        best = np.argmax(wanted @ rising.T, axis=1)
        along = np.maximum(np.sum(rising[best] * wanted, axis=1), 0.0)
        sizes = (along / np.sum(rising[best] * shapes[best], axis=1))[:, np.newaxis]
        points = sizes * surface[best]
        points[:, 0] += (wanted - sizes * shapes[best])[:, 0] / self._triangle[0, 0]
        return points, angles[best]

    def nearest_exactly(self, cubic: Array) -> Array:
        """Return the point (4,) of the surface that is nearest to a cubic (4,), as `nearest` does, at any angle."""
        angles = _ANGLES
        for width in (_STEP, _STEP / 100, _STEP / 1e4):
            angle = float(self.nearest(cubic[np.newaxis], angles)[1][0])
            angles = np.linspace(max(angle - width, angles[0]), min(angle + width, angles[-1]), 201)
        return np.asarray(self.nearest(cubic[np.newaxis], angles)[0][0])


def _independent_causes() -> Array:
    """Return normal draws (draws, 4) whose sample mean is exactly zero and whose sample covariance is the identity."""
    draws = np.random.default_rng(_SEED).standard_normal((_DRAWS, 4))
    draws -= draws.mean(axis=0)
    return np.asarray(draws @ np.linalg.inv(np.linalg.cholesky(np.cov(draws.T))).T)


def _inside(lowest_first: Array) -> npt.NDArray[np.bool_]:
    """Return whether cubics (..., 4) rise over all voltages."""
    _, c1, c2, c3 = np.moveaxis(lowest_first, -1, 0)
    return np.asarray((c1 > 0) & (c3 > 0) & (c2**2 < 3 * c1 * c3))


def _judge(free: PolynomialFit, bound: PolynomialFit) -> tuple[float, str]:
    """Return the largest departure over the largest thrust, and why the data refuse the cubic, "" if they do not."""
    volts = np.linspace(free.x.min(), free.x.max(), 200)
    largest = float(free.at(volts).max())
    volts = volts[free.at(volts) >= IDLE * largest]
    apart = np.abs(bound.at(volts) - free.at(volts)) / largest
    sure = (apart - TOLERANCE) * largest / free.std_at(volts)
    at = int(np.argmax(sure))
    if sure[at] <= ndtri(1 - LEVEL):
        return float(apart.max()), ""
    return float(apart.max()), (
        "no voltage cubic for the firmware: the nearest one that rises over all voltages departs from the data by "
        f"{100 * apart[at]:.1f} % of the largest thrust at {volts[at]:.2f} V (allowed: {100 * TOLERANCE:.0f} %, tested "
        f"at the {100 * LEVEL:.0f} % level). Likely causes: points that were not steady, or an empty battery."
    )
