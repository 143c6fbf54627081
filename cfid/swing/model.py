"""The damped pendulum fitted to an angle record by output error; knows nothing of rigs, mounts or masses.

The model is eq. 2.9 of the thesis with its sine kept and two damping terms added,

    phi'' = -W sin(phi - zero) - c phi' - s sgn(phi') - q phi' |phi'|,

W = m g r / I_a and c, s, q the damping divided by I_a. An encoder whose disc is eccentric reads
phi + a sin phi + b (cos phi - 1), the first harmonic of its error about rest. The trajectory itself is an
unknown, see `collocation`. Started on the measured angle, it cannot slip by a period as shooting from
a guess can.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from cfid.estimate.signals import smooth
from cfid.swing.collocation import Coefficients, linearised

Array = npt.NDArray[np.float64]

TERMS = ("viscous", "coulomb", "quadratic")
PROBES = ("low speed", "low speed", "angle")  # what dry friction may vary with, unlike the model's
ECCENTRICITY = "eccentricity"

_MAX_ITERATIONS = 20
_CONVERGED_RAD = 1e-8  # step of the predicted angle, rms
_ON_THE_EQUATION_RAD = 1e-7
_CONVERGED = 0.05  # of the uncertainty that white noise leaves the predicted angle
_RUNAWAY_RAD = 10.0  # a step that throws the pendulum over the top will not come back


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
            columns = linearised(state, begin, step, Coefficients(*values), chosen)
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
    columns = linearised(state, state[:2], path.step_s, fit.coefficients, np.arange(8))[:, 1:]
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
    products = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(products))
    scale[scale == 0] = 1.0
    normal = products / np.outer(scale, scale) + 1e-13 * np.eye(len(scale))
    change = np.linalg.solve(normal, jacobian.T @ error / scale)
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
