"""Fit thrust, lag, delays and moments together: least squares of the errors in predicting each sensor's next row.

The fit is valid if these errors are uncorrelated with the effects of the commands. No equation has a dependent variable
on the side of its regressors. From coarse lags on, noise and parameters are updated alternately until both converge.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError
from cfid.estimate.linear import gain_of, sandwich, std_of
from cfid.estimate.signals import block_means
from cfid.flight.model import (
    DAMPING,
    DELAY_S,
    DELAYS,
    LAGS,
    PAST,
    THRUST,
    TURNS,
    Equations,
    FlightEquation,
    ThrustLag,
    White,
    equations_of,
    fitted_in,
    whitening,
    without,
)
from cfid.flight.rows import AXES, ROW_S, Flight, segments

Array = npt.NDArray[np.float64]
Fitted = Sequence[tuple[FlightEquation, Array]]  # equations, each with the rotors' contribution

EXPLAINED = 0.6  # of the vertical force, as `fit dynamics` requires of a thrust; the same of a rate's changes
CLIMB = "climb and drop quickly, once or twice a second, for 20 s"
_FEWEST = 500  # rows: 5 s
_LEVEL = 100  # rows: 1 s, whose mean forces are assumed to be independent
_SMOOTH = 10  # rows over which noise is averaged before judging how much is explained
_PART = 500  # rows: 5 s, after which a flight's manoeuvres are different ones
_OLDER = 2  # rows, so that the difference of errors and the instrument have no row in common

# Limits of the parameters: two time constants from 5 ms to 1 s, and two delays from -20 to 50 ms.
_LEAST = np.array([5e-3, 5e-3, -0.02, -0.02, *[-np.inf] * 6])
_MOST = np.array([1.0, 1.0, 0.05, 0.05, *[np.inf] * 6])
_STARTS_S = (0.02, 0.04, 0.07, 0.12)
# Delays of an accelerometer with a filter of 10 Hz, and the least gain in fit for them; usual accelerometers have 0.9
# to 1.1.
_LATE_S, _CLEARLY = (0.02, 0.035), 1.4
_MOST_ROUNDS = 100  # in which noise and parameters are estimated alternately
_MORE = 1.2  # times the share of a parameter's step, where it goes on as the last one: twice as much would alternate
_SETTLED = 0.05  # standard uncertainties: the largest change of a parameter in the last round

_GRID_S = ROW_S / 24  # the error of lags: in calm air they are 0.3 to 0.4 ms too long, with steps of 2 and 3.3 ms
# The error of the gyro's delay: in calm air it is 0.02 to 0.07 ms too short, the more so the less noise there is.
_GYRO_DELAY_STD_S = 4e-5
# Of thrust's slope, on which all moments depend: in calm air they have a common error of 0.6 to 0.75 %.
_SLOPE_STD = 0.005
# Of the weight: the zero error of an accelerometer; a BMI088's data sheet states a zero-g offset of 20 mg.
_ZERO_STD = 0.02
# Of the delays: the expected share of the command alone, and its standard uncertainty.
_OF_COMMAND, _OF_COMMAND_STD = 0.5, 0.5
# Of the accelerometer's delay relative to the gyro: a filter is expected to cause it, with this uncertainty.
_UNFILTERED_STD = 0.5
_TRIED = 0.5  # of such a share: the change over which its slope is taken

_CROSSED = 0.2  # of the largest gain: public logs have 0.04 at most, axes rotated by 12 degrees have 0.2
_SIGNIFICANT = 4.0  # standard uncertainties


class CrossedError(FitError):
    """Torques turn a vehicle about other axes than their own, so that nothing of its flight can be fitted."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FlightFit:
    """Time constants and delays in s, thrust over mass in powers of the drive, and lever times mass over moment.

    `values` (10,) are these in order (`LAGS`, `DELAYS` of accelerometer and gyro, `THRUST` in m/s^2, `TURNS`), and
    `covariance` (10, 10) is their covariance. `drive` is the mean in flight, in V if `in_volts`, and `drive_range`
    holds its 1 % and 99 % quantiles. `explained` is the part of the variance of the vertical force, in means over 0.1
    s, that the rotors explain. `excitation` is the root mean square of the rotors' effect by equation: m/s^2
    vertically, rad/s^2 about an axis. `feedback` (3,) is the relative change of the moments with older torques as
    instruments, beyond what noise explains; the covariance contains it. `blocks` are the equations at the solution,
    each with the rotors' contribution.
    """

    values: Array
    covariance: Array
    in_volts: bool
    drive: float
    drive_range: tuple[float, float]
    explained: float
    excitation: dict[str, float]
    feedback: Array
    rows: int
    blocks: Fitted

    @property
    def lag(self) -> ThrustLag:
        """The time constants of rising and falling drives."""
        return ThrustLag(*map(float, self.values[LAGS]))

    @property
    def thrust(self) -> Array:
        """The coefficients (3,) of one rotor's thrust over the vehicle's mass, lowest power first."""
        return self.values[THRUST]

    @property
    def std(self) -> Array:
        """The standard uncertainties (10,)."""
        return std_of(self.covariance)


def fit_flights(flights: Sequence[Flight]) -> FlightFit:
    """Fit one vehicle to its flights.

    The last fit is cached: another mass or arm changes the parameters of the same flights but not the fit, and the
    check of the battery's voltage and the findings on one flight use the same fit.

    Raises FitError for less than 5 s in which all rotors were driven, and CrossedError where torques turn the vehicle
    about other axes than their own.
    """
    return _fitted(tuple(flights))


@lru_cache(1)
def _fitted(flights: tuple[Flight, ...]) -> FlightFit:
    flown = [flight for flight in flights if segments(flight.driven)]
    rows = sum(part.stop - part.start for flight in flown for part in segments(flight.driven))
    if rows < _FEWEST:
        raise FitError(
            f"{rows / 100:.1f} s in the air with every motor within its range (limit {_FEWEST / 100:g} s): the vehicle "
            "has to fly for longer without touching anything, or lower its thrust."
        )
    equations = Equations([equations_of(flight) for flight in flown])
    begin = first_parameters(equations)
    _refuse_crossed(equations, begin)
    equations, values, jacobian, residual = settled(equations, begin)
    equations, step, slopes, left = _with_shares(equations, values, jacobian, residual)
    values, residual = values + with_constant(step), left[: len(residual)]
    covariance = covariance_of(slopes, left, [white.basis for white in equations.white])[: len(step), : len(step)]
    covariance = np.apply_along_axis(with_constant, 1, np.apply_along_axis(with_constant, 0, covariance))
    excess = excess_of_older_torques(jacobian, residual, equations.white)
    values = _undamped(values, equations)
    covariance += _known_errors(flown, values, excess)
    values, covariance = _levelled(values, covariance, [block for block in equations.at(values) if block.axis is None])
    fitted = tuple((block, fitted_in(block, values)) for block in equations.at(values))
    drives = np.concatenate([flight.row_drives[flight.driven] for flight in flown])
    return FlightFit(
        values=values,
        covariance=covariance,
        in_volts=flown[0].in_volts,
        drive=float(np.mean(drives)),
        drive_range=(float(np.quantile(drives, 0.01)), float(np.quantile(drives, 0.99))),
        explained=explained_of(fitted, None),
        excitation=_excitation(fitted),
        feedback=excess / np.maximum(np.abs(values[TURNS]), 1e-300),
        rows=rows,
        blocks=fitted,
    )


def _known_errors(flown: Sequence[Flight], p: Array, excess: Array) -> Array:
    """Return the covariance (10, 10) of errors of parameters (10,) that all rows have in common.

    They are those of the grid of rows, of readings and commands that are older than their rows, of thrust's slope, and
    the `excess` (3,) of older torques.
    """
    covariance = np.zeros((len(p), len(p)))
    covariance[LAGS, LAGS] += _GRID_S**2
    covariance[DELAYS.stop - 1, DELAYS.stop - 1] += _GYRO_DELAY_STD_S**2
    covariance[DELAYS, DELAYS] += np.diag(np.max([flight.ages_s for flight in flown], axis=0) ** 2 / 3)
    # Half of the time for which commands are held, common to both sensors.
    covariance[DELAYS, DELAYS] += max(flight.held_s for flight in flown) ** 2 / 12
    covariance[TURNS, TURNS] += np.diag((excess / math.sqrt(3)) ** 2)
    covariance[TURNS, TURNS] += _SLOPE_STD**2 * np.outer(p[TURNS], p[TURNS])
    return covariance


def fit_alone(flight: Flight) -> FlightFit | None:
    """Return a fit to one flight alone, None if it fails. Raises CrossedError for motors in another order."""
    try:
        return fit_flights([flight])
    except CrossedError:
        raise
    except FitError:
        return None


@lru_cache(1)
def roughly_fitted(*flights: Flight) -> Fitted:
    """Return equations with the rotors' contributions at the first parameters, of coarse lags: fast, but not exact."""
    equations = Equations([equations_of(flight) for flight in flights])
    p = first_parameters(equations)
    return tuple((block, fitted_in(block, p)) for block in equations.at(p))


def refuse_still(flights: Sequence[Flight]) -> None:
    """Raise FitError where in no flight rotors explain half of the part required of a thrust, at coarse lags.

    A fit to such flights takes many rounds or never converges, and all its results depend on the thrust.
    """
    least = EXPLAINED / 2  # half, because lags are tried by factors of two
    flown = [flight for flight in flights if segments(flight.driven)]
    most = max((explained_of(roughly_fitted(flight), None) for flight in flown), default=least)
    if most < least:
        raise FitError(
            f"thrust is not excited: rotors explain {100 * most:.0f} % of the vertical force (at least "
            f"{100 * EXPLAINED:.0f} %), whatever their lag: {CLIMB}. Moments need the thrust."
        )


def explained_of(fitted: Fitted, axis: int | None) -> float:
    """Return the part of the variance of means over 0.1 s that rotors explain: of the vertical force, or of a rate.

    For a rate, the variance is that which the other terms leave unexplained: about yaw, the torque that accelerates the
    rotors may turn a vehicle as much.
    """

    def rest(block: FlightEquation, values: Array) -> Array:
        return block_means(values if axis is None else without(values, block.others), length=_SMOOTH)

    of_axis = [(block, thrusts) for block, thrusts in fitted if block.axis == axis]
    left = np.concatenate([rest(block, block.shown - thrusts) for block, thrusts in of_axis])
    whole = np.concatenate([rest(block, block.shown) for block, _ in of_axis])
    return float(1 - np.var(left) / max(float(np.var(whole)), 1e-300))


def _refuse_crossed(equations: Equations, p: Array) -> None:
    """Raise CrossedError where torques turn the vehicle about other axes than their own, by the gains of coarse lags.

    Torques about yaw turn it about another axis, or those about roll and pitch about each other.
    """
    fitted = [(block, fitted_in(block, p)) for block in equations.at(p)]
    if explained_of(fitted, None) < EXPLAINED / 2:
        return
    gains, stds = _crossing_of(fitted, p)
    roll, pitch, yaw = range(len(AXES))
    largest = float(np.max(np.abs(gains[:yaw, :yaw])))
    foreign = (np.abs(gains) > _CROSSED * largest) & (np.abs(gains) > _SIGNIFICANT * stds)
    if foreign[:yaw, yaw].any() or (foreign[roll, pitch] and foreign[pitch, roll]):
        raise CrossedError(
            "commanded torques turn the vehicle about other axes than their own: the axes are not x forward, y left, "
            "z up, or motors have other numbers than front right, rear right, rear left, front left."
        )


def _crossing_of(fitted: Fitted, p: Array) -> tuple[Array, Array]:
    """Return the gains (3, 3) from torques about roll, pitch and yaw (columns) to rates (rows), and their std.

    They are in the units of `FlightFit.values[TURNS]`, with the lags and delays of parameters (10,).
    """
    gains, stds = np.zeros((len(AXES), len(AXES))), np.full((len(AXES), len(AXES)), np.inf)
    turning = [[block for block, _ in fitted if block.axis == axis] for axis in range(len(AXES))]
    torques = [[block.terms @ p[THRUST] for block in of_axis] for of_axis in turning]
    for axis, of_axis in enumerate(turning):
        rows, shown = [], []
        for place, block in enumerate(of_axis):
            left = without(block.shown - p[TURNS][axis] * torques[axis][place], block.others)
            white = whitening(block, left, fed_back=True)
            rows.append(white.of(np.column_stack([each[place] for each in torques])))
            shown.append(white.of(block.shown[:, np.newaxis])[:, 0])
        of_all, data = np.concatenate(rows), np.concatenate(shown)
        gains[axis] = gain_of(of_all) @ data
        longest = max(len(data) // (8 * len(of_axis)), 10)
        stds[axis] = std_of(sandwich(of_all, data - of_all @ gains[axis], longest=longest))
    return gains, stds


def first_parameters(equations: Equations) -> Array:
    """Return the best parameters (10,) of a coarse grid of lags, with the same lag for rising and falling drives.

    A much larger delay of the accelerometer than usual is chosen only if it clearly leaves less of the force
    unexplained: otherwise, lag and delay have nearly the same effect.
    """
    least, nearest = np.inf, np.zeros(TURNS.stop)
    for tau_s, of_force_s in itertools.product(_STARTS_S, (DELAY_S, *_LATE_S)):
        p = _start(tau_s, of_force_s, DELAY_S)
        blocks = equations.at(p)
        vertical = [block for block in blocks if block.axis is None]
        rows, shown = (np.concatenate(each) for each in zip(*((b.terms, b.shown) for b in vertical), strict=True))
        p[THRUST] = gain_of(rows) @ shown
        cost = float(np.sum((shown - rows @ p[THRUST]) ** 2)) * (1.0 if of_force_s == DELAY_S else _CLEARLY)
        for axis in range(len(AXES)):
            turning = [block for block in blocks if block.axis == axis]
            torque = np.concatenate([without(block.terms @ p[THRUST], block.others) for block in turning])
            spun = np.concatenate([without(block.shown, block.others) for block in turning])
            p[TURNS.start + axis] = float(torque @ spun) / max(float(torque @ torque), 1e-300)
        if cost < least:
            least, nearest = cost, p
    return nearest


def settled(equations: Equations, p: Array) -> tuple[Equations, Array, Array, Array]:
    """Return the equations whitened by the noise that they leave, and their solution: each is found from the other.

    The solution is parameters (10,), and slopes (n, 9) and residuals (n,) of the whitened errors. Each round is a step
    by Gauss and Newton. Away from the solution, past errors contain the effects of the rotors and absorb most of a
    parameter's change, so that a step goes too far: full steps can alternate forever between two states on either side
    of the solution. Where a parameter's step reverses its last one, half of the share is taken, else more. Raises
    FitError where the parameters do not converge although rotors explain the vertical force.
    """
    last, share = np.zeros(TURNS.stop - 1), np.ones(TURNS.stop - 1)
    for _ in range(_MOST_ROUNDS):
        equations = equations.whitened(p)
        slopes, residual = _without_constant(equations.jacobian(p)), equations.residual(p)
        gain = gain_of(slopes)
        step = np.clip(p + with_constant(-gain @ residual), _LEAST, _MOST) - p
        moved = _without_constant(step) / np.maximum(np.linalg.norm(gain, axis=1), 1e-300)
        if np.all(np.abs(moved) <= _SETTLED):
            return equations, p, slopes, residual
        share = np.where(moved * last < 0, share / 2, np.minimum(_MORE * share, 1.0))
        p, last = p + with_constant(share) * step, moved
    if explained_of([(block, fitted_in(block, p)) for block in equations.at(p)], None) < EXPLAINED:
        return equations, p, slopes, residual  # a finding rejects thrust and moments then; drag does not rest on them
    raise FitError(
        f"noise and parameters, found in turn, do not come to rest in {_MOST_ROUNDS} rounds: the flight's noise "
        "changes, or it does not tell lag, delays and moments apart. Fit a part of it (`from_s`, `to_s`), or fly "
        "quicker manoeuvres."
    )


def _with_shares(
    equations: Equations, p: Array, jacobian: Array, residual: Array
) -> tuple[Equations, Array, Array, Array]:
    """Estimate two shares of the delays from the flight, with prior values.

    The first is the share that applies to the command alone, not to the voltage: a battery's voltage drops when rotors
    draw current, not when they are commanded to. The second is the share of an unknown accelerometer's delay relative
    to the gyro that is not due to a filter. Both effects are a few per cent, so one step from parameters (10,), whose
    errors are `residual` (n,) with slopes `jacobian` (n, 9), finds them. Returns the equations with the shares, the
    step (9,), and slopes (n + 2, 11) and errors (n + 2,) that include those of the shares. The last two rows are the
    prior values, whose error is one standard uncertainty.
    """
    later = replace(equations, of_command=1.0).residual(p) - residual
    sharper = (replace(equations, unfiltered=_TRIED).residual(p) - residual) / _TRIED
    count = jacobian.shape[1]
    expected, stds = np.array([_OF_COMMAND, 0.0]), np.array([_OF_COMMAND_STD, _UNFILTERED_STD])
    rows = np.vstack([np.column_stack([jacobian, later, sharper]), np.eye(2, count + 2, count) / stds[:, np.newaxis]])
    errors = np.concatenate([residual, -expected / stds])
    step = -gain_of(rows) @ errors
    left = errors + rows @ step
    left[-2:] = 1.0
    of_command, unfiltered = map(float, step[count:])
    return replace(equations, of_command=of_command, unfiltered=unfiltered), step[:count], rows, left


def excess_of_older_torques(jacobian: Array, residual: Array, white: Sequence[White]) -> Array:
    """Return the change of the last three parameters with torques of two rows before as instruments, less noise.

    The two estimates differ if an autopilot responds to the gyro's noise within a row, or if rotors are not a
    first-order lag. Two standard uncertainties of the difference are subtracted, so that noise alone changes nothing.
    """
    turns = jacobian[:, -len(AXES) :]
    older = np.zeros_like(turns)
    begin = 0
    for equation in white:
        for length in equation.lengths:
            end = begin + length - PAST
            older[begin + _OLDER : end] = turns[begin : end - _OLDER]
            begin = end
    excess = np.zeros(len(AXES))
    for axis, (now, before) in enumerate(zip(turns.T, older.T, strict=True)):
        if abs(float(before @ now)) > 0:
            influence = (before / float(before @ now) - now / float(now @ now)) * residual
            excess[axis] = max(abs(float(np.sum(influence))) - 2 * math.sqrt(float(influence @ influence)), 0.0)
    return excess


def covariance_of(jacobian: Array, residual: Array, taken: Sequence[Array]) -> Array:
    """Return the covariance (p, p) of a fit to blocks of rows, from each of which other terms (k, q) were removed.

    An imperfect model has a different error in each manoeuvre: where parts of 5 s scatter by more than noise explains,
    the covariance is increased.
    """
    lengths = [len(columns) for columns in taken]
    freedom = 1 - sum(columns.shape[1] for columns in taken) / len(residual)
    covariance = sandwich(jacobian, residual, longest=max(len(residual) // (8 * len(lengths)), 10)) / freedom
    influence = gain_of(jacobian).T * residual[:, np.newaxis]
    begins = [range(0, length - _PART // 2, _PART) for length in lengths]
    starts = np.repeat(np.cumsum([0, *lengths[:-1]]), list(map(len, begins)))
    sums = np.add.reduceat(influence, starts + np.concatenate(begins).astype(int), axis=0)
    scatter = np.sum(sums**2, axis=0)
    wider = np.sqrt(np.maximum(scatter / np.maximum(np.diag(covariance), 1e-300), 1.0))
    return np.asarray(covariance * np.outer(wider, wider))


def _undamped(p: Array, equations: Equations) -> Array:
    """Return parameters whose moments are corrected for damping.

    Within a row, damping proportional to the rate cancels a part of the torque's effect in that row. The equation
    contains only the rate at the start of the row, so its gain lacks that part.
    """
    corrected = p.copy()
    for axis in range(len(AXES)):
        damping = [
            (len(block.shown), float(white.others_in(block.shown - fitted_in(block, p))[DAMPING]))
            for block, white in zip(equations.at(p), equations.white, strict=True)
            if block.axis == axis
        ]
        lost = -ROW_S * sum(rows * each for rows, each in damping) / sum(rows for rows, _ in damping)
        corrected[TURNS.start + axis] *= 1 + lost / 2
    return corrected


def _levelled(p: Array, covariance: Array, vertical: Sequence[FlightEquation]) -> tuple[Array, Array]:
    """Return parameters and covariance with the thrust's constant, which the mean force gives: the fit lacks it."""
    slopes = p.copy()
    slopes[THRUST.start] = 0.0
    terms, forces, left = [], [], []
    for block in vertical:
        force = block.shown - fitted_in(block, slopes)
        others = gain_of(block.others) @ force
        terms.append(block.terms)
        forces.append(force - others[0] * block.others[:, 0])  # without the climb
        left.append(force - block.others @ others)
    mean = np.concatenate(terms).mean(axis=0)
    levelled = slopes
    levelled[THRUST.start] = float(np.concatenate(forces).mean()) / mean[0]
    of_slopes = np.eye(len(p))
    of_slopes[THRUST.start, THRUST] = [0.0, *(-mean[1:] / mean[0])]
    spread = of_slopes @ covariance @ of_slopes.T
    means = block_means(np.concatenate(left), length=_LEVEL)
    zero_std = _ZERO_STD * float(np.concatenate([block.shown for block in vertical]).mean())
    variance = float(np.var(means)) / max(len(means) - 1, 1) + zero_std**2
    spread[THRUST.start, THRUST.start] += variance / mean[0] ** 2
    return levelled, spread


def _excitation(fitted: Fitted) -> dict[str, float]:
    effects: dict[str, list[Array]] = {}
    for block, thrusts in fitted:
        name = "vertical" if block.axis is None else AXES[block.axis]
        effects.setdefault(name, []).append(without(thrusts, np.ones((len(thrusts), 1))))
    return {name: float(np.std(np.concatenate(each))) for name, each in effects.items()}


def _start(tau_s: float, of_force_s: float, of_rates_s: float) -> Array:
    """Return parameters (10,) with this lag for rising and falling drives, these delays, and no thrust."""
    return np.concatenate([[tau_s, tau_s, of_force_s, of_rates_s], np.zeros(6)])


def with_constant(free: npt.ArrayLike) -> Array:
    """Return parameters (10,) with a zero constant of thrust: the mean force alone gives it, after the others."""
    return np.insert(np.asarray(free, dtype=np.float64), THRUST.start, 0.0)


def _without_constant(columns: Array) -> Array:
    """Return parameters (10,), or slopes over them (n, 10), without the thrust's constant."""
    return np.delete(columns, THRUST.start, axis=-1)
