"""Solve the pendulum's equation of motion by collocation, with sensitivities to the coefficients and the start.

Hermite-Simpson collocation [HS] on a uniform grid makes the equation a banded system, which gives both the Newton
correction of a trajectory and its sensitivity to every parameter at once ("lifted" Newton [AD]).
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dtbtrs

Array = npt.NDArray[np.float64]

SLOW_RAD_PER_S = 0.3, 0.8  # speeds below which dry friction may differ from sliding friction
_HELD = 0.95  # Coulomb friction relative to gravity's pull: above it, the pendulum hardly returns


class Coefficients(NamedTuple):
    """The physical constants of the model, in the order of the Jacobian's columns.

    `spring_per_s2` is the stiffness of a cable over the axis inertia. The last three are what dry friction has beyond
    Coulomb friction: below 0.3 and 0.8 rad/s, and in proportion to 1 - cos phi.
    """

    natural_frequency_squared_s2: float
    viscous_per_s: float
    coulomb_per_s2: float = 0.0
    quadratic_per_rad: float = 0.0
    zero_rad: float = 0.0
    spring_per_s2: float = 0.0
    slow_per_s2: float = 0.0
    less_slow_per_s2: float = 0.0
    aside_per_s2: float = 0.0


class Threads(NamedTuple):
    """The effect of two threads on a pendulum's equation, where a body turns about the vertical: see `model`.

    `ratio` is a b / h^2 and `fall_s2` is a b / (g h), with a and b the threads' distances from the vertical, above and
    below, and h their height.
    """

    ratio: float
    fall_s2: float


NO_THREADS = Threads(0.0, 0.0)


class _Acceleration(NamedTuple):
    value: Array
    by_angle: Array
    by_speed: Array
    by_coefficient: Array  # (9, n)


def _acceleration(
    angle: Array, speed: Array, step: float, coefficients: Coefficients, threads: Threads
) -> _Acceleration:
    stiffness, viscous, coulomb, quadratic, zero, spring, *excess = coefficients
    turned = angle - zero
    sine, cosine = np.sin(turned), np.cos(turned)
    slow = [np.exp(-((speed / low) ** 2)) for low in SLOW_RAD_PER_S]
    shapes = np.stack([*slow, 1 - cosine])
    dry, dry_by_angle = coulomb + np.tensordot(excess, shapes, 1), excess[2] * sine
    if threads != NO_THREADS:
        sine, cosine, bend = _pull_of_threads(sine, cosine, threads.ratio)
    carried = 1 + stiffness * threads.fall_s2 * sine**2 if threads.fall_s2 else 1.0
    width = _turning_width((stiffness * sine + spring * turned) / carried, speed, dry / carried, step)
    direction = np.clip(speed / width, -1, 1)
    drag = speed * np.abs(speed)
    steeper = stiffness * cosine + spring + direction * dry_by_angle
    faster = sum(-2 * size / low**2 * one for size, low, one in zip(excess, SLOW_RAD_PER_S, slow, strict=False))
    level = _Acceleration(
        value=-stiffness * sine - spring * turned - viscous * speed - dry * direction - quadratic * drag,
        by_angle=-steeper,
        by_speed=-viscous
        - 2 * quadratic * np.abs(speed)
        - np.where(np.abs(speed) < width, dry / width, 0.0)
        - direction * speed * faster,
        by_coefficient=np.stack([-sine, -speed, -direction, -drag, steeper, -turned, *(-direction * shapes)]),
    )
    if not threads.fall_s2:
        return level
    return _lifted(level, sine, cosine, bend, speed=speed, stiffness=stiffness, fall_s2=threads.fall_s2)


def _pull_of_threads(sine: Array, cosine: Array, ratio: float) -> tuple[Array, Array, Array]:
    """Return sin phi / s, with s the threads' height relative to that at rest, and its first two derivatives."""
    s = np.sqrt(1 - 2 * ratio * (1 - cosine))
    slope = cosine / s + ratio * sine**2 / s**3
    bend = -sine / s + 3 * ratio * sine * cosine / s**3 + 3 * ratio**2 * sine**3 / s**5
    return sine / s, slope, bend


def _lifted(
    level: _Acceleration, pull: Array, slope: Array, bend: Array, *, speed: Array, stiffness: float, fall_s2: float
) -> _Acceleration:
    """Return the acceleration of a body that rises as it turns, which increases its effective inertia."""
    carried = 1 + stiffness * fall_s2 * pull**2
    value = (level.value - stiffness * fall_s2 * pull * slope * speed**2) / carried
    climbs = (slope**2 + pull * bend) * speed**2 + 2 * pull * slope * value
    by_angle = (level.by_angle - stiffness * fall_s2 * climbs) / carried
    by_coefficient = level.by_coefficient / carried
    by_coefficient[0] -= fall_s2 * (pull * slope * speed**2 + pull**2 * value) / carried
    by_coefficient[4] = -by_angle
    by_speed = (level.by_speed - 2 * stiffness * fall_s2 * pull * slope * speed) / carried
    return _Acceleration(value, by_angle, by_speed, by_coefficient)


def _turning_width(pull: Array, speed: Array, coulomb: Array, step: float) -> Array:
    """Return the speed within which sgn(phi') is replaced by a straight line, so that nothing jumps.

    At a turning point, the speed passes through zero at the rate P + s on the way out and P - s on the way back, with P
    = W |sin phi|. With x = s / P, a line of width P step h / (g + h) on the way out and P step g / (g + h) on the way
    back, g = ln(1+x)/x - 1/(1+x) and h = 1/(1-x) + ln(1-x)/x, gives the same speed after the turn as the jump would:
    friction's whole impulse is preserved, and with it the period.
    """
    size = np.abs(pull) + 1e-12
    ratio = np.clip(coulomb / size, -_HELD, _HELD)
    ratio = np.where(np.abs(ratio) < 1e-4, 1e-4, ratio)
    out = np.log1p(ratio) / ratio - 1 / (1 + ratio)
    back = 1 / (1 - ratio) + np.log1p(-ratio) / ratio
    return np.asarray(size * step * np.where(speed * pull > 0, back, out) / (out + back))


def linearised(
    state: Array,
    begin: Array,
    step: float,
    coefficients: Coefficients,
    free: npt.NDArray[np.intp],
    *,
    threads: Threads = NO_THREADS,
) -> Array:
    """Linearise the collocated equation of motion about `state` (2n,), interleaved angle and speed.

    Returns (2n, 1 + p + 2): the Newton correction that puts the state on the equation, then the derivatives
    of that solution with respect to the free coefficients, the start angle and the start speed.
    """
    angle, speed = state[::2], state[1::2]
    node = _acceleration(angle, speed, step, coefficients, threads)
    a, a_angle, a_speed = node.value, node.by_angle, node.by_speed
    middle = _acceleration(
        (angle[:-1] + angle[1:]) / 2 + step / 8 * (speed[:-1] - speed[1:]),
        (speed[:-1] + speed[1:]) / 2 + step / 8 * (a[:-1] - a[1:]),
        step,
        coefficients,
        threads,
    )
    left, right = _cells(a_angle, a_speed, middle, step)
    by_node, by_middle = node.by_coefficient[free], middle.by_coefficient[free]
    difference = by_node[:, :-1] - by_node[:, 1:]
    sides = np.empty((2, 1 + len(free), len(angle) - 1))
    sides[0, 0] = step / 2 * (speed[:-1] + speed[1:]) + step**2 / 12 * (a[:-1] - a[1:]) - np.diff(angle)
    sides[1, 0] = step / 6 * (a[:-1] + 4 * middle.value + a[1:]) - np.diff(speed)
    sides[0, 1:] = step**2 / 12 * difference
    sides[1, 1:] = (
        step / 6 * (by_node[:, :-1] + 4 * (by_middle + middle.by_speed * step / 8 * difference) + by_node[:, 1:])
    )
    return _solved(left, right, sides, begin - state[:2])


def _solved(left: Array, right: Array, sides: Array, begin: Array) -> Array:
    """Solve left x[i] + right x[i + 1] = sides for all nodes from the first on, x[0] = begin in the first column.

    Blocks are (2, 2, n - 1), sides (2, m, n - 1). Returns (2n, m + 2); the last two columns start with the identity and
    have no sides. When each cell is solved for its right node, the remaining system is triangular.
    """
    determinant = right[0, 0] * right[1, 1] - right[0, 1] * right[1, 0]
    if not determinant.all():
        raise np.linalg.LinAlgError("a cell leaves its right node open")
    inverse = np.array([[right[1, 1], -right[0, 1]], [-right[1, 0], right[0, 0]]]) / determinant
    onward = inverse[:, 0, None] * left[0] + inverse[:, 1, None] * left[1]
    rows = np.zeros((sides.shape[1] + 2, 2 * sides.shape[2] + 2))
    rows[0, :2] = begin
    rows[-2, 0] = rows[-1, 1] = 1.0
    rows[:-2, 2::2], rows[:-2, 3::2] = inverse[:, 0, None] * sides[0] + inverse[:, 1, None] * sides[1]
    band = np.zeros((4, rows.shape[1]), order="F")  # entry (r, c) in row r - c of column c, as LAPACK stores it
    band[2, 0:-2:2], band[1, 1:-2:2] = onward[0]
    band[3, 0:-2:2], band[2, 1:-2:2] = onward[1]
    return np.asarray(dtbtrs(band, rows.T, uplo="L", diag="U", overwrite_b=True)[0])


def _cells(a_angle: Array, a_speed: Array, middle: _Acceleration, step: float) -> tuple[Array, Array]:
    """Return the derivatives (2, 2, n - 1) of each cell's two Hermite-Simpson equations, for position and for speed.

    The first array has those with respect to angle and speed at the cell's left node, the second at its right node.
    """
    left, right = slice(None, -1), slice(1, None)
    m_angle, m_speed = middle.by_angle, middle.by_speed
    by_left = [
        [-1 - step**2 / 12 * a_angle[left], -step / 2 - step**2 / 12 * a_speed[left]],
        [
            -step / 6 * (a_angle[left] + 4 * (m_angle / 2 + m_speed * step / 8 * a_angle[left])),
            -1 - step / 6 * (a_speed[left] + 4 * (m_angle * step / 8 + m_speed * (0.5 + step / 8 * a_speed[left]))),
        ],
    ]
    by_right = [
        [1 + step**2 / 12 * a_angle[right], -step / 2 + step**2 / 12 * a_speed[right]],
        [
            -step / 6 * (a_angle[right] + 4 * (m_angle / 2 - m_speed * step / 8 * a_angle[right])),
            1 - step / 6 * (a_speed[right] + 4 * (-m_angle * step / 8 + m_speed * (0.5 - step / 8 * a_speed[right]))),
        ],
    ]
    return np.array(by_left), np.array(by_right)
