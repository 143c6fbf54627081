"""Compare how well parameter sets predict a flight: errors by quantity and horizon, differences paired by segment."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
import numpy.typing as npt
from scipy.special import stdtrit

from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, warning
from cfid.flight.data import FlownLog
from cfid.flight.equations import DELAYS
from cfid.flight.estimation import fit_alone
from cfid.flight.findings import contradictions
from cfid.flight.rows import LEVER, ROW_S
from cfid.recordings.read import description
from cfid.records.result import Figures, Result
from cfid.units import USUAL_GRAVITY_MPS2
from cfid.validation.measured import Measured
from cfid.validation.next_rates import next_rate_errors
from cfid.validation.rollout import (
    HORIZONS,
    QUANTITIES,
    UNITS,
    ParameterSet,
    Rows,
    errors,
    starts,
    thrust_errors,
    unchanged,
)
from cfid.validation.telling import Telling, telling_of

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

    @property
    def difference(self) -> str:
        """The difference from the first set, in words."""
        return f"{self.more:+.2g} +- {self.half_width:.1g}" if self.tells else f"{self.more:+.2g}"


def validate(flown: FlownLog, sets: Sequence[ParameterSet], *, used: Sequence[Measured]) -> Result:
    """Compare what sets predict of a flight with its recording. `used` are the measured parameters among them.

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
    found = fit_alone(flown.flight)
    telling = telling_of(found)
    # Sensors and link delay a recording, not a vehicle: a set without this delay would err as one with wrong moments.
    delay_s = float(found.values[DELAYS][-1]) if found and (telling.axes or telling.vertical) else 0.0
    sets = [replace(one, delay_s=delay_s) for one in sets]
    each = {one.name: _errors(flown, one, at, telling) for one in sets}
    captured = flown.flight.velocity is not None and bool(telling.axes)
    judged = [axis for axis in telling.axes if axis != "yaw" or all(one.torque_m for one in sets)]
    table = [replace(one, tells=one.quantity == "velocity" and not captured) for one in compared(each)]
    if captured:
        table += _of_vertical(flown, sets, at)
    if judged:
        table = [*_of_next_rates(flown, sets, judged, len(at)), *table]

    def drawings() -> Figures:
        from cfid.validation.figures import validation_figure

        title = f"{flown.flight.name}: {counted(len(at), 'segment')} of 1 s"
        return {f"validate_{flown.flight.name}": validation_figure(each, title=title)}

    return Result(
        command="validate",
        method="default",
        quantities={},
        findings=(
            *flown.findings,
            *contradictions(flown, found, [one.arm_m for one in sets]),
            *(one.at(flown.flight.name) for one in telling.findings),
            *_unpredicted(table, flown, at),
        ),
        merits={
            "segments": len(at),
            "sets": {one.name: one.origin for one in sets},
            "errors": [one.row for one in table],
        },
        sources=(flown.log.source,),
        lines=(
            description(flown.log),
            *map(_described, sets),
            *_lines(table, flown, at, judged),
            _assumed(telling, captured=captured, delay_s=delay_s),
        ),
        drawings=drawings,
    )


def _errors(flown: FlownLog, one: ParameterSet, at: Rows, telling: Telling) -> dict[str, Array]:
    """Return a set's errors (s, h) by quantity, with velocities limited to what the flight can show."""
    flight = flown.flight if one.in_volts else flown.by_command
    if not telling.axes:  # otherwise moments rotate the thrust that motion capture shows
        flight = replace(flight, velocity=None, attitude=None)
    found = errors(flight, one, at)
    return found if telling.vertical else found | {"velocity": thrust_errors(flight, one, at)}


def _of_vertical(flown: FlownLog, sets: Sequence[ParameterSet], at: Rows) -> list[SetError]:
    """Return the table's rows that judge thrust: motion capture's velocities depend on predicted attitudes."""
    found = {}
    for one in sets:
        flight = flown.flight if one.in_volts else flown.by_command
        found[one.name] = errors(replace(flight, velocity=None, attitude=None), one, at)["velocity"]
    return _paired(VERTICAL, HORIZONS, found)


def _of_next_rates(flown: FlownLog, sets: Sequence[ParameterSet], axes: Sequence[str], parts: int) -> list[SetError]:
    """Return the table's rows that judge moments and lags, about the axes whose moments the flight shows."""
    flights = [flown.flight if one.in_volts else flown.by_command for one in sets]
    found = {
        one.name: next_rate_errors(flight, one, axes, parts=parts)[:, np.newaxis]
        for flight, one in zip(flights, sets, strict=True)
    }
    return _paired(NEXT, (1,), found)


def compared(each: Mapping[str, Mapping[str, Array]]) -> list[SetError]:
    """Return the table of errors (s, h) of sets by quantity, with each set paired with the first by segment."""
    return [
        row
        for quantity in QUANTITIES
        for row in _paired(quantity, HORIZONS, {name: found[quantity] for name, found in each.items()})
    ]


def _paired(quantity: str, horizons: Sequence[int], each: Mapping[str, Array]) -> list[SetError]:
    """Return the rows of a quantity's errors (s, h) of sets after horizons in rows."""
    first = next(iter(each.values()))
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
        for name, found in each.items()
        for more in (found - first,)
    ]


def _check(flown: FlownLog, sets: Sequence[ParameterSet], used: Sequence[Measured]) -> None:
    names = [one.name for one in sets]
    if not names:
        raise ConfigError("no parameter set: work in a campaign that has one, or name one by `with`.")
    if len(set(names)) < len(names):
        raise ConfigError(f"two parameter sets are called {max(names, key=names.count)}: name each once.")
    for one in used:
        if one.fitted_to(flown.log):
            raise DataError(
                f"{flown.log.path}: parameters of {one.name} were fitted to this flight: validate with another flight."
            )


def _unpredicted(table: Sequence[SetError], flown: FlownLog, at: Rows) -> list[Finding]:
    """Warn of a flight whose rates every set predicts worse than no change would: other causes turned the vehicle."""
    place = HORIZONS.index(_TELLING_ROWS)
    of_rates = [one for one in table if one.quantity == "rates" and one.horizon_s == ROW_S * _TELLING_ROWS]
    best, still = min(of_rates, key=lambda one: one.error), float(unchanged(flown.flight, at)[place])
    if best.error <= still:
        return []
    text = (
        f"rates after {best.horizon_s:g} s: who predicts that they stay errs by {still:.2g} rad/s, every set by "
        f"{best.error:.3g} and more. Rates and attitude that are predicted from commands alone show nothing of moments "
        "here: compare velocities, and fly quick tilts without climbing to compare moments."
    )
    return [warning("validation-rates-unpredicted", text).at(flown.flight.name)]


def _described(one: ParameterSet) -> str:
    moments = ", ".join(f"{moment:.4g}" for moment in one.moments_kg_m2)
    lag = "no lag"
    if one.lag is not None:
        lag = f"lags {1e3 * one.lag.rising_s:.0f} and {1e3 * one.lag.falling_s:.0f} ms"
    body = f"{1e3 * one.mass_kg:.4g} g, lever {1e3 * LEVER * one.arm_m:.4g} mm, moments {moments} kg m^2"
    return f"{one.name}: {body}, {lag}; from {one.origin}"


def _lines(table: Sequence[SetError], flown: FlownLog, at: Rows, judged: Sequence[str]) -> list[str]:
    still = ", ".join(f"{error:.3g}" for error in unchanged(flown.flight, at))
    lines = [
        f"mean errors over {counted(len(at), 'segment')} of 1 s; in brackets how much more than "
        f"{table[0].name}, with 95 % where it judges sets:"
    ]
    for (quantity, horizon_s), group in groupby(table, lambda one: (one.quantity, one.horizon_s)):
        words = [
            f"{one.name} {one.error:.3g}" + (f" ({one.difference})" if place else "") for place, one in enumerate(group)
        ]
        what = f"{quantity} after {horizon_s:g} s, {UNITS.get(quantity, UNITS['velocity'])}"
        if quantity == NEXT:
            what = f"{NEXT} about {', '.join(judged)}, given those before, {UNITS['rates']}"
        lines.append(f"  {what}: {', '.join(words)}")
    by_what = f"{NEXT} judge moments and lags, vertical velocities" if judged else "vertical velocities judge"
    return [
        *lines,
        f"{by_what} thrust. The others, from commands alone, have no interval: they add up what no set contains, "
        "the autopilot answers to it, and moments that are too large then err by less than the true ones; who predicts "
        f"that rates stay errs by {still} rad/s",
    ]


def _assumed(telling: Telling, *, captured: bool, delay_s: float) -> str:
    which = "along all axes, by motion capture" if captured else "along the vehicle's vertical, by the accelerometer"
    if not telling.vertical:
        which = (
            "along the vehicle's vertical, by the accelerometer, at each set's mean thrust, since this flight's climbs "
            "do not show how thrust follows commands"
        )
    return (
        f"assumed: axes forward, left, up; thrust along z; g {USUAL_GRAVITY_MPS2} m/s^2; changes of velocity {which}; "
        "for every set alike, a constant angular acceleration of the whole flight taken away, and the gyro's delay by "
        f"a fit to this flight added, {1e3 * delay_s:.1f} ms (0 where it shows none)"
    )
