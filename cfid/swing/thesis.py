"""Fit a swing by the thesis' methods: damped cosine, flexible function, and the logarithmic decrement.

All of them work with frequencies, W = m g r / I_a and friction per inertia, so they need no mass and no distance. This
is appendix C.1.3 with its minima found by least squares instead of a simplex search.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from cfid.errors import FitError
from cfid.estimate.signals import GRID_S, resample
from cfid.swing.window import FreeSwing

Array = npt.NDArray[np.float64]

_AT_REST_RAD = 0.003  # C.1.3, `tol`


class Frequencies(NamedTuple):
    """The results of each of these methods."""

    natural_frequency_squared_s2: float
    viscous_per_s: float


@dataclass(frozen=True, kw_only=True)
class DampedCosine:
    """Fit of eq. 2.11 on the 4 ms grid (n,), with the start angle fixed at the first point, as in eq. 2.15.

    `std` is computed as if the residual were white noise, which it is not: the thesis states none.
    """

    frequencies: Frequencies
    start_angle_rad: float
    start_speed_rad_per_s: float
    time_s: Array
    angle_rad: Array
    model_rad: Array
    std: Frequencies


@dataclass(frozen=True, kw_only=True)
class FlexibleFunction:
    """Fit of eq. 2.16 with its analytic derivatives (n,), and the equation of motion 2.9 fitted to them."""

    frequencies: Frequencies
    coefficients: Array
    time_s: Array
    angle_rad: Array
    model_rad: Array
    speed_rad_per_s: Array
    acceleration_rad_per_s2: Array


def fit_damped_cosine(swing: FreeSwing) -> DampedCosine:
    """Fit the linearised pendulum from the release to the last peak used. Raises FitError where nothing oscillates."""
    time, angle = resample(*swing.free, step_s=GRID_S)
    time = time - time[0]
    begin = float(angle[0])
    frequency = (2 * np.pi / swing.period_s) ** 2
    decay = log_decrement(swing)[0].viscous_per_s
    scale = np.array([frequency, np.sqrt(frequency), np.sqrt(frequency)])

    def residual(p: Array) -> Array:
        return _damped_cosine(time, begin, *(p * scale)) - angle

    found = least_squares(residual, np.array([1.0, decay / scale[1], 0.0]), method="lm", xtol=1e-12, ftol=1e-12)
    squared, viscous, speed = found.x * scale
    if np.linalg.matrix_rank(found.jac) < len(scale):
        raise FitError(
            f"no oscillation of {swing.period_s:.2g} s is seen in the {time[-1]:.4g} s used: was the clock set, or are "
            "samples missing?"
        )
    variance = 2 * found.cost / max(len(angle) - 3, 1)
    std = np.sqrt(variance * np.diag(np.linalg.inv(found.jac.T @ found.jac))) * scale
    return DampedCosine(
        frequencies=Frequencies(float(squared), float(viscous)),
        start_angle_rad=begin,
        start_speed_rad_per_s=float(speed),
        time_s=time + swing.release_s,
        angle_rad=angle,
        model_rad=found.fun + angle,
        std=Frequencies(float(std[0]), float(std[1])),
    )


def fit_flexible(swing: FreeSwing) -> FlexibleFunction:
    """Fit eq. 2.16 to the swing until it comes to rest, then eq. 2.9 to its derivatives.

    The thesis searched for the second minimum with a simplex that never left its start (table 2.4 repeats table 2.3);
    the objective is linear in 1/W and M/(I W), so it is solved directly here.
    """
    cosine = fit_damped_cosine(swing)
    time, angle = resample(swing.time_s[swing.release :], swing.angle_rad[swing.release :], step_s=GRID_S)
    resting = np.abs(angle) < _AT_REST_RAD
    stop = np.flatnonzero(resting[:-3] & resting[1:-2] & resting[3:])
    last = stop[0] + 1 if len(stop) else len(angle)
    time, angle = time[:last] - time[0], angle[:last]
    squared, viscous = cosine.frequencies
    decay = viscous / 2
    omega = np.sqrt(max(squared - decay**2, 0.0))
    tangent = (cosine.start_speed_rad_per_s + decay * angle[0]) / (omega * angle[0])
    amplitude = angle[0] * np.hypot(1.0, tangent)
    start = np.array([0.0, 0.0, amplitude - 1.0, decay, omega, 0.0, 0.0, -np.arctan(tangent)])
    found = least_squares(lambda a: _flexible(time, a)[0] - angle, start, x_scale="jac", max_nfev=200)
    model, speed, acceleration = _flexible(time, found.x)
    terms = np.stack([acceleration, speed], axis=1)
    inverse, ratio = np.linalg.lstsq(terms, -np.sin(model), rcond=None)[0]
    return FlexibleFunction(
        frequencies=Frequencies(float(1 / inverse), float(ratio / inverse)),
        coefficients=found.x,
        time_s=time + swing.release_s,
        angle_rad=angle,
        model_rad=model,
        speed_rad_per_s=speed,
        acceleration_rad_per_s2=acceleration,
    )


def log_decrement(swing: FreeSwing) -> tuple[Frequencies, float]:
    """Return natural frequency and damping from the peaks alone, ln(phi(t)/phi(t+T)) = T delta (section 2.4.4).

    They are means over successive peaks; with them, the scatter of the damping per s.
    """
    used = slice(0, swing.peaks_used)
    times, heights = swing.peak_time_s[used], np.abs(swing.peak_angle_rad[used])
    decays = np.log(heights[:-1] / heights[1:]) / np.diff(times)
    decay = float(np.log(heights[0] / heights[-1]) / (times[-1] - times[0]))
    omega = 2 * np.pi * (len(times) - 2) / (times[-1] - times[1])
    return Frequencies(float(omega**2 + decay**2), 2 * decay), float(2 * np.std(decays, ddof=1))


def _damped_cosine(time: Array, start: float, squared: float, viscous: float, speed: float) -> Array:
    decay = viscous / 2
    omega = np.sqrt(max(squared - decay**2, 1e-12))
    sine = (speed + decay * start) / omega
    return np.asarray(np.exp(-decay * time) * (start * np.cos(omega * time) + sine * np.sin(omega * time)))


def _flexible(time: Array, a: Array) -> tuple[Array, Array, Array]:
    """Return eq. 2.16 and its first two derivatives."""
    fading = np.exp(-a[3] * time)
    height = a[0] * time**2 + a[1] * time + a[2] + fading
    height_1 = 2 * a[0] * time + a[1] - a[3] * fading
    height_2 = 2 * a[0] + a[3] ** 2 * fading
    phase = (a[4] + a[5] * time + a[6] * time**2) * time + a[7]
    phase_1 = a[4] + 2 * a[5] * time + 3 * a[6] * time**2
    phase_2 = 2 * a[5] + 6 * a[6] * time
    cosine, sine = np.cos(phase), np.sin(phase)
    speed = height_1 * cosine - height * phase_1 * sine
    acceleration = (height_2 - height * phase_1**2) * cosine - (2 * height_1 * phase_1 + height * phase_2) * sine
    return height * cosine, speed, acceleration
