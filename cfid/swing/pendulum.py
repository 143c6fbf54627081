"""The damped pendulum: its equation of motion, solved by collocation and fitted to a record by output error.

The model is eq. 2.9 of the thesis with its sine kept and further terms added,

    phi'' = -W sin(phi - zero) - k (phi - zero) - c phi' - (s + d(phi, phi')) sgn(phi') - q phi' |phi'|,

where W = m g r / I_a, and c, s, q are the damping divided by I_a, as are a cable's stiffness k and what dry friction
has beyond Coulomb's, d. An encoder whose disc is eccentric reads phi + a sin phi + b (cos phi - 1), with the first
harmonic of its error about rest. A gyro reads (1 + a) phi' + b; as rates do not show the zero angle, zero is then the
vertical. A body on two threads turns about the vertical by

    (1 + W f S^2) phi'' = -W S - W f S S' phi'^2 - friction,  S = sin phi / s,  s^2 = 1 - 2 k (1 - cos phi),

with W = m g a b / (h I), k = a b / h^2 and f = a b / (g h), which follows from the energies of a body that rises with
the threads; without threads k = f = 0.

Hermite-Simpson collocation [HS] on a uniform grid makes the equation a banded system, which gives both the Newton
correction of a trajectory and its sensitivity to every parameter at once ("lifted" Newton [AD]). The trajectory itself
is an unknown: as it starts from the measured angle, it cannot slip by a period as shooting from a guess can; across a
gap, the first guess continues the swing.
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

SLOW_RAD_PER_S = 0.3, 0.8  # speeds below which dry friction may differ from sliding friction
_HELD = 0.95  # Coulomb friction relative to gravity's pull: above it, the pendulum hardly returns
_SMOOTHED_NODES = 15  # of the grid, around each node of the first guess
_GAP = 5.0  # typical intervals between rows
_MAX_ITERATIONS = 20
_FULL_STEPS = 8
_CONVERGED_RAD = 1e-8  # rms change of the predicted angle in a step
_ON_THE_EQUATION_RAD = 1e-7
_CONVERGED = 0.05  # of the uncertainty of the predicted angle due to white noise
_RUNAWAY_RAD = 10.0  # a step that takes the pendulum over the top will not return


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
    """The effect of two threads on a pendulum's equation, where a body turns about the vertical, as above.

    `ratio` is a b / h^2 and `fall_s2` is a b / (g h), with a and b the threads' distances from the vertical, above and
    below, and h their height.
    """

    ratio: float
    fall_s2: float


NO_THREADS = Threads(0.0, 0.0)


class Setup(NamedTuple):
    """What the model adds to a pendulum with an encoder: threads, and a gyro.

    A gyro's rates are converted to rad by the angular frequency `gyro_per_s` of the swing, so that residuals of both
    instruments are comparable.
    """

    threads: Threads = NO_THREADS
    gyro_per_s: float | None = None


PLAIN = Setup()


class Trajectory(NamedTuple):
    """Angle and speed at the nodes of a uniform grid, each of shape (n,)."""

    start_s: float
    step_s: float
    angle_rad: Array
    speed_rad_per_s: Array


@dataclass(frozen=True, kw_only=True)
class OutputError:
    """A fitted pendulum.

    `instrument` has the error of the reading: amplitudes of sin phi and of cos phi - 1, or scale and bias of a gyro.
    `residual_rad` has the shape of the samples (n,). `jacobian` (n, p) has the derivatives of the predicted readings
    with respect to the `free` ones of coefficients and instrument, the start angle and the start speed, in this order.
    """

    coefficients: Coefficients
    instrument: tuple[float, float]
    setup: Setup
    start_angle_rad: float
    start_speed_rad_per_s: float
    trajectory: Trajectory
    residual_rad: Array
    jacobian: Array
    free: npt.NDArray[np.bool_]
    converged: bool

    @property
    def values(self) -> Array:
        """Coefficients and the instrument's error, in the order of `free`."""
        return np.array([*self.coefficients, *self.instrument])


def first_guess(time_s: Array, angle_rad: Array, *, start_s: float, step_s: float) -> tuple[Coefficients, Trajectory]:
    """Smooth the record onto a grid and regress the acceleration on the model's terms.

    Smoothing flattens the acceleration, so that W is a few per cent too low: accurate enough as a start.
    """
    count = max(int(np.ceil((time_s[-1] - start_s) / step_s)) + 1, 16)
    grid = start_s + step_s * np.arange(count, dtype=np.float64)
    sampled = np.interp(grid, time_s, angle_rad)
    angle, speed, acceleration = smooth(sampled, length=_SMOOTHED_NODES, step_s=step_s)
    regressors = np.stack([-np.sin(angle), -speed, np.cos(angle)], axis=1)
    blind = _without_rows(time_s, grid)
    seen = ~blind if np.count_nonzero(~blind) > len(blind) / 4 else np.ones_like(blind)
    stiffness, viscous, offset = np.linalg.lstsq(regressors[seen], acceleration[seen], rcond=None)[0]
    coefficients = Coefficients(stiffness, max(viscous, 0.0), zero_rad=offset / stiffness)
    _swing_on(angle, speed, ~seen, coefficients, step_s)
    return coefficients, Trajectory(start_s, step_s, angle, speed)


def _without_rows(time_s: Array, grid_s: Array) -> npt.NDArray[np.bool_]:
    """Return the nodes (n,) whose smoothing window reaches into a gap of a record, which a straight line bridges."""
    steps = np.diff(time_s)
    reach_s = _SMOOTHED_NODES * (grid_s[1] - grid_s[0])
    before = np.flatnonzero(steps > max(_GAP * float(np.median(steps)), reach_s))
    blind = np.zeros(len(grid_s), bool)
    for at in before:
        blind |= (grid_s > time_s[at] - reach_s / 2) & (grid_s < time_s[at + 1] + reach_s / 2)
    return blind


def _swing_on(
    angle: Array, speed: Array, blind: npt.NDArray[np.bool_], coefficients: Coefficients, step_s: float
) -> None:
    """Replace angles and speeds (n,) of blind nodes by those of the pendulum, continued from the node before."""
    stiffness, viscous, zero = coefficients[0], coefficients[1], coefficients.zero_rad
    for at in np.flatnonzero(blind[1:]) + 1:
        speed[at] = speed[at - 1] - step_s * (stiffness * math.sin(angle[at - 1] - zero) + viscous * speed[at - 1])
        angle[at] = angle[at - 1] + step_s * speed[at]


@np.errstate(over="ignore", invalid="ignore")  # in a diverging step, which ends the fit
def fit_output_error(
    time_s: Array,
    reading_rad: Array,
    *,
    values: Array,
    free: npt.NDArray[np.bool_],
    trajectory: Trajectory,
    setup: Setup = PLAIN,
    pull: Array | float = 0.0,
) -> OutputError:
    """Fit the pendulum to samples (n,) at any increasing times within the trajectory's grid.

    The start state and the `free` ones of the values (coefficients, then the instrument's error) are fitted; the others
    stay. `pull` is the weight of each value's square in the sum of squares, the variance of the noise over that of the
    value's prior. The start need not be a solution: measured angles suffice. The fit has converged when a step changes
    the prediction by far less than its uncertainty due to noise.
    """
    values, chosen = values.astype(float), np.flatnonzero(free)
    count = len(Coefficients._fields)
    physical, read = chosen[chosen < count], chosen[chosen >= count] - count
    weights = np.append(np.broadcast_to(pull, values.shape)[chosen], [0.0, 0.0])
    start, step = trajectory.start_s, trajectory.step_s
    state = np.stack([trajectory.angle_rad, trajectory.speed_rad_per_s], axis=1).ravel()
    begin = state[:2].copy()
    sampler, gyro = _sampler(time_s, trajectory, setup), setup.gyro_per_s is not None
    jacobian = np.zeros((len(time_s), len(weights)))
    converged = False
    for iteration in range(_MAX_ITERATIONS):
        try:
            columns = linearised(state, begin, step, Coefficients(*values[:count]), physical, threads=setup.threads)
            seen = sampler @ state
            reads, stretch, harmonics = _read(seen, values[count:], gyro=gyro)
            sampled = stretch[:, None] * (sampler @ columns)
            error = reading_rad - reads
            jacobian = np.concatenate([sampled[:, 1:-2], harmonics[:, read], sampled[:, -2:]], axis=1)
            pulled = weights * np.append(values[chosen], [0.0, 0.0])
            change, moved_rad = _gauss_newton(jacobian, error - sampled[:, 0], weights, pulled)
        except np.linalg.LinAlgError:
            break
        if iteration >= _FULL_STEPS:  # where dry friction jumps, full steps may alternate between two sides
            change /= 2
        moved = columns[:, 0] + columns[:, 1:] @ np.concatenate([change[: len(physical)], change[-2:]])
        if not np.max(np.abs(moved[::2])) < _RUNAWAY_RAD:
            break
        state = state + moved
        values[chosen] += change[:-2]
        begin += change[-2:]
        off_equation_rad = float(np.max(np.abs(columns[::2, 0])))
        uncertain_rad = math.sqrt(float(error @ error) * len(change)) / len(error)
        converged = moved_rad < max(_CONVERGED_RAD, _CONVERGED * uncertain_rad) and off_equation_rad < max(
            _ON_THE_EQUATION_RAD, _CONVERGED * uncertain_rad
        )
        if converged:
            break
    return OutputError(
        coefficients=Coefficients(*map(float, values[:count])),
        instrument=(float(values[count]), float(values[count + 1])),
        setup=setup,
        start_angle_rad=float(begin[0]),
        start_speed_rad_per_s=float(begin[1]),
        trajectory=Trajectory(start, step, state[::2], state[1::2]),
        residual_rad=reading_rad - _read(sampler @ state, values[count:], gyro=gyro)[0],
        jacobian=jacobian,
        free=free,
        converged=converged,
    )


def _read(seen: Array, error: Array, *, gyro: bool) -> tuple[Array, Array, Array]:
    """Return readings (n,) of angles or rates with an instrument's error (2,), and their derivatives by both.

    Those by the angles or rates are (n,), those by the error (n, 2).
    """
    if gyro:
        scale_and_bias = np.stack([seen, np.ones(len(seen))], axis=1)
        return seen + scale_and_bias @ error, np.full(len(seen), 1 + error[0]), scale_and_bias
    sine, cosine = np.sin(seen), np.cos(seen)
    harmonics = np.stack([sine, cosine - 1], axis=1)
    return seen + harmonics @ error, 1 + error[0] * cosine - error[1] * sine, harmonics


def on_another_grid(trajectory: Trajectory, step_s: float) -> Trajectory:
    """Return the trajectory on a grid of another step, with the same start."""
    end_s = trajectory.step_s * (len(trajectory.angle_rad) - 1)
    time_s = trajectory.start_s + step_s * np.arange(math.ceil(end_s / step_s) + 1)
    inside = np.minimum(time_s, trajectory.start_s + end_s)
    return Trajectory(trajectory.start_s, step_s, *sample(trajectory, inside))


def sample(trajectory: Trajectory, time_s: Array) -> tuple[Array, Array]:
    """Return the trajectory's angle and speed at any times (n,) within its grid, by cubic Hermite interpolation."""
    state = np.stack([trajectory.angle_rad, trajectory.speed_rad_per_s], axis=1).ravel()
    angle, speed = (_sampler(time_s, trajectory, Setup(gyro_per_s=per_s)) @ state for per_s in (None, 1.0))
    return angle, speed


def motion_in_readings(fit: OutputError, time_s: Array) -> tuple[Array, Array]:
    """Return the fitted angle and its derivative (n,), or for a gyro its rate and the rate's derivative's shape."""
    angle, speed = sample(fit.trajectory, time_s)
    if fit.setup.gyro_per_s is None:
        return angle, speed
    frequency = fit.coefficients.natural_frequency_squared_s2
    return speed / fit.setup.gyro_per_s, -frequency * np.sin(angle) / fit.setup.gyro_per_s


def _gauss_newton(jacobian: Array, error: Array, weights: Array, pulled: Array) -> tuple[Array, float]:
    """Return the step of least squares with weights (p,) of the values' squares, and the prediction's rms change.

    `pulled` (p,) are the values times their weights.
    """
    products = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(products))
    scale[scale == 0] = 1.0
    normal = products / np.outer(scale, scale) + 1e-13 * np.eye(len(scale))
    change = np.linalg.solve(normal + np.diag(weights / scale**2), (jacobian.T @ error - pulled) / scale)
    moved = np.sqrt(max(float(change @ normal @ change), 0.0) / len(error))
    return change / scale, moved


def _sampler(time_s: Array, trajectory: Trajectory, setup: Setup) -> csr_matrix:
    """Return the sparse matrix (n, 2 nodes) from interleaved (angle, speed) to the measured quantity at `time_s`.

    That is the Hermite cubic of the angle, or for a gyro its derivative over `gyro_per_s`.
    """
    step_s, nodes = trajectory.step_s, len(trajectory.angle_rad)
    place = (time_s - trajectory.start_s) / step_s
    left = np.clip(place.astype(int), 0, nodes - 2)
    s = place - left
    if setup.gyro_per_s is None:
        weights = np.stack(
            [(1 + 2 * s) * (1 - s) ** 2, step_s * s * (1 - s) ** 2, s**2 * (3 - 2 * s), step_s * s**2 * (s - 1)],
            axis=1,
        )
    else:
        turning = 6 * s * (s - 1) / step_s
        weights = np.stack([turning, (1 - s) * (1 - 3 * s), -turning, s * (3 * s - 2)], axis=1) / setup.gyro_per_s
    columns = 2 * left[:, None] + np.arange(4)
    return csr_matrix(
        (weights.ravel(), columns.ravel(), 4 * np.arange(len(time_s) + 1)), shape=(len(time_s), 2 * nodes)
    )


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
