"""A quadrocopter in flight as equations that are linear in what is unknown: what its sensors show of its rotors.

Axes are the vehicle's: x forward, y left, z up. Each rotor's drive, the command over the full one, times the battery's
volts where these are known, lags to w; thrust is c0 + c1 w + c2 w^2 of one rotor, along z. The equations are

    f_z = sum(T_i) / m + what climbing and the battery take away            specific force, by the accelerometer
    d(rate_x)/dt = (l / J_x) sum(+-T_i) + what else turns the vehicle       and alike about y, and z with q for l

with l the lever of a rotor about x and y, its arm over the root of two, and q its torque over its thrust. Each sensor
shows this with a delay of its own, air, electronics and the vehicle's filter, whose shape is known on a Crazyflie.
Elsewhere what the accelerometer shows later than the gyro is ascribed to a filter of second order.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.signal import butter, lfilter

from cfid.estimate.held_lag import follow_held
from cfid.flight.rows import AXES, ROW_S, ROW_STEPS, STEP_S, Flight, delayed, segments, with_ends

Array = npt.NDArray[np.float64]

CLIMB_S = 5.0  # over which the climb is integrated from the force: the battery's terms take what is slower
DAMPING = 1  # the place of the rate among the other terms of an equation about an axis
SAG_S = 5.0  # half the shortest period in which the battery's charge changes the thrust
_LEAST_FILTERED_S = 1e-4  # as a filter of 240 Hz: steps of 2 ms show none above 250 Hz
_KEPT = 4  # lags and delays whose equations are kept: those of a solution, and of slopes around it


class ThrustLag(NamedTuple):
    """dw/dt = (u - w) / tau of a rotor's drive u, tau being `rising_s` where u > w and `falling_s` elsewhere."""

    rising_s: float
    falling_s: float

    def follow(self, drive: Array) -> Array:
        """Return what follows drives (n, 4), each held for a step, at the begin of each step; it starts settled."""
        rising, falling = (math.exp(-STEP_S / tau_s) for tau_s in self)
        return follow_held(drive.T, rising, falling).T


class FlightEquation(NamedTuple):
    """An equation of one flight at rows (k,): `shown` is a sum of `terms`, by the powers of thrust, and `others`.

    `terms` (k, 3) go with c0, c1, c2; `others` (k, q) are what else may act, each with a coefficient of its own.
    `lengths` are those of the segments without a gap. That of the vertical force has a constant among the others.
    """

    axis: int | None
    shown: Array
    terms: Array
    others: Array
    lengths: tuple[int, ...]


EquationsOf = Callable[..., list[FlightEquation]]


def equations_of(flight: Flight) -> EquationsOf:
    """Return what gives the equations of the vertical force and of the rates about each axis, for rotors of a lag.

    It takes the lag, by how much later the accelerometer and the gyro show it, their filters included, and the share
    of what is left of these delays that the command alone has, not the voltage. An accelerometer whose filter is not
    known has one that makes it later than the gyro, but for the share `unfiltered` of that. The last few are kept: a
    slope over the gyro's delay leaves the rotors as they were.
    """

    along_z = _others_along_z(flight)

    @lru_cache(_KEPT)
    def late(lag: ThrustLag, command_s: float) -> Array:
        return lag.follow(flight.drives_of_late(command_s))

    @lru_cache(_KEPT)
    def vertical(lag: ThrustLag, command_s: float, delay_s: float, low_pass_hz: float | None) -> FlightEquation:
        return _vertical(flight, _seen(late(lag, command_s), delay_s, low_pass_hz), along_z)

    @lru_cache(_KEPT)
    def turning(lag: ThrustLag, command_s: float, delay_s: float) -> list[FlightEquation]:
        powers = _seen(late(lag, command_s), delay_s, flight.low_pass_hz[1])
        return [turning_equation(flight, powers, axis) for axis in range(len(AXES))]

    def equations(
        lag: ThrustLag, delays_s: tuple[float, float], of_command: float = 0.0, unfiltered: float = 0.0
    ) -> list[FlightEquation]:
        of_force_s, of_rates_s = delays_s
        low_pass_hz = flight.low_pass_hz[0] or _low_pass_hz((1 - unfiltered) * (of_force_s - of_rates_s))
        common_s = min(of_force_s - filtering_s(low_pass_hz), of_rates_s - filtering_s(flight.low_pass_hz[1]))
        command_s = 0.0 if flight.volts is None else of_command * max(common_s, 0.0)
        return [
            vertical(lag, command_s, of_force_s - command_s, low_pass_hz),
            *turning(lag, command_s, of_rates_s - command_s),
        ]

    return equations


def _seen(late: Array, delay_s: float, low_pass_hz: float | None) -> Array:
    """Return the powers (3, n, 4) of lagging drives as a sensor shows them, whose filter is a part of the delay."""
    if low_pass_hz is None:
        return _powers(delayed(late, delay_s))
    powers = _powers(delayed(late, delay_s - filtering_s(low_pass_hz)))
    settled = powers[1:, :1]
    b, a = _low_pass(low_pass_hz)
    powers[1:] = settled + lfilter(b, a, powers[1:] - settled, axis=1)
    return powers


@lru_cache(_KEPT)
def _low_pass(low_pass_hz: float) -> tuple[Array, Array]:
    """Return the coefficients b (3,) and a (3,) of a sensor's filter, at steps of drives."""
    b, a = butter(2, low_pass_hz, fs=1 / STEP_S)
    return b, a


def filtering_s(low_pass_hz: float | None) -> float:
    """Return by how much a sensor's filter delays slow motion, 0 where it is unknown."""
    return 0.0 if low_pass_hz is None else STEP_S / math.sqrt(2) / math.tan(math.pi * low_pass_hz * STEP_S)


def _low_pass_hz(delay_s: float) -> float | None:
    """Return the cut-off of the filter that delays slow motion by so much, None for less than a filter can."""
    return math.atan(STEP_S / math.sqrt(2) / delay_s) / (math.pi * STEP_S) if delay_s > _LEAST_FILTERED_S else None


def _powers(late: Array) -> Array:
    return np.stack([np.ones_like(late), late, late**2])  # (3, n, 4)


def _vertical(flight: Flight, powers: Array, others: Array) -> FlightEquation:
    terms = _rows(flight, _over_rotors(powers).T)
    return _cut(None, flight.force[:, 2], terms, others, segments(flight.driven))


def _over_rotors(each: Array) -> Array:
    """Return the sums over rotors, the last of some axes: NumPy's sum over so few is slow."""
    return np.asarray(each[..., 0] + each[..., 1] + each[..., 2] + each[..., 3])


def _others_along_z(flight: Flight) -> Array:
    """Return what else than rotors may act vertically (m, q)."""
    climb = _climbing(flight) if flight.velocity is None else flight.velocity[:, 2:]
    count = len(flight.rates)
    phase = np.pi * np.arange(count) / count
    sag = [np.cos(times * phase) for times in range(1 + max(round(count * ROW_S / SAG_S), 1))]
    return np.column_stack([climb, _off_centre(flight.rates), *sag])


def _off_centre(rates: Array) -> Array:
    """Return what turning at rates (m, 3) adds along z (m, 5) to an accelerometer 1 m forward, left and up.

    The last two are what changes of the first two where gyro and accelerometer show them at different times.
    """
    x, y, z = rates.T
    quicker = np.gradient(rates, ROW_S, axis=0)
    added = np.column_stack([z * x - quicker[:, 1], z * y + quicker[:, 0], -(x**2) - y**2])
    return np.column_stack([added, np.gradient(added[:, :2], ROW_S, axis=0)])


def _climbing(flight: Flight) -> Array:
    """Return two parts (m, 2) of the climb along the vehicle's z, none in the mean, each but for a factor.

    Vertical force adds up to the one. The other is sideways velocity that turning makes vertical: the sideways force is
    the drag of that velocity. Without it, thrust's slope scatters by a quarter more.
    """
    force = (flight.force - np.mean(flight.force[flight.driven], axis=0)) * flight.airborne[:, np.newaxis]
    turned = flight.rates[:, 0] * force[:, 1] - flight.rates[:, 1] * force[:, 0]
    faded = lfilter([ROW_S / 2, ROW_S / 2], [1.0, -math.exp(-ROW_S / CLIMB_S)], [force[:, 2], turned]).T
    return np.asarray(faded - np.mean(faded[flight.driven], axis=0))


def turning_equation(flight: Flight, powers: Array, axis: int) -> FlightEquation:
    """Return the equation of the rate about an axis, of powers (3, n, 4) of lagging drives as the gyro shows them."""
    turning = (powers @ flight.turning[axis]).T  # (n, 3)
    gone = _rows(flight, (np.cumsum(turning, axis=0) - turning / 2) * STEP_S)  # trapezoids, but for a constant
    total = _rows(flight, _over_rotors(powers[1])[:, np.newaxis])[:, 0]
    rates = flight.rates[:-1]  # the later ones contain the error that is to be predicted
    others = [
        np.ones(len(rates)),
        rates[:, axis],
        rates[:, axis - 2] * rates[:, axis - 1],
        (total[1:] + total[:-1]) / 2,
    ]
    if axis == 2:  # what speeds a rotor up turns the vehicle the other way
        others.append(np.diff(_rows(flight, turning[:, 1:2])[:, 0]) / ROW_S)
    known = flight.rates_known if segments(flight.rates_known) else flight.driven  # else a finding rejects the moments
    both = known[1:] & known[:-1]
    shown = np.diff(flight.rates[:, axis]) / ROW_S
    return _cut(axis, shown, np.diff(gone, axis=0) / ROW_S, np.column_stack(others), segments(both))


def _rows(flight: Flight, steps: Array) -> Array:
    """Return what sensors would show (m, k) of values (n, k) of each step: means over rows, or values at them."""
    if flight.averaged:
        half = ROW_STEPS // 2
        # A step's mean differs from its middle by the bend: without it, thrust at 20 Hz is 0.3 % too large.
        around = with_ends(steps, 1, 1)
        means = steps + (around[2:] - 2 * steps + around[:-2]) / 24
        padded = with_ends(means, half, half)
        of_rows = [padded[step : step + len(steps) : ROW_STEPS] for step in range(ROW_STEPS)]
        return np.asarray(sum(of_rows) / ROW_STEPS)[: len(flight.rates)]
    return np.asarray(steps[::ROW_STEPS][: len(flight.rates)])


def _cut(axis: int | None, shown: Array, terms: Array, others: Array, parts: Sequence[slice]) -> FlightEquation:
    at = np.concatenate([np.arange(one.start, one.stop) for one in parts]) if parts else np.zeros(0, int)
    return FlightEquation(axis, shown[at], terms[at], others[at], tuple(one.stop - one.start for one in parts))
