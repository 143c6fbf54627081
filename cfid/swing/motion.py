"""Integrate the fitted pendulum's equation of motion again, with an adaptive integrator from SciPy.

The fit solves a collocated system; this integration shares nothing with it except the fitted values, so that their
agreement is evidence for both (as at the end of C.1.3, with ode45).
"""

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

from cfid.swing.collocation import SLOW_RAD_PER_S, Coefficients, Threads
from cfid.swing.estimation import SwingFit

Array = npt.NDArray[np.float64]

_TOLERANCE = 1e-8


def fitted_motion(fit: SwingFit, time_s: Array) -> Array:
    """Return the angle (n,) at increasing times (n,), none before the fit's start, from its start state.

    The equation is that of `model`.
    With dry friction, each half-swing is integrated separately, because the integrator cannot step over a jump, and the
    body stops where gravity no longer overcomes the friction.
    """
    start = fit.output_error
    state = np.array([start.start_angle_rad, start.start_speed_rad_per_s])
    now, end = start.trajectory.start_s, float(time_s[-1])
    angle = np.full(len(time_s), state[0])
    while now < end and (side := _side(state, start.coefficients)):
        segment = _until_it_turns(state, start.coefficients, start.setup.threads, side, (now, end))
        turned = segment.status == 1
        reached = float(segment.t[-1])
        state = np.array([segment.y[0, -1], 0.0 if turned else segment.y[1, -1]])
        inside = (time_s >= now) & (time_s <= reached)
        if np.any(inside):  # a half-swing may lie in a gap of the recording
            angle[inside] = segment.sol(time_s[inside])[0]
        angle[time_s > reached] = state[0]
        now = reached
    return angle


def _side(state: Array, coefficients: Coefficients) -> float:
    """Return the sign of the body's next motion, 0 if dry friction holds it."""
    if state[1] != 0.0:
        return float(np.sign(state[1]))
    turned = state[0] - coefficients.zero_rad
    pull = -coefficients.natural_frequency_squared_s2 * np.sin(turned) - coefficients.spring_per_s2 * turned
    return float(np.sign(pull)) if abs(pull) > _dry_friction(state, coefficients) else 0.0


def _dry_friction(state: Array, coefficients: Coefficients) -> float:
    """Return the size of dry friction at an angle and a speed, per inertia."""
    slow, less_slow = (np.exp(-((state[1] / limit) ** 2)) for limit in SLOW_RAD_PER_S)
    aside = 1 - np.cos(state[0] - coefficients.zero_rad)
    return float(coefficients.coulomb_per_s2 + np.dot(coefficients[-3:], [slow, less_slow, aside]))


class _Turning:
    """Detect for solve_ivp that the speed falls to zero, for a body that moves to one side."""

    terminal = True

    def __init__(self, side: float) -> None:
        self.direction = -side

    def __call__(self, _: float, state: Array) -> float:
        return float(state[1])


def _until_it_turns(
    state: Array, coefficients: Coefficients, threads: Threads, side: float, span_s: tuple[float, float]
) -> Any:
    """Integrate to the end or, with dry friction, until the body turns."""
    stiffness, viscous, _, quadratic, zero, spring, *_ = coefficients

    def derivative(_: float, y: Array) -> tuple[float, float]:
        drag = viscous * y[1] + quadratic * y[1] * abs(y[1]) + _dry_friction(y, coefficients) * side
        drag += spring * (y[0] - zero)
        height = np.sqrt(1 - 2 * threads.ratio * (1 - np.cos(y[0] - zero)))  # relative to that at rest
        pull = np.sin(y[0] - zero) / height
        steeper = np.cos(y[0] - zero) / height + threads.ratio * pull**2 / height
        rise = stiffness * threads.fall_s2 * pull
        return y[1], -(stiffness * pull + rise * steeper * y[1] ** 2 + drag) / (1 + rise * pull)

    return solve_ivp(
        derivative,
        span_s,
        state,
        method="DOP853",
        rtol=_TOLERANCE,
        atol=_TOLERANCE,
        dense_output=True,
        events=_Turning(side) if any(coefficients[2:3] + coefficients[-3:]) else None,
    )
