"""How rotors follow a command that always changes, in the contract's keys."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple, cast

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import CfidError, FitError
from cfid.estimate.held_readings import Readings
from cfid.findings import Finding, note, rejection, warning
from cfid.motors.delays import delay_text, negative_delay
from cfid.motors.lag.between_rows import (
    between_rows_finding,
    fit_rows,
    mixed_share,
    unsure_between_rows,
)
from cfid.motors.lag.data import RotorLog
from cfid.motors.lag.estimation import LagFit, joined, unsure_of_sag
from cfid.motors.lag.gaps import Gaps
from cfid.motors.lag.part import LogPart
from cfid.motors.lag.values import (
    SPEED_POLY,
    joint_parameters,
    power_finding,
    rotor_maps,
    rotor_rows,
    speed_map_findings,
)
from cfid.motors.repeated import repeated_finding
from cfid.recordings.read import description
from cfid.records.parameters import Parameter
from cfid.records.result import Dependent, Figures, Result

Array = npt.NDArray[np.float64]

_NOTABLE_DRIFT = 0.02  # of the speed
_ROWS = "dynamics.time_constant_s"
_SAGS = (
    "A battery that gives way under load makes time constants too short, by 1.7 % for 0.3 V of 4.1 V: their "
    "uncertainty contains 2 %."
)
_UNFELT = 0.3  # power of the voltage: below, speeds are held, or another voltage drives the rotor
_NO_LAG = rejection(
    "no-lag-fits", "no rotor is described by a first-order lag: see the warnings.", "dynamics.*", SPEED_POLY
)


def fit(record: RotorLog) -> Result:
    """Return time constants of rising and falling speed and the delay behind the command, of each rotor and their mean.

    Raises FitError where no rotor runs for long enough, DataError where nothing shows how it follows.
    """
    try:
        fits, seen, left_out = _fits(record)
    except CfidError as error:
        raise type(error)(f"{record.path}: {str(error).removeprefix(f'{record.path}: ')}") from None
    accepted = {name: one for name, one in fits.items() if one.accepted} or fits
    joint, covariances = joint_parameters(accepted.values(), at_v=seen.at_v, volts=seen.volts)

    def drawings() -> Figures:
        from cfid.motors.lag.figures import lag_figure

        return {f"fit_dynamics_{record.name}": lag_figure(fits, title=record.name)}

    return Result(
        command="fit dynamics",
        method="default",
        quantities={
            **joint,
            _ROWS: Parameter(value=rotor_rows(fits, seen.commands)),
            "dynamics.map": Parameter(value=rotor_maps(fits, at_v=seen.at_v, by_voltage=record.volts is not None)),
        },
        wanted=(_ROWS,),
        covariances=covariances,
        merits={
            "rotors": list(fits),
            "rejected": sum(not one.accepted for one in fits.values()),
            "explained": {name: one.explained for name, one in fits.items()},
            "rms": {name: one.rms for name, one in fits.items()},
        },
        findings=(
            *record.findings,
            *left_out,
            *(one for name, lag in fits.items() for one in _left_out(name, lag)),
            *seen.others,
            *seen.gaps.findings(),
            *_repeated(seen),
            *_about(record, fits, seen),
            *_delay(joint),
            *speed_map_findings(joint, accepted, seen.commands, volts=seen.volts),
            *(() if any(one.accepted for one in fits.values()) else (_NO_LAG,)),
        ),
        sources=(record.log.source,),
        lines=(
            *filter(None, [description(record.log)]),
            *(Dependent(_line(name, one), _ROWS) for name, one in fits.items()),
        ),
        drawings=drawings,
    )


class _Seen(NamedTuple):
    """The interval between rows of the commands, the range of each rotor's commands, and rotors that follow another's.

    `mixed` are the shares of their difference by which each rotor's time constants may lie nearer to each other.
    `volts` is the battery's mean voltage while rotors were driven, None where it was not logged, and `at_v` the voltage
    of the drives. `repeated` are the readings of each rotor whose rows repeat them, `repeated_volts` those of the
    battery.
    """

    row_s: float
    mixed: Mapping[str, float]
    gaps: Gaps
    commands: Mapping[str, tuple[float, float]]
    volts: float | None
    at_v: float
    others: tuple[Finding, ...]
    repeated: Mapping[str, Readings]
    repeated_volts: Readings | None


def _fits(record: RotorLog) -> tuple[dict[str, LagFit], _Seen, tuple[Finding, ...]]:
    """Return the fit of each rotor, and findings about rotors that have no fit."""
    names = {f"rotor {motor}": motor for motor in record.speeds}
    fits: dict[str, list[LagFit]] = {name: [] for name in names}
    failed: dict[str, FitError] = {}
    ranges: dict[str, tuple[float, float]] = {}
    others: dict[str, tuple[Finding, ...]] = {}
    repeated: dict[str, Readings] = {}
    repeated_volts: Readings | None = None
    mixed: dict[str, float] = {}
    gaps = Gaps()
    row_s, volts, rows, at_v = 0.0, 0.0, 0, 1.0
    for part in record.parts():
        row_s, at_v = max(row_s, part.row_s), part.at_v
        gaps = gaps.and_of(*part.commands[min(part.commands)])
        if part.volts_readings and part.volts_readings.age_s:
            repeated_volts = part.volts_readings
        for name, motor in names.items():
            command = part.commands[motor]
            on = command.value[command.value > 0]
            if part.moving(motor):
                mixed[name] = max(mixed.get(name, 0.0), mixed_share(command))
            driven_v = part.driven_volts(motor)
            volts, rows = volts + float(driven_v.sum()), rows + len(driven_v)
            readings = part.readings[motor]
            if readings.age_s:
                repeated.setdefault(name, readings)
            low, high = ranges.get(name, (np.inf, -np.inf))
            ranges[name] = min(low, float(on.min(initial=np.inf))), max(high, float(on.max(initial=-np.inf)))
            try:
                fit = fit_rows(part.of_speed(motor), row_s=part.row_s, moving=part.moving(motor), age_s=readings.age_s)
            except FitError as error:
                failed[name] = error
                continue
            fits[name].append(fit)
            if not fits[name][-1].accepted and name not in others:
                others[name] = _other_command(part, motor)
    found = {name: joined(each) for name, each in fits.items() if each}
    found = {name: unsure_between_rows(fit, mixed[name]) if name in mixed else fit for name, fit in found.items()}
    found = {name: unsure_of_sag(fit) if _is_unfelt(record, fit) else fit for name, fit in found.items()}
    if not found:
        raise next(iter(failed.values()), FitError("no rows of all commands."))
    return (
        found,
        _Seen(
            row_s,
            mixed,
            gaps,
            ranges,
            volts / rows if rows else None,
            at_v,
            tuple(one for name, each in others.items() if not found[name].accepted for one in each),
            repeated,
            repeated_volts,
        ),
        tuple(
            warning("lag-rotor-left-out", str(error), "dynamics.*").at(name)
            for name, error in failed.items()
            if name not in found
        ),
    )


def _other_command(part: LogPart, motor: int) -> tuple[Finding, ...]:
    """Return a warning where the speed of a rotor that does not follow its command follows that of another."""
    best, explained = 0, 0.0
    for other in part.commands:
        if other == motor:
            continue
        try:
            fit = fit_rows(part.of_speed(motor, by=other), row_s=part.row_s, moving=part.moving(other))
        except FitError:
            continue
        if fit.accepted and fit.explained > explained:
            best, explained = other, fit.explained
    if not best:
        return ()
    text = (
        f"its speed follows the command of motor {best}, of which a first-order lag explains {100 * explained:.0f} %: "
        "are the columns swapped, or the motors' plugs?"
    )
    return (warning("lag-other-command", text, "dynamics.*").at(f"rotor {motor}"),)


def _repeated(seen: _Seen) -> tuple[Finding, ...]:
    """Return notes on readings that rows repeat: of the rotor with fewest readings, and of the battery's voltage."""
    found = []
    if seen.repeated:
        fewest = min(seen.repeated.values(), key=lambda one: one.read / one.rows)
        found.append(repeated_finding(fewest).at(", ".join(seen.repeated)))
    if seen.repeated_volts:
        rows, read, _ = seen.repeated_volts
        text = (
            f"each reading of the battery's voltage is repeated in about {rows / read:.2g} rows: its first row counts."
        )
        found.append(note("voltage-repeated", text, "dynamics.*"))
    return tuple(found)


def _left_out(name: str, fit: LagFit) -> tuple[Finding, ...]:
    """Return a warning about speeds that no rotor had, and when."""
    kinds = (
        (fit.standing_s, "stand still for a second or longer while its command moves"),
        (fit.odd_s, "lie far outside all that its commands lead to"),
    )
    return tuple(
        warning(
            "lag-speeds-left-out",
            f"{counted(len(times), 'speed')} of {len(fit.measured) + len(fit.standing_s) + len(fit.odd_s)}, from "
            f"{times.min():.1f} to {times.max():.1f} s, {what}: left out.",
            "dynamics.*",
        ).at(name)
        for times, what in kinds
        if len(times)
    )


def _about(record: RotorLog, fits: Mapping[str, LagFit], seen: _Seen) -> tuple[Finding, ...]:
    """Return why rotors are rejected, as warnings since the keys have other rotors, and what the numbers contain."""
    found = [replace(one, severity="warning", where=(name,)) for name, fit in fits.items() for one in fit.findings]
    if seen.row_s:
        found.append(between_rows_finding(seen.row_s, max(seen.mixed.values(), default=0.0)))
    name, most = max(fits.items(), key=lambda item: abs(item[1].drift) * item[1].accepted)
    if most.accepted and abs(most.drift) > _NOTABLE_DRIFT:
        changed = f"the speed of {name} changed by {100 * most.drift:+.1f} % from begin to end"
        held = "the maps hold in the middle of the log."
        text = f"at the same command {changed}: {held} Log the battery's voltage."
        if record.volts is not None:
            text = (
                f"beside the map of command times voltage {changed}: the rotor changed, or its speed goes with the "
                f"voltage in another way than with the command; {held}"
            )
        found.append(warning("lag-map-drifts", text, SPEED_POLY, "dynamics.map"))
    found += _of_voltage(record, fits)
    if seen.volts is not None and any(fit.accepted for fit in fits.values()):
        found.append(power_finding(fit for fit in fits.values() if fit.accepted))
    return tuple(found)


def _is_unfelt(record: RotorLog, fit: LagFit) -> bool:
    """Return whether no voltage was logged, or a rotor's speed shows nothing of it."""
    return record.volts is None or (fit.power is not None and fit.power[0] < _UNFELT)


def _of_voltage(record: RotorLog, fits: Mapping[str, LagFit]) -> list[Finding]:
    """Return a warning where no voltage shows how the battery sagged under the rotors."""
    if record.volts is None:
        text = f"the log has no battery voltage. {_SAGS} Log the battery's voltage."
        return [warning("lag-voltage-unknown", text, "dynamics.*")]
    unfelt = [name for name, fit in fits.items() if fit.accepted and _is_unfelt(record, fit)]
    if not unfelt:
        return []
    text = (
        "the speed does not go with the recorded voltage: it is held by its controller, or the voltage is not that of "
        f"the battery. {_SAGS} Look at the voltage in `cfid show`."
    )
    return [warning("lag-voltage-unfelt", text, "dynamics.*").at(", ".join(unfelt))]


def _delay(joint: Mapping[str, Parameter]) -> tuple[Finding, ...]:
    delay = joint["dynamics.delay_s"]
    return negative_delay(float(cast(float, delay.value)), float(cast(float, delay.std)), "dynamics.delay_s")


def _line(name: str, fit: LagFit) -> str:
    if not fit.accepted:
        return f"{name}: rejected"
    (rising, falling, _), std = (1e3 * np.array(values) for values in (fit.lag, fit.std_s))
    return (
        f"{name}: rising {rising:.1f} +- {std[0]:.1f} ms, falling {falling:.1f} +- {std[1]:.1f} ms, "
        f"{delay_text(fit.lag.delay_s, fit.std_s.delay_s)}, explains {100 * fit.explained:.1f} %"
    )
