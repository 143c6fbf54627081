"""Model a quadrocopter in flight by equations, linear in the unknowns, from its rotors to what its sensors show.

Axes are the vehicle's: x forward, y left, z up. Each rotor's drive is the command relative to full command, times the
battery's voltage where this is known; w follows it with a lag. The thrust of one rotor is c0 + c1 w + c2 w^2, along z.
The equations are

    f_z = sum(T_i) / m + effects of the climb and the battery                specific force, by the accelerometer
    d(rate_x)/dt = (l / J_x) sum(+-T_i) + what else turns the vehicle        the same about y, and about z with q for l

where l is the lever of a rotor about x and y, its arm over the root of two, and q is its torque over its thrust. Each
sensor shows this with a delay of its own from air, electronics and the vehicle's filter, whose shape is known on a
Crazyflie. On other vehicles, the accelerometer's delay relative to the gyro is ascribed to a second-order filter.

What a rotor's command does not explain, such as wind, vibration and the sensors' noise, is autocorrelated and, through
the autopilot, correlated with later commands. An autoregression in each equation removes the part that its past
predicts; what remains is independent of everything before, and so of the effects of the commands (L. Ljung, System
Identification, 2nd ed., 1999, sections 7.3 and 13.4: the direct method in a closed loop).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.signal import butter, lfilter

from cfid.estimate.held_lag import follow_held
from cfid.estimate.linear import gain_of
from cfid.flight.rows import AXES, ROW_S, ROW_STEPS, STEP_S, Flight, delayed, segments, with_ends

Array = npt.NDArray[np.float64]

# The climb is integrated from the force over this time; the terms of the battery absorb slower changes.
CLIMB_S = 5.0
DAMPING = 1  # the column of the rate among the other terms of an equation about an axis
SAG_S = 5.0  # half the shortest period in which the battery's charge changes the thrust
# The delay of a filter of 240 Hz: steps of 2 ms show none above 250 Hz.
_LEAST_FILTERED_S = 1e-4
_KEPT = 4  # the number of cached equations: those of a solution's lags and delays, and of slopes around it
_ROUNDS = 3  # in which noise and coefficients are estimated alternately
PAST = 16  # rows that predict the next: 0.16 s
DELAY_S = 0.008  # the initial value
LAGS, DELAYS, THRUST, TURNS = slice(0, 2), slice(2, 4), slice(4, 7), slice(7, 10)  # of the parameters
_STEP = 1e-3  # the relative change of a time constant or delay over which a slope is taken


class ThrustLag(NamedTuple):
    """dw/dt = (u - w) / tau of a rotor's drive u, tau being `rising_s` where u > w and `falling_s` elsewhere."""

    rising_s: float
    falling_s: float

    def follow(self, drive: Array) -> Array:
        """Return w (n, 4) at the start of each step for drives (n, 4), each held for a step; it starts settled."""
        rising, falling = (math.exp(-STEP_S / tau_s) for tau_s in self)
        return follow_held(drive.T, rising, falling).T


class FlightEquation(NamedTuple):
    """An equation of one flight at rows (k,): `shown` is a sum of `terms`, by the powers of thrust, and `others`.

    `terms` (k, 3) belong to c0, c1, c2; `others` (k, q) are other effects, each with its own coefficient. `lengths` are
    those of the segments without a gap. The equation of the vertical force has a constant among `others`.
    """

    axis: int | None
    shown: Array
    terms: Array
    others: Array
    lengths: tuple[int, ...]


EquationsOf = Callable[..., list[FlightEquation]]


def equations_of(flight: Flight) -> EquationsOf:
    """Return a function that gives the equations of the vertical force and of the rates for rotors with a given lag.

    Its arguments are the lag, the delays of the accelerometer and the gyro, filters included, the share `of_command` of
    the rest of these delays that applies to the command alone, not to the voltage, and `unfiltered`. An accelerometer
    whose filter is unknown gets one that explains its delay relative to the gyro, except for the share `unfiltered` of
    that delay. The last few equations are cached: for a slope over the gyro's delay, those of the accelerometer stay
    the same.
    """
    along_z = others_along_z(flight)

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
    """Return the powers (3, n, 4) of lagging drives as a sensor shows them; its filter is a part of the delay."""
    if low_pass_hz is None:
        return _powers(delayed(late, delay_s))
    powers = _powers(delayed(late, delay_s - filtering_s(low_pass_hz)))
    settled = powers[1:, :1]
    b, a = _low_pass(low_pass_hz)
    powers[1:] = settled + lfilter(b, a, powers[1:] - settled, axis=1)
    return powers


@lru_cache(_KEPT)
def _low_pass(low_pass_hz: float) -> tuple[Array, Array]:
    """Return the coefficients b (3,) and a (3,) of a sensor's filter at the sample rate of drives."""
    b, a = butter(2, low_pass_hz, fs=1 / STEP_S)
    return b, a


def filtering_s(low_pass_hz: float | None) -> float:
    """Return the time by which a sensor's filter delays slow motion, 0 where it is unknown."""
    return 0.0 if low_pass_hz is None else STEP_S / math.sqrt(2) / math.tan(math.pi * low_pass_hz * STEP_S)


def _low_pass_hz(delay_s: float) -> float | None:
    """Return the cut-off of the filter that delays slow motion by this time, None below the least delay of a filter."""
    return math.atan(STEP_S / math.sqrt(2) / delay_s) / (math.pi * STEP_S) if delay_s > _LEAST_FILTERED_S else None


def _powers(late: Array) -> Array:
    return np.stack([np.ones_like(late), late, late**2])  # (3, n, 4)


def _vertical(flight: Flight, powers: Array, others: Array) -> FlightEquation:
    terms = _rows(flight, _over_rotors(powers).T)
    return _cut(None, flight.force[:, 2], terms, others, segments(flight.driven))


def _over_rotors(each: Array) -> Array:
    """Return the sums over the rotors, the last axis: NumPy's own sum over so few elements is slow."""
    return np.asarray(each[..., 0] + each[..., 1] + each[..., 2] + each[..., 3])


def others_along_z(flight: Flight) -> Array:
    """Return the effects other than the rotors' that may act vertically (m, q)."""
    climb = _climbing(flight) if flight.velocity is None else flight.velocity[:, 2:]
    count = len(flight.rates)
    phase = np.pi * np.arange(count) / count
    sag = [np.cos(times * phase) for times in range(1 + max(round(count * ROW_S / SAG_S), 1))]
    return np.column_stack([climb, _off_centre(flight.rates), *sag])


def _off_centre(rates: Array) -> Array:
    """Return the forces along z (m, 5) from rotation at rates (m, 3), for an accelerometer 1 m forward, left and up.

    The last two are the changes of the first two if gyro and accelerometer show them at different times.
    """
    x, y, z = rates.T
    quicker = np.gradient(rates, ROW_S, axis=0)
    added = np.column_stack([z * x - quicker[:, 1], z * y + quicker[:, 0], -(x**2) - y**2])
    return np.column_stack([added, np.gradient(added[:, :2], ROW_S, axis=0)])


def _climbing(flight: Flight) -> Array:
    """Return two parts (m, 2) of the climb along the vehicle's z, each with zero mean and up to a factor.

    One is the integral of the vertical force. The other is sideways velocity that rotation makes vertical, estimated
    from the sideways force, which is the drag of that velocity. Without it, thrust's slope scatters by a quarter more.
    """
    force = (flight.force - np.mean(flight.force[flight.driven], axis=0)) * flight.airborne[:, np.newaxis]
    turned = flight.rates[:, 0] * force[:, 1] - flight.rates[:, 1] * force[:, 0]
    faded = lfilter([ROW_S / 2, ROW_S / 2], [1.0, -math.exp(-ROW_S / CLIMB_S)], [force[:, 2], turned]).T
    return np.asarray(faded - np.mean(faded[flight.driven], axis=0))


def turning_equation(flight: Flight, powers: Array, axis: int) -> FlightEquation:
    """Return the equation of the rate about an axis, from powers (3, n, 4) of lagging drives as the gyro shows them."""
    turning = (powers @ flight.turning[axis]).T  # (n, 3)
    # Integrated by trapezoids, up to a constant.
    gone = _rows(flight, (np.cumsum(turning, axis=0) - turning / 2) * STEP_S)
    total = _rows(flight, _over_rotors(powers[1])[:, np.newaxis])[:, 0]
    rates = flight.rates[:-1]  # without the last rate, which contains the error that is to be predicted
    others = [
        np.ones(len(rates)),
        rates[:, axis],
        rates[:, axis - 2] * rates[:, axis - 1],
        (total[1:] + total[:-1]) / 2,
    ]
    if axis == 2:  # the torque that accelerates a rotor turns the vehicle the other way
        others.append(np.diff(_rows(flight, turning[:, 1:2])[:, 0]) / ROW_S)
    known = flight.rates_known if segments(flight.rates_known) else flight.driven  # else a finding rejects the moments
    both = known[1:] & known[:-1]
    shown = np.diff(flight.rates[:, axis]) / ROW_S
    return _cut(axis, shown, np.diff(gone, axis=0) / ROW_S, np.column_stack(others), segments(both))


def _rows(flight: Flight, steps: Array) -> Array:
    """Return what sensors would show (m, k) of values (n, k) of each step: means over rows, or values at rows."""
    if flight.averaged:
        half = ROW_STEPS // 2
        # A step's mean differs from its middle value by the curvature: without it, thrust at 20 Hz is 0.3 % too large.
        around = with_ends(steps, 1, 1)
        means = steps + (around[2:] - 2 * steps + around[:-2]) / 24
        padded = with_ends(means, half, half)
        of_rows = [padded[step : step + len(steps) : ROW_STEPS] for step in range(ROW_STEPS)]
        return np.asarray(sum(of_rows) / ROW_STEPS)[: len(flight.rates)]
    return np.asarray(steps[::ROW_STEPS][: len(flight.rates)])


def _cut(axis: int | None, shown: Array, terms: Array, others: Array, parts: Sequence[slice]) -> FlightEquation:
    at = np.concatenate([np.arange(part.start, part.stop) for part in parts]) if parts else np.zeros(0, int)
    return FlightEquation(axis, shown[at], terms[at], others[at], tuple(part.stop - part.start for part in parts))


@dataclass(frozen=True, eq=False)
class White:
    """A filter that removes an equation's other terms and its errors' predictable part, and scales to unit variance."""

    filter: Array
    lengths: tuple[int, ...]
    basis: Array  # (k, q), an orthonormal basis of the whitened other terms
    shares: Array  # (q, k), maps whitened errors to the coefficients of the other terms
    size: float

    def of(self, columns: Array) -> Array:
        """Return columns (n, p) whitened, without each segment's first rows and without what other terms explain."""
        white = _filtered(columns, self.filter, self.lengths)
        return np.asarray((white - self.basis @ (self.basis.T @ white)) / self.size)

    def others_in(self, errors: Array) -> Array:
        """Return the coefficients (q,) of the equation's other terms in its errors (n,)."""
        return np.asarray(self.shares @ _filtered(errors[:, np.newaxis], self.filter, self.lengths)[:, 0])


def whitening(block: FlightEquation, left: Array, *, fed_back: bool = False, rows: int = PAST) -> White:
    """Return the filter that whitens an equation whose errors (n,) are `left`, from this many `rows` before each.

    Where an autopilot responds to errors (`fed_back`), past errors count as other terms: the effects of the commands
    and the autocorrelation of the errors are then found together, and the uncertainty of each contains that of the
    other.
    """
    parts = _parts(left, block.lengths)
    past = np.concatenate(
        [np.column_stack([part[rows - k - 1 : len(part) - k - 1] for k in range(rows)]) for part in parts]
    )
    now = np.concatenate([part[rows:] for part in parts])
    coefficients = np.concatenate([[1.0], -(gain_of(past) @ now)])
    others = _filtered(block.others, coefficients, block.lengths)
    taken = np.column_stack([others, past]) if fed_back else others
    basis = np.linalg.qr(taken / np.maximum(np.linalg.norm(taken, axis=0), 1e-300))[0]
    white = _filtered(left[:, np.newaxis], coefficients, block.lengths)[:, 0]
    return White(coefficients, block.lengths, basis, gain_of(others), max(float(np.std(white)), 1e-12))


class WhitenedFit(NamedTuple):
    """The least-squares solution (p,) of equations, with its whitened rows (n, p), their errors (n,) and their size."""

    values: Array
    rows: Array
    errors: Array
    size: float


def whitened_fit(blocks: Sequence[FlightEquation], *, past: int) -> WhitenedFit:
    """Fit the coefficients of the terms of equations, alternately with the noise that `past` rows before each predict.

    The size of the errors is the geometric mean of those of the equations, before they are scaled.
    """
    values = np.zeros(blocks[0].terms.shape[1])
    for _ in range(_ROUNDS):
        white = [
            whitening(block, without(block.shown - block.terms @ values, block.others), rows=past) for block in blocks
        ]
        rows = np.concatenate([one.of(block.terms) for one, block in zip(white, blocks, strict=True)])
        shown = np.concatenate(
            [one.of(block.shown[:, np.newaxis])[:, 0] for one, block in zip(white, blocks, strict=True)]
        )
        values = gain_of(rows) @ shown
    return WhitenedFit(values, rows, shown - rows @ values, float(np.exp(np.mean(np.log([one.size for one in white])))))


def without(values: Array, others: Array) -> Array:
    """Return values (n,) without what other terms (n, q) explain."""
    return np.asarray(values - others @ (gain_of(others) @ values))


def _filtered(columns: Array, coefficients: Array, lengths: Sequence[int]) -> Array:
    rows = len(coefficients) - 1
    return np.concatenate([lfilter(coefficients, [1.0], part, axis=0)[rows:] for part in _parts(columns, lengths)])


def _parts(columns: Array, lengths: Sequence[int]) -> list[Array]:
    return np.split(columns, np.cumsum(lengths)[:-1])


@dataclass(frozen=True, eq=False)
class Equations:
    """The equations of flights, whose residuals are whitened.

    Parameters (10,) are two time constants and two delays in s (of accelerometer and gyro), thrust over mass in powers
    of the drive, and lever times mass over moment about each axis: `LAGS`, `DELAYS`, `THRUST` and `TURNS`.
    """

    each: Sequence[EquationsOf]
    white: tuple[White, ...] = ()
    of_command: float = 0.0  # the share of the delays that applies to the command alone, not to the battery's voltage
    # The share of an unknown accelerometer's delay relative to the gyro that is not due to a filter.
    unfiltered: float = 0.0

    def whitened(self, p: Array) -> "Equations":
        """Return the equations with the filters that whiten the errors of parameters (10,)."""
        blocks = self.at(p)
        left = [without(block.shown - fitted_in(block, p), block.others) for block in blocks]
        white = [whitening(*each, fed_back=True) for each in zip(blocks, left, strict=True)]
        return replace(self, white=tuple(white))

    def at(self, p: Array) -> list[FlightEquation]:
        """Return the equations at the time constants and delays of parameters (10,)."""
        rising_s, falling_s, of_force_s, of_rates_s = map(float, p[: DELAYS.stop])
        lag, delays_s = ThrustLag(rising_s, falling_s), (of_force_s, of_rates_s)
        return [block for flight in self.each for block in flight(lag, delays_s, self.of_command, self.unfiltered)]

    def residual(self, p: Array) -> Array:
        """Return the whitened errors (n,) of parameters (10,)."""
        errors = [(block.shown - fitted_in(block, p))[:, np.newaxis] for block in self.at(p)]
        return np.concatenate([white.of(error)[:, 0] for white, error in zip(self.white, errors, strict=True)])

    def jacobian(self, p: Array) -> Array:
        """Return the slopes (n, 10) of the whitened errors over the parameters."""
        blocks, columns = self.at(p), []
        for place in range(DELAYS.stop):
            ahead = p.copy()
            step = _STEP * max(abs(float(p[place])), DELAY_S)
            ahead[place] += step
            moved = zip(self.at(ahead), blocks, strict=True)
            columns.append([-(fitted_in(later, p) - fitted_in(block, p)) / step for later, block in moved])
        each = []
        for place, (block, white) in enumerate(zip(blocks, self.white, strict=True)):
            gains, turned = np.ones(3), np.zeros((len(block.shown), len(AXES)))
            if block.axis is not None:
                gains = np.full(3, p[TURNS][block.axis])
                turned[:, block.axis] = -(block.terms @ p[THRUST])
            slow = [column[place] for column in columns]
            each.append(white.of(np.column_stack([*slow, -block.terms * gains, turned])))
        return np.concatenate(each)


def fitted_in(block: FlightEquation, p: Array) -> Array:
    """Return the rotors' contribution (k,) to an equation."""
    gain = 1.0 if block.axis is None else float(p[TURNS][block.axis])
    return np.asarray(gain * (block.terms @ p[THRUST]))
