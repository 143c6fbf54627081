"""Fit the damped pendulum to a record of its angle or its rate by output error, without any rig, mount or mass.

The model is eq. 2.9 of the thesis with its sine kept and two damping terms added,

    phi'' = -W sin(phi - zero) - c phi' - s sgn(phi') - q phi' |phi'|,

where W = m g r / I_a, and c, s, q are the damping divided by I_a; a cable that acts as a spring adds -k (phi - zero).
An encoder whose disc is eccentric reads phi + a sin phi + b (cos phi - 1), with the first harmonic of its error about
rest. A gyro reads phi' plus a constant, its bias; as rates do not show the zero angle, zero is then the vertical. A
body on two threads turns about the vertical by

    (1 + W f S^2) phi'' = -W S - W f S S' phi'^2 - friction,  S = sin phi / s,  s^2 = 1 - 2 k (1 - cos phi),

with W = m g a b / (h I), k = a b / h^2 and f = a b / (g h), which follows from the energies of a body that rises with
the threads; without threads k = f = 0. The trajectory itself is an unknown, see `collocation`. As it starts from the
measured angle, it cannot slip by a period as shooting from a guess can; across a gap, the first guess continues the
swing.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from cfid.estimate.signals import smooth
from cfid.swing.collocation import NO_THREADS, Coefficients, Forces, Threads, linearised

Array = npt.NDArray[np.float64]

TERMS = ("viscous", "coulomb", "quadratic")
PROBES = ("low speed", "low speed", "angle")  # what dry friction may vary with, unlike the model's friction
ECCENTRICITY, SPRING = "eccentricity", "spring"

_SMOOTHED_NODES = 15  # of the grid, around each node of the first guess
_GAP = 5.0  # typical intervals between rows
_MAX_ITERATIONS = 20
_CONVERGED_RAD = 1e-8  # rms change of the predicted angle in a step
_ON_THE_EQUATION_RAD = 1e-7
_CONVERGED = 0.05  # of the uncertainty of the predicted angle due to white noise
_RUNAWAY_RAD = 10.0  # a step that takes the pendulum over the top will not return


class Eccentricity(NamedTuple):
    """The first harmonic of an encoder's error: amplitudes of sin phi and of cos phi - 1."""

    sine_rad: float
    cosine_rad: float


CENTRED = Eccentricity(0.0, 0.0)


class Setup(NamedTuple):
    """What the model adds to a pendulum with an encoder: threads, a gyro, and a known spring, such as a cable.

    A gyro's rates are converted to rad by the angular frequency `gyro_per_s` of the swing, so that residuals of both
    instruments are comparable. The spring is divided by the axis inertia.
    """

    threads: Threads = NO_THREADS
    gyro_per_s: float | None = None
    spring_per_s2: float = 0.0

    @property
    def forces(self) -> Forces:
        """The restoring effects in addition to gravity."""
        return Forces(self.threads, self.spring_per_s2)


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

    `residual_rad` has the shape of the samples (n,). `jacobian` (n, p) has the derivatives of the predicted readings
    with respect to the free coefficients, the encoder's eccentricity if that was free too (`eccentric`) or the gyro's
    bias, the start angle and the start speed, in this order; `free` states which coefficients were free.
    """

    coefficients: Coefficients
    eccentricity: Eccentricity
    eccentric: bool
    setup: Setup
    bias_rad: float
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
        """The sum of the squared residuals."""
        return float(self.residual_rad @ self.residual_rad)


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
    coefficients = Coefficients(stiffness, max(viscous, 0.0), 0.0, 0.0, offset / stiffness)
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
    stiffness, viscous, *_, zero = coefficients
    for at in np.flatnonzero(blind[1:]) + 1:
        speed[at] = speed[at - 1] - step_s * (stiffness * math.sin(angle[at - 1] - zero) + viscous * speed[at - 1])
        angle[at] = angle[at - 1] + step_s * speed[at]


@np.errstate(over="ignore", invalid="ignore")  # in a diverging step, which ends the fit
def fit_output_error(
    time_s: Array,
    reading_rad: Array,
    *,
    coefficients: Coefficients,
    trajectory: Trajectory,
    terms: tuple[str, ...],
    eccentricity: Eccentricity = CENTRED,
    setup: Setup = PLAIN,
) -> OutputError:
    """Fit the pendulum to samples (n,) at any increasing times within the trajectory's grid.

    Free parameters are W, the start state, zero or a gyro's bias, and the given `terms` of damping and the encoder's
    eccentricity; the others keep their given values. The start need not be a solution: measured angles suffice. The fit
    has converged when a step changes the prediction by far less than its uncertainty due to noise.
    """
    gyro = setup.gyro_per_s is not None
    free = (True, *(term in terms for term in TERMS), not gyro)
    chosen, eccentric = np.flatnonzero(free), ECCENTRICITY in terms
    values, offsets = np.array(coefficients, dtype=float), np.zeros(1) if gyro else np.array(eccentricity, dtype=float)
    start, step = trajectory.start_s, trajectory.step_s
    state = np.stack([trajectory.angle_rad, trajectory.speed_rad_per_s], axis=1).ravel()
    begin = state[:2].copy()
    sampler = _sampler(time_s, trajectory, setup)
    extra = len(offsets) * (gyro or eccentric)
    jacobian = np.zeros((len(time_s), len(chosen) + extra + 2))
    converged = False
    iteration = 0
    while not converged and iteration < _MAX_ITERATIONS:
        iteration += 1
        try:
            columns = linearised(state, begin, step, Coefficients(*values), chosen, forces=setup.forces)
            seen = sampler @ state
            error = reading_rad - _read(seen, offsets)
            sampled = _read_derivatives(seen, sampler @ columns, offsets, free=extra > 0)
            jacobian = sampled[:, 1:]
            change, moved_rad = _gauss_newton(jacobian, error - sampled[:, 0])
        except np.linalg.LinAlgError:
            break
        moved = columns[:, 0] + columns[:, 1:] @ np.concatenate([change[: len(chosen)], change[-2:]])
        if not np.max(np.abs(moved[::2])) < _RUNAWAY_RAD:
            break
        state = state + moved
        values[chosen] += change[: len(chosen)]
        offsets += change[len(chosen) : -2] if extra else 0.0
        begin += change[-2:]
        off_equation_rad = float(np.max(np.abs(columns[::2, 0])))
        uncertain_rad = math.sqrt(float(error @ error) * len(change)) / len(error)
        converged = moved_rad < max(_CONVERGED_RAD, _CONVERGED * uncertain_rad) and off_equation_rad < max(
            _ON_THE_EQUATION_RAD, _CONVERGED * uncertain_rad
        )
    return OutputError(
        coefficients=Coefficients(*map(float, values)),
        eccentricity=CENTRED if gyro else Eccentricity(*map(float, offsets)),
        eccentric=eccentric,
        setup=setup,
        bias_rad=float(offsets[0]) if gyro else 0.0,
        start_angle_rad=float(begin[0]),
        start_speed_rad_per_s=float(begin[1]),
        trajectory=Trajectory(start, step, state[::2], state[1::2]),
        residual_rad=reading_rad - _read(sampler @ state, offsets),
        jacobian=jacobian,
        free=free,
        iterations=iteration,
        converged=converged,
    )


def probed(fit: OutputError, time_s: Array) -> tuple[Array, Array, Array]:
    """Return the readings' derivatives (n, p) with respect to all that a fit may leave free, W first, and to probes.

    The probes (n, 3) are excesses of dry friction below two low speeds, and one that grows with 1 - cos phi; the last
    array (n,) is for a spring.
    """
    path, gyro = fit.trajectory, fit.setup.gyro_per_s is not None
    state = np.stack([path.angle_rad, path.speed_rad_per_s], axis=1).ravel()
    probes = slice(len(fit.coefficients), len(fit.coefficients) + len(PROBES))
    everything = np.arange(probes.stop + 1)
    columns = linearised(state, state[:2], path.step_s, fit.coefficients, everything, forces=fit.setup.forces)[:, 1:]
    sampler = _sampler(time_s, path, fit.setup)
    offsets = np.array([fit.bias_rad] if gyro else fit.eccentricity)
    read = _read_derivatives(
        np.asarray(sampler @ state), np.asarray(sampler @ columns), offsets, free=gyro or fit.eccentric
    )
    left_out = [4] if gyro else []  # for rates, zero has the same effect as the start angle
    own = np.delete(read, [*left_out, *range(probes.start, probes.stop + 1)], axis=1)
    return own, read[:, probes], read[:, probes.stop]


def _read(seen: Array, offsets: Array) -> Array:
    """Return the readings of a gyro with a bias (1,) at rates (n,), or of an eccentric encoder (2,) at angles (n,)."""
    if len(offsets) == 1:
        return np.asarray(seen + offsets[0])
    if not offsets.any():
        return seen
    return np.asarray(seen + offsets[0] * np.sin(seen) + offsets[1] * (np.cos(seen) - 1))


def _read_derivatives(seen: Array, columns: Array, offsets: Array, *, free: bool) -> Array:
    """Convert derivatives (n, 1 + p + 2) of an angle or a rate to those of readings, and add those of free offsets."""
    if len(offsets) == 1:
        bias = np.ones((len(columns), 1))
        return np.concatenate([columns[:, :-2], bias, columns[:, -2:]], axis=1) if free else columns
    if not (free or offsets.any()):
        return columns
    sine, cosine = np.sin(seen), np.cos(seen)
    read = (1 + offsets[0] * cosine - offsets[1] * sine)[:, None] * columns
    if not free:
        return np.asarray(read)
    return np.concatenate([read[:, :-2], np.stack([sine, cosine - 1], axis=1), read[:, -2:]], axis=1)


def sample(trajectory: Trajectory, time_s: Array) -> Array:
    """Return the trajectory's angle at any times (n,) within its grid, by cubic Hermite interpolation."""
    state = np.stack([trajectory.angle_rad, trajectory.speed_rad_per_s], axis=1).ravel()
    return np.asarray(_sampler(time_s, trajectory, PLAIN) @ state)


def _gauss_newton(jacobian: Array, error: Array) -> tuple[Array, float]:
    """Return the least-squares step and the rms change of the prediction by it."""
    products = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(products))
    scale[scale == 0] = 1.0
    normal = products / np.outer(scale, scale) + 1e-13 * np.eye(len(scale))
    change = np.linalg.solve(normal, jacobian.T @ error / scale)
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
