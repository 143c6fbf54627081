"""Fit a thrust cubic that rises over all motor voltages, as the Crazyflie's firmware needs to find a voltage.

The firmware inverts the cubic by Cardano's formula for one real root. That root exists for every thrust where the slope
c1 + 2 c2 V + 3 c3 V^2 is above zero at every V: c1 > 0, c3 > 0 and c2^2 < 3 c1 c3, a convex cone. The constrained
least-squares solution is the unconstrained one if that lies inside, else the nearest cubic whose slope is a square,
(a0 + a1 V)^2, in the metric of the normal matrix: only the angle of (a0, a1) is not linear.

Single precision requires a distance from the surface, because the formula subtracts nearly equal numbers there; the
distance depends on the cubic. The cone is narrowed until the firmware's inverse, calculated in single precision, is
accurate.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq, minimize_scalar
from scipy.special import ndtr, ndtri

from cfid.errors import FitError
from cfid.estimate.polynomials import PolynomialFit, fit_polynomial
from cfid.estimate.voltage_cubic import FALL, IDLE, cubic_fault

Array = npt.NDArray[np.float64]

LEVEL = 0.01  # level of the one-sided test by which the data reject a cubic
TOLERANCE = 0.01  # of the largest thrust: a smaller departure does not matter, as a motor's own scatter is larger

_MARGINS = (0.0, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3)  # of 1 - c2^2 / (3 c1 c3), tried until rounding does no harm
_ANGLES = ((0.02, 1.57), (-1.57, -0.3))  # of (a0, a1): beyond, the cubic is a line, or flat where motors run
_STEP, _EXACT = 1e-6, {"xatol": 1e-9}
_LEAST_MARGIN, _FLAT_MARGIN = 1e-6, 1e-3  # the second one where the flat point can be reached, c2 < 0
_FALL = FALL / 2  # half of the allowed fall, because coefficients are rounded when they are written


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
    largest thrust, as in `cubic_fault`. If the constraint is active, the covariance is that along the surface, and
    across it as much as repeated measurements would leave it; it is increased if the points scatter more about the
    cubic.

    A cubic is refused where, at some voltage from the idle thrust up to the largest that was measured, it departs from
    the unconstrained one by more than 1 % of the largest thrust and the points exclude that (one-sided, 1 %).

    Raises FitError for an order other than three, and where thrust does not rise with the voltage at all.
    """
    if free.order != 3:
        raise FitError(f"the firmware takes a cubic of motor voltage, and this polynomial has order {free.order}.")
    if _inside(free.coefficients[::-1]) and not _fault(free, max_thrust_n):
        return MonotoneCubic(fit=free, bound=False, departure=0.0, refusal="")

    def bound(margin: float, missed_n: float = 0.0) -> PolynomialFit:
        std = None if std_n is None else np.hypot(std_n, missed_n)
        weighted = fit_polynomial(free.x, thrust_n, order=3, std=std, shared=shared_n)
        return _on_the_surface(weighted, thrust_n, std, margin)

    def excess(missed_n: float, margin: float) -> float:
        """Return the excess of chi-squared over its degrees of freedom."""
        assert std_n is not None
        fit = bound(margin, missed_n)
        return float(np.sum((fit.residual / np.hypot(std_n, missed_n)) ** 2)) - fit.degrees_of_freedom

    for margin in _MARGINS:
        fit = bound(margin)
        if std_n is not None and excess(0.0, margin) > 0:  # it misses points by more than their scatter: weigh alike
            most_n = 2 * float(np.max(np.abs(fit.residual)))
            fit = bound(margin, float(brentq(excess, 0.0, most_n, args=(margin,), rtol=1e-3)))
        if not (fault := _fault(fit, max_thrust_n)):
            break
    departure, refusal = _judge(free, fit)
    refusal = refusal or (fault and f"no voltage cubic for the firmware: {fault}")
    return MonotoneCubic(fit=fit, bound=True, departure=departure, refusal=refusal)


def _fault(fit: PolynomialFit, max_thrust_n: float | None) -> str:
    return cubic_fault(fit.coefficients[::-1].tolist(), max_thrust_n=max_thrust_n, fall=_FALL)


def _on_the_surface(free: PolynomialFit, thrust_n: Array, std_n: Array | None, margin: float) -> PolynomialFit:
    """Return the nearest cubic to an unconstrained one whose slope is a square, plus a `margin`, with its covariance.

    Voltages are in units of the largest, and distances in standard uncertainties: lengths of R c, where R' R is the
    points' normal matrix.
    """
    size, std = float(np.max(np.abs(free.x))), np.ones_like(thrust_n) if std_n is None else std_n
    powers = size ** np.arange(4.0)
    rows = (free.x[:, np.newaxis] / size) ** np.arange(4) / std[:, np.newaxis]
    triangle = np.asarray(np.linalg.qr(rows, mode="r"))
    target = free.coefficients[::-1] * powers
    wanted = triangle @ target

    def shape(angle: float) -> Array:
        cosine, sine = np.cos(angle), np.sin(angle)
        inside = np.sqrt(1 - max(margin, _FLAT_MARGIN if angle < 0 else _LEAST_MARGIN))
        return np.array([0.0, cosine**2, inside * cosine * sine, sine**2 / 3])

    def solved(angle: float) -> tuple[Array, float]:
        """Return the nearest rising cubic (4,) of a shape and any constant, and the square of its distance."""
        column = triangle @ shape(angle)  # the constant changes only the first row, as R is triangular
        factor = max(float(column[1:] @ wanted[1:] / (column[1:] @ column[1:])), 0.0)
        parts = factor * shape(angle)
        parts[0] = (wanted[0] - factor * column[0]) / triangle[0, 0]
        return parts, float(np.sum((wanted - factor * column)[1:] ** 2))

    angles = [
        minimize_scalar(lambda angle: solved(angle)[1], bounds=bounds, method="bounded", options=_EXACT).x
        for bounds in _ANGLES
    ]
    angle = min(angles, key=lambda angle: solved(angle)[1])
    nearest, distance = solved(angle)
    if nearest[1] <= 0:
        raise FitError("thrust does not rise with motor voltage: look at the points, and at the sign of Fz.")
    coefficients = (nearest / powers)[::-1]
    residual = thrust_n - np.polyval(coefficients, free.x)
    about, about_free = (float(np.sum((left / std) ** 2)) for left in (residual, free.residual))
    known = free.inflation is not None  # the stated uncertainties then give the scatter of the points
    widened = 1.0 if known or about_free == 0 else about / about_free
    # Errors along the surface move the cubic as they move the free one; of those across it, the part that would put
    # the free one inside.
    turned = (shape(angle + _STEP) - shape(angle - _STEP)) / (2 * _STEP)
    tangents = np.stack([np.eye(4)[0], shape(angle), turned], axis=1)
    along = np.linalg.qr(triangle @ tangents)[0]
    noise = 1.0 if known or free.degrees_of_freedom == 0 else (about / free.degrees_of_freedom) ** 0.5
    inside = float(ndtr(-np.sqrt(distance) / noise)) if noise else 0.0
    projected = inside * np.eye(4) + (1 - inside) * along @ along.T
    follows = np.linalg.solve(triangle, projected @ triangle)
    own = (follows * powers / powers[:, np.newaxis])[::-1, ::-1]
    moved = np.sqrt(widened) * own @ free.moved
    return replace(
        free,
        coefficients=coefficients,
        residual=residual,
        covariance=moved @ moved.T,
        moved=moved,
        by_point=own @ free.by_point,
        point_std=np.sqrt(widened) * free.point_std,
    )


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
