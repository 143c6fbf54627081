"""Fit flights whose logs have the rotors' speeds: each equation is then linear in what is sought.

With w a rotor's speed and s its sense, T = k (w^2 + e w (w - w_h)) its thrust at speeds around that of hovering, w_h:

    m f_z = sum(T) + climb, ...                                                     specific force, by the accelerometer
    J_x d(rate_x)/dt = l sum(+-T) + (J_y - J_z) rate_y rate_z + h_x v_y + ...       the same about y
    J_z d(rate_z)/dt = q sum(-s T) - J_r sum(s dw/dt) + ...

Each is integrated over rows of 40 ms: the change between two means of a rate is the integral of the moments, weighted
by a triangle. What is faster is noise, vibration or a filter's; what an autoregression predicts of the errors is
removed, since an autopilot responds to it (decision 22). Speeds are known by telemetry that is later than the gyro by
the delay with which roll and pitch leave the smallest errors.

Thrust turns the vehicle about x and y by its slope over speed, which the accelerometer shows up to its scale. The level
k is gravity's: what carries the vehicle in the mean. The moment about z follows from the gyroscopic effect of a vehicle
that tilts while it turns, or from a known torque over thrust.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar
from uncertainties import UFloat, correlated_values, ufloat

from cfid.errors import FitError
from cfid.estimate.linear import sandwich
from cfid.estimate.signals import block_means
from cfid.flight.estimation import CrossedError
from cfid.flight.model import FlightEquation, others_along_z, whitened_fit, without
from cfid.flight.rows import AXES, LEVER, ROW_S, Flight, segments
from cfid.units import USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]

MEAN_ROWS = 4
MEAN_S = MEAN_ROWS * ROW_S
_FEWEST_MEANS = 32  # in a segment
_PAST = 4  # means that predict the next
_SHORTEST_S = 5.0  # of all flights together
LATEST_S, _TRIED = 0.03, 7  # the largest delay, and how many are tried before the nearest is refined
_LEVEL_S = 1.0  # whose mean forces are assumed to be independent
# Half of e, the relative slope of k over speed: of published propellers of this size, and its standard uncertainty.
_SLOPE, _SLOPE_STD = 0.04, 0.025
_CROSSED = 0.3  # of a moment's effect: what turns the vehicle about the other horizontal axis
_OWN, _EULER, _AIR = 0, 1, 3  # the places of coefficients about roll and pitch, and of the other horizontal moment:
_OTHER = 2
_TORQUE, _SPIN = 0, 1  # and about yaw


class EquationFit(NamedTuple):
    """The coefficients (p,) of an equation's terms, and its blocks, each with the rotors' contribution."""

    coefficients: tuple[UFloat, ...]
    blocks: tuple[tuple[FlightEquation, Array], ...]

    @property
    def explained(self) -> float:
        """The part of the variance that the equation explains, of what its other terms leave."""
        values = np.array([each.n for each in self.coefficients])
        left = np.concatenate([without(block.shown - block.terms @ values, block.others) for block, _ in self.blocks])
        whole = np.concatenate([without(block.shown, block.others) for block, _ in self.blocks])
        return float(1 - np.var(left) / max(float(np.var(whole)), 1e-300))


@dataclass(frozen=True, kw_only=True, eq=False)
class SpeedFit:
    """What flights with rotor speeds show, for a mass of 1 kg and an arm of 1 m where it depends on these.

    `thrust` is k over mass in m rad^-2, `half_slope` is e / 2, whose uncertainty contains that of the accelerometer's
    scale, `hover_rad_s` is w_h. `axes` are the equations about roll, pitch and yaw in terms of T / (k m), and
    `vertical` that of the specific force. `delay_s` is the mean of those of the flights' speeds.
    `with_velocity` is whether all flights have one.
    """

    thrust: UFloat
    half_slope: UFloat
    hover_rad_s: float
    vertical: EquationFit
    axes: tuple[EquationFit, EquationFit, EquationFit]
    delay_s: UFloat
    with_velocity: bool
    seconds: float

    @property
    def inertia_m(self) -> tuple[UFloat, UFloat]:
        """The moments about roll and pitch over mass times arm, in m."""
        roll, pitch = (LEVER * self.thrust.n / axis.coefficients[_OWN] for axis in self.axes[:2])
        return roll, pitch

    @property
    def yaw_inertia_m(self) -> UFloat:
        """The moment about yaw over mass times arm in m, by the gyroscopic effects about roll and pitch."""
        (roll, pitch), (of_roll, of_pitch) = self.inertia_m, (axis.coefficients[_EULER] for axis in self.axes[:2])
        by_roll, by_pitch = pitch - of_roll * roll, roll + of_pitch * pitch
        share = by_pitch.s**2 / (by_roll.s**2 + by_pitch.s**2)
        return share * by_roll + (1 - share) * by_pitch

    @property
    def torque_per_inertia(self) -> UFloat:
        """A rotor's torque over its thrust, over the moment about yaw, times mass, in 1/m."""
        return self.axes[2].coefficients[_TORQUE] / self.thrust.n

    @property
    def spin_per_inertia(self) -> UFloat:
        """The rotor's inertia over the moment about yaw."""
        return self.axes[2].coefficients[_SPIN]

    @property
    def air_m(self) -> tuple[UFloat, ...]:
        """The moments of air about roll and pitch over velocity, mass and arm, in 1/s; none without velocities."""
        pairs = zip(self.axes, self.inertia_m, strict=False)
        return tuple(axis.coefficients[_AIR] * inertia for axis, inertia in pairs) if self.with_velocity else ()


def fit_speeds(flights: Sequence[Flight], *, scale_std: float) -> SpeedFit:
    """Fit one vehicle to its flights, all of which have speeds; `scale_std` is that of the accelerometer.

    Raises FitError for less than 5 s in the air, and CrossedError where moments turn the vehicle about other axes.
    """
    flown = [flight for flight in flights if _parts(flight)]
    seconds = ROW_S * sum(part.stop - part.start for flight in flown for part in _parts(flight))
    if seconds < _SHORTEST_S:
        raise FitError(
            f"{seconds:.1f} s in the air with the speeds of all rotors (limit {_SHORTEST_S:g} s): see that the log has "
            "none that stands still, and fly for longer."
        )
    level, hover_rad_s = _level(flown)
    with_velocity = all(flight.velocity is not None for flight in flown)
    vertical = _fitted([_vertical(flight, _delay(flight, _vertical)[0]) for flight in flown])
    shown = vertical.coefficients[0] / level.n
    weights = 1 / np.square([_SLOPE_STD, math.hypot(shown.s, scale_std)])
    half_slope = float(np.average([_SLOPE, shown.n - 1], weights=weights))
    turning = partial(_turning, hover_rad_s=hover_rad_s, slope=2 * half_slope, with_velocity=with_velocity)
    delays = [_delay(flight, partial(turning, axis=0), partial(turning, axis=1)) for flight in flown]
    roll, pitch, yaw = (
        _fitted([turning(flight, delay_s, axis=axis) for flight, (delay_s, _) in zip(flown, delays, strict=True)])
        for axis in range(len(AXES))
    )
    _refuse_crossed(roll, pitch)
    late_s, stds_s = (np.array(each) for each in zip(*delays, strict=True))
    return SpeedFit(
        thrust=level,
        half_slope=ufloat(half_slope, float(1 / math.sqrt(np.sum(weights)))),
        hover_rad_s=hover_rad_s,
        vertical=vertical,
        axes=(roll, pitch, yaw),
        delay_s=ufloat(np.mean(late_s), math.sqrt((np.mean(stds_s**2) + np.var(late_s)) / len(flown))),
        with_velocity=with_velocity,
        seconds=seconds,
    )


def _parts(flight: Flight) -> list[slice]:
    """Return the segments in the air that are long enough, as whole numbers of means."""
    known = segments(flight.airborne & ~flight.beyond, (_FEWEST_MEANS + 1) * MEAN_ROWS)
    return [slice(part.start, part.stop - (part.stop - part.start) % MEAN_ROWS) for part in known]


def _level(flights: Sequence[Flight]) -> tuple[UFloat, float]:
    """Return k over mass, by the mean force that carries the vehicles, and the speed that carries it.

    Its uncertainty is that of the means and of the differences between flights.
    """
    each = []
    for flight in flights:
        columns = np.stack([flight.force[:, 2], np.sum(flight.row_speeds(0.0) ** 2, axis=1)])
        parts = [block_means(columns[:, part], length=round(_LEVEL_S / ROW_S)) for part in _parts(flight)]
        each.append(np.concatenate(parts, axis=1))
    force, square = np.concatenate(each, axis=1)
    value = float(np.sum(force) / np.sum(square))
    std = float(np.std(force / square)) / math.sqrt(max(len(force) - 1, 1))
    if len(each) > 1:
        levels = [float(np.sum(means[0]) / np.sum(means[1])) for means in each]
        std = math.hypot(std, float(np.std(levels, ddof=1)) / math.sqrt(len(levels)))
    return ufloat(value, std), math.sqrt(USUAL_GRAVITY_MPS2 / value / 4)


def _turning(
    flight: Flight, delay_s: float, *, axis: int, hover_rad_s: float, slope: float, with_velocity: bool
) -> FlightEquation:
    """Return the equation of the rate about an axis, for speeds that are later than rates by a time.

    The terms about roll and pitch are those of `_OWN` to `_AIR`, those about yaw `_TORQUE` and `_SPIN`.
    """
    speeds, rates = flight.row_speeds(delay_s), flight.rates
    thrusts = speeds * (speeds + slope * (speeds - hover_rad_s))
    moments, spin = thrusts @ flight.turning.T, speeds @ flight.turning[2]
    acting = _added(np.column_stack([np.ones(len(rates)), rates[:, axis], np.sum(thrusts, axis=1)]))
    gyroscopic = _added((rates[:, axis - 2] * rates[:, axis - 1])[:, np.newaxis])
    if axis == 2:
        terms, others = [_added(moments[:, [2]]), spin], [acting, gyroscopic]
    else:
        terms = [_added(moments[:, [axis]]), gyroscopic, _added(moments[:, [1 - axis]])]
        others = [acting, _added((rates[:, 1 - axis] * spin)[:, np.newaxis]), rates[:, 2]]
        if with_velocity and flight.velocity is not None:
            air = (flight.velocity[:, 1 - axis] * np.sum(speeds, axis=1) / (4 * hover_rad_s))[:, np.newaxis]
            terms.append(_added(air))
            others.append(air)  # the acceleration's effect: the velocity may be late
    count = sum(each.shape[1] if each.ndim > 1 else 1 for each in terms)
    states = np.column_stack([rates[:, axis], *terms, *others])
    changes = [np.diff(block_means(states[part].T, length=MEAN_ROWS).T, axis=0) / MEAN_S for part in _parts(flight)]
    return _equation(axis, changes, count)


def _vertical(flight: Flight, delay_s: float) -> FlightEquation:
    """Return the equation of the specific force, for speeds that are later than the accelerometer by a time."""
    lift = np.sum(flight.row_speeds(delay_s) ** 2, axis=1)
    columns = np.column_stack([flight.force[:, 2], lift, others_along_z(flight)])
    return _equation(None, [block_means(columns[part].T, length=MEAN_ROWS).T for part in _parts(flight)], 1)


def _equation(axis: int | None, parts: Sequence[Array], terms: int) -> FlightEquation:
    """Return the equation of columns (n, 1 + terms + others) of each segment."""
    columns = np.concatenate(parts)
    return FlightEquation(
        axis, columns[:, 0], columns[:, 1 : 1 + terms], columns[:, 1 + terms :], tuple(map(len, parts))
    )


def _added(columns: Array) -> Array:
    """Return the integrals (m, k) of columns over rows, by trapezoids and up to constants."""
    return np.asarray((np.cumsum(columns, axis=0) - columns / 2) * ROW_S)


def _fitted(blocks: Sequence[FlightEquation]) -> EquationFit:
    """Fit the same equation of all flights."""
    white = whitened_fit(blocks, past=_PAST)
    covariance = sandwich(white.rows, white.errors, longest=max(len(white.errors) // (8 * len(blocks)), 10))
    values = correlated_values(white.values, covariance)
    return EquationFit(values, tuple((block, block.terms[:, 0] * white.values[0]) for block in blocks))


def _delay(flight: Flight, *equations: Callable[[Flight, float], FlightEquation]) -> tuple[float, float]:
    """Return the delay in s with which equations leave the smallest errors, and its standard uncertainty."""

    def unlikely(delay_s: float) -> float:
        fits = [whitened_fit([equation(flight, delay_s)], past=_PAST) for equation in equations]
        return float(np.sum([len(white.errors) * math.log(white.size) for white in fits]))

    tried_s = np.linspace(-LATEST_S, LATEST_S, _TRIED)
    apart_s = float(tried_s[1] - tried_s[0])
    nearest_s = float(tried_s[np.argmin([unlikely(delay_s) for delay_s in tried_s])])
    bounds = (max(nearest_s - apart_s, -LATEST_S), min(nearest_s + apart_s, LATEST_S))
    best_s = float(minimize_scalar(unlikely, bounds=bounds, method="bounded", options={"xatol": 1e-4}).x)
    before, at, after = (unlikely(best_s + side * apart_s / 2) for side in (-1, 0, 1))
    curvature = max(before - 2 * at + after, 1e-12) / (apart_s / 2) ** 2
    return best_s, 1 / math.sqrt(curvature)


def _refuse_crossed(roll: EquationFit, pitch: EquationFit) -> None:
    """Raise CrossedError where moments turn the vehicle about the other horizontal axis as much as about their own."""
    own = min(abs(fit.coefficients[_OWN].n) for fit in (roll, pitch))
    if any(abs(fit.coefficients[_OTHER].n) > _CROSSED * own and fit.explained > _CROSSED for fit in (roll, pitch)):
        raise CrossedError(
            "rotors turn the vehicle about other axes than their own: the axes are not x forward, y left, z up, or "
            "motors have other numbers than front right, rear right, rear left, front left."
        )
