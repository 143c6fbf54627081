"""Fit thrust, lag, delays and moments together: least squares of the errors in predicting each sensor's next row.

The fit is valid if these errors are uncorrelated with the effects of the commands. No equation has a dependent variable
on the side of its regressors.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError
from cfid.estimate.linear import gain_of, std_of
from cfid.estimate.signals import block_means
from cfid.flight.crossing import crossing_of
from cfid.flight.equations import DELAYS, LAGS, THRUST, TURNS, Equations, fitted_in
from cfid.flight.likelihood import without
from cfid.flight.model import DAMPING, FlightEquation, ThrustLag, equations_of
from cfid.flight.rows import AXES, ROW_S, Flight, segments
from cfid.flight.search import first_parameters, settled, with_constant
from cfid.flight.uncertainty import covariance_of, excess_of_older_torques

Array = npt.NDArray[np.float64]

_FEWEST = 500  # rows: 5 s
_LEVEL = 100  # rows: 1 s, whose mean forces are assumed to be independent
EXPLAINED = 0.6  # of the vertical force, as `fit dynamics` requires of a thrust; the same of a rate's changes
_SMOOTH = 10  # rows over which noise is averaged before judging how much is explained
_GRID_S = ROW_S / 24  # the error of lags: in calm air they are 0.3 to 0.4 ms too long, with steps of 2 and 3.3 ms
# The error of the gyro's delay: in calm air it is 0.02 to 0.07 ms too short, the more so the less noise there is.
_GYRO_DELAY_STD_S = 4e-5
# Of the delays: the expected share of the command alone, and its standard uncertainty.
_OF_COMMAND, _OF_COMMAND_STD = 0.5, 0.5
# Of the accelerometer's delay relative to the gyro: a filter is expected to cause it, with this uncertainty.
_UNFILTERED_STD = 0.5
_TRIED = 0.5  # of such a share: the change over which its slope is taken
# Of the weight: the zero error of an accelerometer; a BMI088's data sheet states a zero-g offset of 20 mg.
_ZERO_STD = 0.02
# Of thrust's slope, on which all moments depend: in calm air they have a common error of 0.6 to 0.75 %.
_SLOPE_STD = 0.005


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
    blocks: tuple[tuple[FlightEquation, Array], ...]

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
    battery's missing sag and the findings on one flight use the same fit.

    Raises FitError for less than 5 s in which all rotors were driven, and CrossedError where torques turn the vehicle
    about other axes than their own.
    """
    return _fitted(tuple(flights))


@lru_cache(1)
def _fitted(flights: tuple[Flight, ...]) -> FlightFit:
    flown = [flight for flight in flights if segments(flight.driven)]
    rows = sum(one.stop - one.start for flight in flown for one in segments(flight.driven))
    if rows < _FEWEST:
        raise FitError(
            f"{rows / 100:.1f} s in the air with every motor within its range (limit {_FEWEST / 100:g} s): the vehicle "
            "has to fly for longer without touching anything, or lower its thrust."
        )
    equations = Equations([equations_of(flight) for flight in flown])
    begin = first_parameters(equations)
    _refuse_other_numbers(equations, begin)
    equations, result = settled(equations, begin)
    jacobian, residual = np.asarray(result.jac), np.asarray(result.fun)
    equations, step, slopes, left = _with_shares(equations, with_constant(result.x), jacobian, residual)
    found, residual = with_constant(result.x + step), left[: len(residual)]
    covariance = covariance_of(slopes, left, [one.basis for one in equations.white])[: len(step), : len(step)]
    covariance += _of_volts(flown, equations, found, slopes)[: len(step), : len(step)]
    covariance = np.apply_along_axis(with_constant, 1, np.apply_along_axis(with_constant, 0, covariance))
    excess = excess_of_older_torques(jacobian, residual, equations.white)
    found = _undamped(found, equations)
    covariance[LAGS, LAGS] += _GRID_S**2
    covariance[DELAYS.stop - 1, DELAYS.stop - 1] += _GYRO_DELAY_STD_S**2
    covariance[DELAYS, DELAYS] += np.diag(np.max([flight.ages_s for flight in flown], axis=0) ** 2 / 3)
    # Half of that time, common to both sensors.
    covariance[DELAYS, DELAYS] += max(flight.held_s for flight in flown) ** 2 / 12
    covariance[TURNS, TURNS] += np.diag((excess / math.sqrt(3)) ** 2)
    covariance[TURNS, TURNS] += _SLOPE_STD**2 * np.outer(found[TURNS], found[TURNS])
    found, covariance = _levelled(found, covariance, [one for one in equations.at(found) if one.axis is None])
    fitted = tuple((block, fitted_in(block, found)) for block in equations.at(found))
    drives = np.concatenate([flight.row_drives[flight.driven] for flight in flown])
    return FlightFit(
        values=found,
        covariance=covariance,
        in_volts=flown[0].in_volts,
        drive=float(np.mean(drives)),
        drive_range=(float(np.quantile(drives, 0.01)), float(np.quantile(drives, 0.99))),
        explained=explained_of(fitted, None),
        excitation=_excitation(fitted),
        feedback=excess / np.maximum(np.abs(found[TURNS]), 1e-300),
        rows=rows,
        blocks=fitted,
    )


def fit_alone(flight: Flight) -> FlightFit | None:
    """Return a fit to one flight alone, None if it fails. Raises CrossedError for motors in another order."""
    try:
        return fit_flights([flight])
    except CrossedError:
        raise
    except FitError:
        return None


def roughly_fitted(flights: Sequence[Flight]) -> tuple[tuple[FlightEquation, Array], ...]:
    """Return equations with the rotors' contributions at the first parameters, of coarse lags: fast, but not exact."""
    equations = Equations([equations_of(flight) for flight in flights])
    p = first_parameters(equations)
    return tuple((block, fitted_in(block, p)) for block in equations.at(p))


def _refuse_other_numbers(equations: Equations, p: Array) -> None:
    """Raise CrossedError where roll torque turns the vehicle about pitch and vice versa: no fit would converge.

    The first parameters (10,), with coarse lags, suffice to show this.
    """
    blocks = equations.at(p)
    if explained_of([(block, fitted_in(block, p)) for block in blocks], None) < EXPLAINED:
        return
    crossing = crossing_of(blocks, p)
    if crossing.a_quarter:
        raise CrossedError(f"commanded torques turn the vehicle about other axes than their own: {crossing.fault()}.")


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


def _of_volts(flown: Sequence[Flight], equations: Equations, p: Array, slopes: Array) -> Array:
    """Return the covariance (11, 11) that the voltage's uncertainty causes at parameters (10,), from slopes."""
    other = replace(equations, each=[equations_of(one.with_other_volts) for one in flown])
    change = np.pad(other.residual(p) - equations.residual(p), (0, 2))
    effect = gain_of(slopes) @ change
    return np.outer(effect, effect)


def _undamped(p: Array, equations: Equations) -> Array:
    """Return parameters whose moments are corrected for damping.

    Within a row, damping proportional to the rate cancels a part of the torque's effect in that row. The equation
    contains only the rate at the start of the row, so its gain lacks that part.
    """
    found = p.copy()
    for axis in range(len(AXES)):
        damping = [
            (len(block.shown), float(white.others_in(block.shown - fitted_in(block, p))[DAMPING]))
            for block, white in zip(equations.at(p), equations.white, strict=True)
            if block.axis == axis
        ]
        lost = -ROW_S * sum(rows * each for rows, each in damping) / sum(rows for rows, _ in damping)
        found[TURNS.start + axis] *= 1 + lost / 2
    return found


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
    found = slopes
    found[THRUST.start] = float(np.concatenate(forces).mean()) / mean[0]
    of_slopes = np.eye(len(p))
    of_slopes[THRUST.start, THRUST] = [0.0, *(-mean[1:] / mean[0])]
    spread = of_slopes @ covariance @ of_slopes.T
    means = block_means(np.concatenate(left), length=_LEVEL)
    zero_std = _ZERO_STD * float(np.concatenate([block.shown for block in vertical]).mean())
    variance = float(np.var(means)) / max(len(means) - 1, 1) + zero_std**2
    spread[THRUST.start, THRUST.start] += variance / mean[0] ** 2
    return found, spread


def explained_of(fitted: Sequence[tuple[FlightEquation, Array]], axis: int | None) -> float:
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


def _excitation(fitted: Sequence[tuple[FlightEquation, Array]]) -> dict[str, float]:
    found: dict[str, list[Array]] = {}
    for block, thrusts in fitted:
        name = "vertical" if block.axis is None else AXES[block.axis]
        found.setdefault(name, []).append(without(thrusts, np.ones((len(thrusts), 1))))
    return {name: float(np.std(np.concatenate(each))) for name, each in found.items()}
