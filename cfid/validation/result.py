"""Compare how well parameter sets predict a flight: errors by quantity and horizon, differences paired by segment."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import stdtrit

from cfid.console.tables import columned
from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, note, warning
from cfid.flight.data import FlownLog
from cfid.flight.estimation import EXPLAINED, FlightFit, fit_alone
from cfid.flight.findings import (
    CALM,
    CLEAR,
    LEAST_TURN_RAD_PER_S2,
    LOOSE,
    climbing,
    contradictions,
    turnings,
)
from cfid.flight.model import DELAYS
from cfid.flight.rows import AXES, ROW_S, Flight
from cfid.flight.speeds import fit_speeds
from cfid.flight.values import RESCALED_STD
from cfid.recordings.read import description
from cfid.records.result import Figures, Result
from cfid.units import USUAL_GRAVITY_MPS2
from cfid.validation.predictions import (
    HORIZONS,
    QUANTITIES,
    UNITS,
    ParameterSet,
    Rows,
    best_delay,
    errors,
    next_rate_errors,
    speeds_of,
    starts,
    thrust_errors,
    unchanged,
)
from cfid.validation.sets import Measured

Array = npt.NDArray[np.float64]

NEXT, VERTICAL = "next rates", "vertical velocity"  # these judge moments and lags, and thrust
_TELLING_ROWS = 10  # 0.1 s: later, rates accumulate effects that no set contains
FEWEST = 8  # segments: fewer give no interval


@dataclass(frozen=True, kw_only=True)
class SetError:
    """The mean error of one set, and its difference from the first set's, with half the width of its 95 % interval.

    If `tells` is false, the quantity does not show how the sets differ, because air favours wrong ones, and the half
    width has no meaning.
    """

    quantity: str
    horizon_s: float
    name: str
    error: float
    more: float
    half_width: float
    tells: bool = True

    @property
    def row(self) -> dict[str, object]:
        """The entry of a table: with an interval only where the flight shows how the sets differ."""
        return {name: value for name, value in vars(self).items() if self.tells or name != "half_width"}


def validate(flown: FlownLog, sets: Sequence[ParameterSet], *, used: Sequence[Measured]) -> Result:
    """Compare what sets predict of a flight with its recording. `used` are the measured parameters among them.

    A fit to the flight alone shows what it can judge: moments, lags and thrust where rotors moved it. Where its
    autopilot only responded to air, commands counteract the air's torques: moments that are too large, and lags that
    are too long, predict such a flight better than the true ones.

    Raises ConfigError for no set or two with one name, DataError for a log that a set was fitted to or one with less
    than 8 s in which all rotors were driven, and CrossedError for one whose motors are in another order.
    """
    _check(flown, sets, used)
    at = starts(flown.by_command)
    if len(at) < FEWEST:
        raise DataError(
            f"{flown.log.path}: {counted(len(at), 'segment')} of 1 s in the air with every motor and the gyro within "
            f"their ranges (at least {FEWEST}): fly for longer, and turn slower where the gyro reaches its range."
        )
    fit = fit_alone(flown.flight) if flown.flight.speeds is None else None
    axes, lifts = _shown(flown.flight, fit)
    judged = [axis for axis in axes if axis != "yaw" or all(each.torque_m for each in sets)]
    if judged:
        sets = _with_delays(flown, sets, judged)
    else:
        sets = [replace(each, delay_s=float(fit.values[DELAYS][-1]) if fit and lifts else 0.0) for each in sets]
    segment_errors = {each.name: _errors(flown, each, at, axes, lifts=lifts) for each in sets}
    captured = flown.flight.velocity is not None and bool(axes)
    table = [replace(row, tells=row.quantity == "velocity" and not captured) for row in compared(segment_errors)]
    if captured:  # motion capture's velocities depend on predicted attitudes
        vertical = {each.name: errors(_without_capture(_flight(flown, each)), each, at)["velocity"] for each in sets}
        table += _paired(VERTICAL, HORIZONS, vertical)
    if judged:
        next_rates = {
            each.name: next_rate_errors(_flight(flown, each), each, judged, parts=len(at))[:, np.newaxis]
            for each in sets
        }
        table = [*_paired(NEXT, (1,), next_rates), *table]

    def drawings() -> Figures:
        from cfid.validation.figures import validation_figure

        title = f"{flown.flight.name}: {counted(len(at), 'segment')} of 1 s"
        return {f"validate_{flown.flight.name}": validation_figure(segment_errors, title=title)}

    return Result(
        command="validate",
        prints_lines=True,
        method="default",
        quantities={},
        findings=(
            *flown.findings,
            *contradictions(flown, fit, [each.arm_m for each in sets]),
            *(finding.at(flown.flight.name) for finding in _not_excited(fit, axes, lifts=lifts)),
            *_unpredicted(table, flown, at),
        ),
        merits={
            "segments": len(at),
            "sets": {each.name: each.origin for each in sets},
            "errors": [row.row for row in table],
        },
        sources=(flown.log.source,),
        lines=(
            description(flown.log),
            f"mean errors over {counted(len(at), 'segment')} of 1 s; in brackets how much more than {sets[0].name}:",
            *_table(table, sets, flown, at),
            _what_judges(judged),
            _assumed(sets, lifts=lifts, captured=captured, judged=judged),
        ),
        drawings=drawings,
    )


def _check(flown: FlownLog, sets: Sequence[ParameterSet], used: Sequence[Measured]) -> None:
    names = [each.name for each in sets]
    if not names:
        raise ConfigError("no parameter set: work in a campaign that has one, or name one by `with`.")
    if len(set(names)) < len(names):
        raise ConfigError(f"two parameter sets are called {max(names, key=names.count)}: name each once.")
    by_command = [each.name for each in sets if each.thrust_speed_n is None]
    if by_command and not len(flown.flight.command):
        raise ConfigError(f"{flown.log.path}: it has no commands, and no thrust over speed is in {by_command[0]}.")
    for measured in used:
        if measured.fitted_to(flown.log):
            raise DataError(
                f"{flown.log.path}: parameters of {measured.name} were fitted to this flight: validate with another "
                "flight."
            )


def _shown(flight: Flight, fit: FlightFit | None) -> tuple[list[str], bool]:
    """Return the axes about which rotors turned the vehicle enough to judge sets, and whether they lifted it enough."""
    if flight.speeds is not None:
        shown = fit_speeds([flight], scale_std=RESCALED_STD)
        turned = [axis for axis, each in zip(AXES, shown.axes, strict=True) if each.explained >= EXPLAINED]
        return turned, shown.vertical.explained >= EXPLAINED
    axes = [] if fit is None else [motion.name for motion in turnings(fit) if motion.tells]
    return axes, fit is not None and climbing(fit).tells


def _flight(flown: FlownLog, parameters: ParameterSet) -> Flight:
    """Return the flight with the drives of which a set's thrust is a function."""
    return flown.flight if parameters.in_volts else flown.by_command


def _with_delays(flown: FlownLog, sets: Sequence[ParameterSet], axes: Sequence[str]) -> list[ParameterSet]:
    """Return sets with the delay of the one that predicts next rates best, of commands and of rotor speeds each.

    Sensors and link delay a recording, not a vehicle: with a delay of its own, a set could replace a lag, and sets of
    one thrust would differ in their climbs.
    """
    by_speed = [speeds_of(flown.flight, each) is not None for each in sets]
    found = [best_delay(_flight(flown, each), each, axes) for each in sets]
    delays_s = {way: min(one for one, its in zip(found, by_speed, strict=True) if its == way)[1] for way in by_speed}
    return [replace(each, delay_s=delays_s[way]) for each, way in zip(sets, by_speed, strict=True)]


def _without_capture(flight: Flight) -> Flight:
    return replace(flight, velocity=None, attitude=None)


def _errors(
    flown: FlownLog, parameters: ParameterSet, at: Rows, axes: Sequence[str], *, lifts: bool
) -> dict[str, Array]:
    """Return a set's errors (s, h) by quantity, with velocities limited to what the flight can show."""
    flight = _flight(flown, parameters)
    if not axes:  # otherwise moments rotate the thrust that motion capture shows
        flight = _without_capture(flight)
    by_quantity = errors(flight, parameters, at)
    return by_quantity if lifts else by_quantity | {"velocity": thrust_errors(flight, parameters, at)}


def compared(segment_errors: Mapping[str, Mapping[str, Array]]) -> list[SetError]:
    """Return the table of errors (s, h) of sets by quantity, with each set paired with the first by segment."""
    return [
        row
        for quantity in QUANTITIES
        for row in _paired(quantity, HORIZONS, {name: found[quantity] for name, found in segment_errors.items()})
    ]


def _paired(quantity: str, horizons: Sequence[int], of_sets: Mapping[str, Array]) -> list[SetError]:
    """Return the rows of a quantity's errors (s, h) of sets after horizons in rows."""
    first = next(iter(of_sets.values()))
    coverage = float(stdtrit(len(first) - 1, 0.975))
    return [
        SetError(
            quantity=quantity,
            horizon_s=ROW_S * rows,
            name=name,
            error=float(np.mean(found[:, place])),
            more=float(np.mean(more[:, place])),
            half_width=coverage * float(np.std(more[:, place], ddof=1)) / math.sqrt(len(more)),
        )
        for place, rows in enumerate(horizons)
        for name, found in of_sets.items()
        for more in (found - first,)
    ]


def _not_excited(fit: FlightFit | None, axes: Sequence[str], *, lifts: bool) -> list[Finding]:
    """Warn of a flight that shows no moment; a note names the axes about which it shows none."""
    silent = [axis for axis in AXES if axis not in axes]
    if not silent:
        return []
    reason = "a fit to it does not converge, as where air alone moves a vehicle"
    if fit is not None:
        moved = ", ".join(
            f"about {motion.name} {motion.moved:.2g} rad/s^2 rms, {100 * max(motion.explained, 0):.0f} % of what "
            f"changed, known to {100 * motion.open:.0f} %, for 20 s to {100 * motion.unclear:.0f} %"
            for motion in turnings(fit)
            if not motion.tells
        )
        reason = (
            f"its rotors gave {moved} (at least {LEAST_TURN_RAD_PER_S2:g} rad/s^2 and {100 * EXPLAINED:.0f} %, or "
            f"{100 * CALM:.0f} %, or {100 * EXPLAINED:.0f} % and at most {100 * CLEAR:g} % for 20 s; known to "
            f"{100 * LOOSE:.0f} % at least)"
        )
    if axes:
        text = f"this flight shows nothing of the moment about {' and '.join(silent)}: {reason}."
        return [note("validation-not-excited", text)]
    text = (
        f"this flight shows nothing of {'moments' if lifts else 'moments and lags'}: {reason}. What turned it is "
        "mostly something else, such as air, to which its autopilot answers, and that favours wrong sets: there are no "
        "next rates to judge them by. Validate with quick tilts to the right and left, forward and back, for 20 s."
    )
    return [warning("validation-not-excited", text)]


def _unpredicted(table: Sequence[SetError], flown: FlownLog, at: Rows) -> list[Finding]:
    """Warn of a flight whose rates every set predicts worse than no change would: other causes turned the vehicle."""
    place = HORIZONS.index(_TELLING_ROWS)
    of_rates = [row for row in table if row.quantity == "rates" and row.horizon_s == ROW_S * _TELLING_ROWS]
    best, still = min(of_rates, key=lambda row: row.error), float(unchanged(flown.flight, at)[place])
    if best.error <= still:
        return []
    text = (
        f"rates after {best.horizon_s:g} s: who predicts that they stay errs by {still:.2g} rad/s, every set by "
        f"{best.error:.3g} and more. Rates and attitude that are predicted from commands alone show nothing of moments "
        "here: compare velocities, and fly quick tilts without climbing to compare moments."
    )
    return [warning("validation-rates-unpredicted", text).at(flown.flight.name)]


def _table(table: Sequence[SetError], sets: Sequence[ParameterSet], flown: FlownLog, at: Rows) -> list[str]:
    """Return a row a set: what it states, and its errors; those that judge sets have their difference from the first.

    A last row is for who predicts that rates stay.
    """
    columns = [(NEXT, ROW_S), (VERTICAL, 0.5), ("velocity", 0.5), *(("rates", ROW_S * rows) for rows in HORIZONS[1:4])]
    columns = [(what, horizon_s) for what, horizon_s in columns if any(_is(row, what, horizon_s) for row in table)]
    head = ["set", "g", "10^-6 kg m^2", "lag, ms"]
    head += [f"{what}, {(UNITS | {NEXT: UNITS['rates'], VERTICAL: UNITS['velocity']})[what]}" for what, _ in columns]
    after = ["", "", "", "", *("" if what == NEXT else f"after {horizon_s:g} s" for what, horizon_s in columns)]
    rows = [head, after]
    for place, each in enumerate(sets):
        cells = []
        for column in columns:
            error = next(row for row in table if row.name == each.name and _is(row, *column))
            beside = f" ({error.more:+.2g} ± {error.half_width:.1g})" if error.tells and place else ""
            cells.append(f"{error.error:.3g}{beside}")
        moments = "/".join(f"{1e6 * moment:.3g}" for moment in each.moments_kg_m2)
        rows.append([each.name, f"{1e3 * each.mass_kg:.3g}", moments, _lag(flown.flight, each), *cells])
    still = dict(zip((ROW_S * each for each in HORIZONS), unchanged(flown.flight, at), strict=True))
    stays = [f"{still[horizon_s]:.3g}" if what == "rates" else "" for what, horizon_s in columns]
    return columned([*rows, ["rates stay", "", "", "", *stays]])


def _what_judges(judged: Sequence[str]) -> str:
    moments = f"next rates, about {' and '.join(judged)}, judge moments and lags, " if judged else ""
    return f"{moments}vertical velocities judge thrust; the others add up what no set contains, and have no interval"


def _is(row: SetError, quantity: str, horizon_s: float) -> bool:
    return row.quantity == quantity and math.isclose(row.horizon_s, horizon_s)


def _lag(flight: Flight, parameters: ParameterSet) -> str:
    if speeds_of(flight, parameters) is not None:
        return "speeds"
    return (
        "none" if parameters.lag is None else "/".join(f"{1e3 * tau_s:.0f}" for tau_s in dict.fromkeys(parameters.lag))
    )


def _assumed(sets: Sequence[ParameterSet], *, lifts: bool, captured: bool, judged: Sequence[str]) -> str:
    which = "along all axes, by motion capture" if captured else "along the vehicle's vertical, by the accelerometer"
    if not lifts:
        which = (
            "along the vehicle's vertical, by the accelerometer, at each set's mean thrust, since this flight's climbs "
            "do not show how thrust follows commands"
        )
    delays = " and ".join(dict.fromkeys(f"{1e3 * each.delay_s:.1f} ms" for each in sets))
    by = (
        "with which the best set's next rates err least" if judged else "by a fit to this flight, 0 where it shows none"
    )
    return (
        f"assumed: axes forward, left, up; thrust along z; g {USUAL_GRAVITY_MPS2} m/s^2; changes of velocity {which}; "
        "for every set alike, a constant angular acceleration of the whole flight taken away, and the gyro's delay "
        f"added {by}: {delays}"
    )
