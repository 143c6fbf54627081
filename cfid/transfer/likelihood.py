"""Minimise the cost of a transfer function with delays, from starting points it finds itself; uses numbers alone.

The cost is the sum of |H_k - G(f_k)|^2 over variances, for all series at once; it is chi-squared if the model holds (R.
Pintelon, J. Schoukens, System identification: a frequency domain approach, 2012). An uncertain start of a run allows a
rotation of its H_k.
"""

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.estimate.linear import gain_of, slopes
from cfid.transfer.frequency_response import Response
from cfid.transfer.model import Complex, Dynamics, Form

Array = npt.NDArray[np.float64]
Shape = Literal["first", "first+delay", "second", "zero"]

SHAPES: tuple[Shape, ...] = ("first", "first+delay", "second", "zero")

_EXACT = 1e-4  # of a response: no plant is linear more exactly than this
_SCANNED_S = np.arange(-0.2, 0.2, 0.002)
_SECOND_LAG = (0.03, 0.3)  # of the first lag, as initial values
_ROUNDS = 50
_SETTLED = 1e-8  # of chi-squared: a ten-thousandth of a standard uncertainty


class StackedResponses(NamedTuple):
    """Responses of all series in a row (n,), the series of each, and matrices (n, 2, 2) that whiten their residuals.

    `shared` (m, n) is the change of each response by one standard uncertainty of each error that several runs share.
    """

    omega_rad_s: Array
    value: Complex
    series: npt.NDArray[np.intp]
    series_count: int
    whitener: Array
    shared: Complex
    sample_s: float
    form: Form


class Found(NamedTuple):
    """Parameters (p,): gain, logarithm of each lag, lead if free, delays if free; cost and its Jacobian (2n, p)."""

    values: Array
    jacobian: Array
    cost: float


def points_of(series: Sequence[Sequence[Response]], *, scatter_s: float = 0.0) -> StackedResponses:
    """Put the responses of all series in a row; `scatter_s` is the standard deviation of delays from run to run."""
    responses = [response for own in series for response in own]
    value = np.array([response.value for response in responses])
    omega = np.array([response.frequency_rad_s for response in responses])
    along = np.stack([-value.imag, value.real], axis=1)  # the direction in which a late start moves the response
    turned = along * (omega * np.hypot([response.start_std_s for response in responses], scatter_s))[:, None]
    floor = (_EXACT * np.abs(value)) ** 2
    noise = np.array([response.covariance for response in responses]) + floor[:, None, None] * np.eye(2)
    covariance = noise + turned[:, :, None] * turned[:, None, :]
    return StackedResponses(
        omega_rad_s=omega,
        value=value,
        series=np.repeat(np.arange(len(series)), [len(own) for own in series]),
        series_count=len(series),
        whitener=np.linalg.inv(np.linalg.cholesky(covariance)),
        shared=_shared(series) * -1j * omega * value,
        sample_s=float(np.mean([response.sample_s for response in responses])),
        form=responses[0].form,
    )


def unknowns(shape: Shape, series_count: int) -> int:
    """Return the number of free parameters."""
    return dynamic_unknowns(shape) + (0 if shape == "first" else series_count)


def dynamic_unknowns(shape: Shape) -> int:
    """Return the number of free parameters that are not delays."""
    return 2 if shape.startswith("first") else 3


def dynamics_of(values: Array, shape: Shape) -> Dynamics:
    """Return the dynamics that parameters (p,) describe, without delays."""
    lags = np.exp(np.clip(values[1:], -20, 20))
    if shape == "second":
        return Dynamics(static_gain_n=float(values[0]), lags_s=(float(lags[0]), float(lags[1])))
    lead_s = float(values[2]) if shape == "zero" else 0.0
    return Dynamics(static_gain_n=float(values[0]), lags_s=(float(lags[0]),), lead_s=lead_s)


def model_at(points: StackedResponses, values: Array, shape: Shape) -> Complex:
    """Return the model's responses (n,), each with its series' delay."""
    plant = dynamics_of(values, shape).response(points.omega_rad_s, sample_s=points.sample_s, form=points.form)
    if shape == "first":
        return plant
    delays = values[dynamic_unknowns(shape) :][points.series]
    return np.asarray(plant * np.exp(-1j * points.omega_rad_s * delays))


def search(points: StackedResponses, shape: Shape, *, polar: bool = False) -> Found:
    """Return the parameters with the least cost that the search finds from all its starting points.

    `polar` compares sizes and phases, which a late start does not mix, however late it is.
    """

    def residual(values: Array) -> Array:
        model = model_at(points, values, shape)
        return whitened(points, points.value * np.log(points.value / model) if polar else points.value - model)

    return min((_minimise(residual, guess) for guess in _guesses(points, shape)), key=lambda found: found.cost)


def whitened(points: StackedResponses, apart: Complex) -> Array:
    """Return differences of responses (n,) over their uncertainties, real and imaginary parts alternating (2n,)."""
    return np.asarray((points.whitener @ np.stack([apart.real, apart.imag], axis=1)[:, :, None]).ravel())


def deviance(points: StackedResponses, found: Found) -> float:
    """Return minus twice the logarithm of the likelihood, less a constant, with the noise inflated by its scatter."""
    count = len(found.jacobian)
    inflation = max(1.0, found.cost / max(count - len(found.values), 1))
    determined = float(np.sum(np.log(np.abs(np.linalg.det(points.whitener)))))
    return count * float(np.log(inflation)) + found.cost / inflation - 2 * determined


def covariance_of(points: StackedResponses, found: Found) -> Array:
    """Return the covariance of the parameters (p, p): noise, inflated by its scatter, and shared errors."""
    degrees_of_freedom = len(found.jacobian) - len(found.values)
    inverse = gain_of(found.jacobian)
    covariance = inverse @ inverse.T * max(1.0, found.cost / max(degrees_of_freedom, 1))
    for turned in points.shared:
        moved = inverse @ whitened(points, turned)
        covariance += np.outer(moved, moved)
    return np.asarray(covariance)


def _shared(series: Sequence[Sequence[Response]]) -> Array:
    """Return errors of starts in s (m, n), with one row for each error that runs of a series share."""
    rows: dict[tuple[int, str], dict[int, float]] = {}
    place = 0
    for number, own in enumerate(series):
        for response in own:
            for name, shift_s in response.shared_s.items():
                rows.setdefault((number, name), {})[place] = shift_s
            place += 1
    shared = np.zeros((len(rows), place))
    for row, shifts in zip(shared, rows.values(), strict=True):
        row[list(shifts)] = list(shifts.values())
    return shared


def _guesses(points: StackedResponses, shape: Shape) -> list[Array]:
    """Return starting points from Levy's linear fit to each series, with its best-fitting delay."""
    scanned = np.array([0.0]) if shape == "first" else _SCANNED_S
    found = np.array([_levy(points, points.series == place, scanned) for place in range(points.series_count)])
    gain, lag_s = found[:, :2].mean(axis=0)
    delays = found[:, 2] + (points.sample_s if points.form == "thesis" else 0.0)
    if shape == "first":
        return [np.array([gain, np.log(lag_s)])]
    if shape == "first+delay":
        return [np.array([gain, np.log(lag_s), *delays])]
    if shape == "zero":
        return [np.array([gain, np.log(lag_s), 0.0, *delays])]
    return [np.array([gain, np.log(lag_s), np.log(lag_s * part), *delays]) for part in _SECOND_LAG]


def _levy(points: StackedResponses, rows: npt.NDArray[np.bool_], scanned_s: Array) -> tuple[float, float, float]:
    """Return gain, lag and delay of K = H (1 + s lag), linear in gain and lag for each scanned delay.

    E. C. Levy, Complex-curve fitting, IRE Trans. Automatic Control 4 (1959).
    """
    omega, weight = points.omega_rad_s[rows], np.abs(np.linalg.det(points.whitener[rows]))
    half = omega * points.sample_s / 2
    held = points.value[rows] * np.exp(1j * half) / np.sinc(half / np.pi)
    turned = held * np.exp(1j * omega * scanned_s[:, None])
    lagged = -1j * omega * turned
    mixed = lagged.real @ weight
    normal = np.array([[np.full_like(mixed, weight.sum()), mixed], [mixed, np.abs(lagged) ** 2 @ weight]])
    wanted = np.stack([turned.real @ weight, (lagged.conj() * turned).real @ weight], axis=1)
    gain, lag_s = np.linalg.solve(normal.transpose(2, 0, 1), wanted[:, :, None])[:, :, 0].T
    lag_s = np.maximum(lag_s, points.sample_s)
    missed = turned - gain[:, None] / (1 + 1j * omega * lag_s[:, None])
    best = int(np.argmin(np.abs(missed) ** 2 @ weight))
    return float(gain[best]), float(lag_s[best]), float(scanned_s[best])


def _minimise(residual: Callable[[Array], Array], start: Array) -> Found:
    """Return the least-squares solution from a start, by damped Gauss-Newton steps (Levenberg, Marquardt)."""
    values, damping = start, 1e-3
    now = residual(values)
    cost = float(now @ now)
    for _ in range(_ROUNDS):
        jacobian = slopes(residual, values)
        scale = np.linalg.norm(jacobian, axis=0) + 1e-300
        normal = (jacobian / scale).T @ (jacobian / scale)
        step = np.linalg.solve(normal + damping * np.eye(len(values)), -(jacobian / scale).T @ now) / scale
        trial = residual(values + step)
        if float(trial @ trial) <= cost:
            gained, cost = cost - float(trial @ trial), float(trial @ trial)
            values, now, damping = values + step, trial, damping / 10
            if gained <= _SETTLED * max(1.0, cost):
                break
        elif damping > 1e12:
            break
        else:
            damping *= 8
    return Found(values, slopes(residual, values), cost)
