"""The damped pendulum fitted to an angle record by output error; knows nothing of rigs, mounts or masses.

The model is eq. 2.9 of the thesis with its sine kept and two damping terms added,

    phi'' = -W sin(phi - zero) - c phi' - s sgn(phi') - q phi' |phi'|,

W = m g r / I_a and c, s, q the damping divided by I_a. An encoder whose disc is eccentric reads
phi + a sin phi + b (cos phi - 1), the first harmonic of its error about rest. The trajectory itself is an
unknown: Hermite-Simpson collocation [HS] on a uniform grid makes the equation of motion a banded system,
which gives both the Newton correction of the trajectory and its sensitivity to every parameter at once
("lifted" Newton [AD]). Started on the measured angle, it cannot slip by a period as shooting from
a guess can.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dtbtrs
from scipy.sparse import csr_matrix

from cfid.estimate.signals import smooth

Array = npt.NDArray[np.float64]

TERMS = ("viscous", "coulomb", "quadratic")
PROBES = ("low speed", "low speed", "angle")  # what dry friction may vary with, unlike the model's
ECCENTRICITY = "eccentricity"

_MAX_ITERATIONS = 20
_CONVERGED_RAD = 1e-8  # step of the predicted angle, rms
_ON_THE_EQUATION_RAD = 1e-7
_CONVERGED = 0.05  # of the uncertainty that white noise leaves the predicted angle
_PROBED_RAD_PER_S = 0.3, 0.8  # speeds below which static friction is larger than sliding
_HELD = 0.95  # Coulomb friction over gravity's pull from which on the pendulum hardly returns
_RUNAWAY_RAD = 10.0  # a step that throws the pendulum over the top will not come back


class Coefficients(NamedTuple):
    """The physical constants of the model, in the order of the Jacobian's columns."""

    natural_frequency_squared_s2: float
    viscous_per_s: float
    coulomb_per_s2: float
    quadratic_per_rad: float
    zero_rad: float


class Eccentricity(NamedTuple):
    """The first harmonic of an encoder's error: amplitudes of sin phi and of cos phi - 1."""

    sine_rad: float
    cosine_rad: float


CENTRED = Eccentricity(0.0, 0.0)


class Trajectory(NamedTuple):
    """Angle and speed at the nodes of a uniform grid, shape (n,) each."""

    start_s: float
    step_s: float
    angle_rad: Array
    speed_rad_per_s: Array


@dataclass(frozen=True, kw_only=True)
class OutputError:
    """A fitted pendulum.

    `residual_rad` has the shape of the samples (n,). `jacobian` (n, p) are the derivatives of the predicted
    angle with respect to the free coefficients, the encoder's eccentricity if that was free too (`eccentric`), the
    start angle and the start speed, in this order; `free` has which coefficients were free.
    """

    coefficients: Coefficients
    eccentricity: Eccentricity
    eccentric: bool
    start_angle_rad: float
    start_speed_rad_per_s: float
    trajectory: Trajectory
    residual_rad: Array
    jacobian: Array
    free: tuple[bool, ...]
    iterations: int
    converged: bool

    @property
    def sum_of_squares_rad2(self) -> float:
        """Sum of the squared residuals."""
        return float(self.residual_rad @ self.residual_rad)


def first_guess(time_s: Array, angle_rad: Array, *, start_s: float, step_s: float) -> tuple[Coefficients, Trajectory]:
    """Smooth the record onto a grid and regress the acceleration on the model's terms.

    Smoothing flattens the acceleration, so that W comes out some per cent low: good enough to start from.
    """
    count = max(int(np.ceil((time_s[-1] - start_s) / step_s)) + 1, 16)
    grid = start_s + step_s * np.arange(count)
    sampled = np.interp(grid, time_s, angle_rad)
    angle, speed, acceleration = smooth(sampled, length=15, step_s=step_s)
    regressors = np.stack([-np.sin(angle), -speed, np.cos(angle)], axis=1)
    stiffness, viscous, offset = np.linalg.lstsq(regressors, acceleration, rcond=None)[0]
    coefficients = Coefficients(stiffness, max(viscous, 0.0), 0.0, 0.0, offset / stiffness)
    return coefficients, Trajectory(start_s, step_s, angle, speed)


def fit_output_error(
    time_s: Array,
    angle_rad: Array,
    *,
    coefficients: Coefficients,
    trajectory: Trajectory,
    terms: tuple[str, ...],
    eccentricity: Eccentricity = CENTRED,
) -> OutputError:
    """Fit the pendulum to samples (n,) at any increasing times within the trajectory's grid.

    Free are W, zero, the start state and the `terms` named, of damping and the encoder's eccentricity; the others stay
    at their given values. The start need not be a solution: measured angles will do. It has converged when a step moves
    the prediction by far less than noise leaves it uncertain.
    """
    free = (True, *(term in terms for term in TERMS), True)
    chosen, eccentric = np.flatnonzero(free), ECCENTRICITY in terms
    values, harmonic = np.array(coefficients, dtype=float), np.array(eccentricity, dtype=float)
    start, step = trajectory.start_s, trajectory.step_s
    state = np.stack([trajectory.angle_rad, trajectory.speed_rad_per_s], axis=1).ravel()
    begin = state[:2].copy()
    sampler = _hermite_sampler(time_s, start_s=start, step_s=step, nodes=len(state) // 2)
    jacobian = np.zeros((len(time_s), len(chosen) + 2 * eccentric + 2))
    converged = False
    iteration = 0
    while not converged and iteration < _MAX_ITERATIONS:
        iteration += 1
        try:
            columns = _linearised(state, begin, step, Coefficients(*values), chosen)
        except np.linalg.LinAlgError:
            break
        angle = sampler @ state
        error = angle_rad - _read(angle, harmonic)
        sampled = _read_derivatives(angle, sampler @ columns, harmonic, eccentric=eccentric)
        jacobian = sampled[:, 1:]
        change, moved_rad = _gauss_newton(jacobian, error - sampled[:, 0])
        moved = columns[:, 0] + columns[:, 1:] @ np.concatenate([change[: len(chosen)], change[-2:]])
        if not np.max(np.abs(moved[::2])) < _RUNAWAY_RAD:
            break
        state = state + moved
        values[chosen] += change[: len(chosen)]
        harmonic += change[len(chosen) : -2] if eccentric else 0.0
        begin += change[-2:]
        off_equation_rad = float(np.max(np.abs(columns[::2, 0])))
        uncertain_rad = math.sqrt(float(error @ error) * len(change)) / len(error)
        converged = moved_rad < max(_CONVERGED_RAD, _CONVERGED * uncertain_rad) and off_equation_rad < max(
            _ON_THE_EQUATION_RAD, _CONVERGED * uncertain_rad
        )
    return OutputError(
        coefficients=Coefficients(*map(float, values)),
        eccentricity=Eccentricity(*map(float, harmonic)),
        eccentric=eccentric,
        start_angle_rad=float(begin[0]),
        start_speed_rad_per_s=float(begin[1]),
        trajectory=Trajectory(start, step, state[::2], state[1::2]),
        residual_rad=angle_rad - _read(sampler @ state, harmonic),
        jacobian=jacobian,
        free=free,
        iterations=iteration,
        converged=converged,
    )


def probed(fit: OutputError, time_s: Array) -> Array:
    """Return what all coefficients, start and probes of dry friction do to the readings, (n, 5 + 3 + 2).

    The probes are excesses of dry friction below two low speeds, and one that grows with 1 - cos phi.
    """
    path = fit.trajectory
    state = np.stack([path.angle_rad, path.speed_rad_per_s], axis=1).ravel()
    columns = _linearised(state, state[:2], path.step_s, fit.coefficients, np.arange(8))[:, 1:]
    sampler = _hermite_sampler(time_s, start_s=path.start_s, step_s=path.step_s, nodes=len(path.angle_rad))
    harmonic = np.array(fit.eccentricity)
    return _read_derivatives(
        np.asarray(sampler @ state), np.asarray(sampler @ columns), harmonic, eccentric=fit.eccentric
    )


def _read(angle: Array, harmonic: Array) -> Array:
    """Return what an encoder reads at angles (n,)."""
    if not harmonic.any():
        return angle
    return np.asarray(angle + harmonic[0] * np.sin(angle) + harmonic[1] * (np.cos(angle) - 1))


def _read_derivatives(angle: Array, columns: Array, harmonic: Array, *, eccentric: bool) -> Array:
    """Return what the columns (n, 1 + p + 2) of an angle are in its readings, with those of a free eccentricity."""
    if not (eccentric or harmonic.any()):
        return columns
    sine, cosine = np.sin(angle), np.cos(angle)
    read = (1 + harmonic[0] * cosine - harmonic[1] * sine)[:, None] * columns
    if not eccentric:
        return np.asarray(read)
    return np.concatenate([read[:, :-2], np.stack([sine, cosine - 1], axis=1), read[:, -2:]], axis=1)


def sample(trajectory: Trajectory, time_s: Array) -> Array:
    """Return the trajectory's angle at any times (n,) within its grid, by cubic Hermite interpolation."""
    state = np.stack([trajectory.angle_rad, trajectory.speed_rad_per_s], axis=1).ravel()
    sampler = _hermite_sampler(
        time_s, start_s=trajectory.start_s, step_s=trajectory.step_s, nodes=len(trajectory.angle_rad)
    )
    return np.asarray(sampler @ state)


def _gauss_newton(jacobian: Array, error: Array) -> tuple[Array, float]:
    """Return the least-squares step and the rms it moves the prediction by."""
    scale = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    scale[scale == 0] = 1.0
    scaled = jacobian / scale
    normal = scaled.T @ scaled + 1e-13 * np.eye(len(scale))
    change = np.linalg.solve(normal, scaled.T @ error)
    moved = np.sqrt(max(float(change @ normal @ change), 0.0) / len(error))
    return change / scale, moved


def _hermite_sampler(time_s: Array, *, start_s: float, step_s: float, nodes: int) -> csr_matrix:
    """Return the sparse matrix (n, 2 nodes) that takes interleaved (angle, speed) to angles at `time_s`."""
    place = (time_s - start_s) / step_s
    left = np.clip(place.astype(int), 0, nodes - 2)
    s = place - left
    weights = np.stack(
        [(1 + 2 * s) * (1 - s) ** 2, step_s * s * (1 - s) ** 2, s**2 * (3 - 2 * s), step_s * s**2 * (s - 1)],
        axis=1,
    )
    columns = 2 * left[:, None] + np.arange(4)
    return csr_matrix(
        (weights.ravel(), columns.ravel(), 4 * np.arange(len(time_s) + 1)), shape=(len(time_s), 2 * nodes)
    )


class _Acceleration(NamedTuple):
    value: Array
    by_angle: Array
    by_speed: Array
    by_coefficient: Array  # (5, n), or (8, n) with the probes


def _acceleration(
    angle: Array, speed: Array, step: float, coefficients: Coefficients, *, probes: bool
) -> _Acceleration:
    stiffness, viscous, coulomb, quadratic, zero = coefficients
    sine, cosine = np.sin(angle - zero), np.cos(angle - zero)
    width = _turning_width(stiffness * sine, speed, coulomb, step)
    direction = np.clip(speed / width, -1, 1)
    turning = np.abs(speed) < width
    drag = speed * np.abs(speed)
    excess = [np.exp(-((speed / low) ** 2)) for low in _PROBED_RAD_PER_S] + [1 - cosine] if probes else []
    return _Acceleration(
        value=-stiffness * sine - viscous * speed - coulomb * direction - quadratic * drag,
        by_angle=-stiffness * cosine,
        by_speed=-viscous - 2 * quadratic * np.abs(speed) - np.where(turning, coulomb / width, 0.0),
        by_coefficient=np.stack(
            [-sine, -speed, -direction, -drag, stiffness * cosine, *(-direction * e for e in excess)]
        ),
    )


def _turning_width(pull: Array, speed: Array, coulomb: float, step: float) -> Array:
    """Return the speed within which sgn(phi') is replaced by a straight line, so that nothing jumps.

    At a turning point the speed runs through zero at the rate P + s on the way out and P - s on the way
    back, P = W |sin phi|. With x = s / P, a line of width P step h / (g + h) on the way out and
    P step g / (g + h) on the way back, g = ln(1+x)/x - 1/(1+x) and h = 1/(1-x) + ln(1-x)/x, leaves the
    speed after the turn as the jump would: friction's whole impulse is kept, and with it the period.
    """
    size = np.abs(pull) + 1e-12
    ratio = np.clip(coulomb / size, -_HELD, _HELD)
    ratio = np.where(np.abs(ratio) < 1e-4, 1e-4, ratio)
    out = np.log1p(ratio) / ratio - 1 / (1 + ratio)
    back = 1 / (1 - ratio) + np.log1p(-ratio) / ratio
    return np.asarray(size * step * np.where(speed * pull > 0, back, out) / (out + back))


def _linearised(
    state: Array, begin: Array, step: float, coefficients: Coefficients, free: npt.NDArray[np.intp]
) -> Array:
    """Linearise the collocated equation of motion about `state` (2n,), interleaved angle and speed.

    Returns (2n, 1 + p + 2): the Newton correction that puts the state on the equation, then the derivatives
    of that solution with respect to the free coefficients, the start angle and the start speed.
    """
    angle, speed = state[::2], state[1::2]
    probes = len(free) > 0 and int(free[-1]) >= len(coefficients)
    node = _acceleration(angle, speed, step, coefficients, probes=probes)
    a, a_angle, a_speed = node.value, node.by_angle, node.by_speed
    middle = _acceleration(
        (angle[:-1] + angle[1:]) / 2 + step / 8 * (speed[:-1] - speed[1:]),
        (speed[:-1] + speed[1:]) / 2 + step / 8 * (a[:-1] - a[1:]),
        step,
        coefficients,
        probes=probes,
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

    Blocks are (2, 2, n - 1), sides (2, m, n - 1). Returns (2n, m + 2); the last two columns begin with the identity
    and have no sides. With each cell solved for its right node what is left is a triangle.
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
    """Return the derivatives of each cell's two Hermite-Simpson equations, position's and speed's, (2, 2, n - 1).

    The first are those by angle and speed at the cell's left node, the second at its right.
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
