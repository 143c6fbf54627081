"""Logs of flights as drives, rates, specific forces and velocities along the vehicle's axes, and when it was flying."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError, FitError
from cfid.findings import Finding, note, of_recording, rejection, warning
from cfid.flight.airborne import EDGE_S, in_air, late, without_touches
from cfid.flight.channels import (
    at_rows,
    command_names,
    commands_of,
    forces_of,
    held,
    motion,
    moving_others,
    rates_of,
    volts_of,
)
from cfid.flight.gyro_unit import refuse_other_unit
from cfid.flight.model import AXES, ROW_S, ROW_STEPS, STEP_S, Flight, segments, turned_back
from cfid.flight.repeated import (
    ACCELEROMETER,
    GYRO,
    commands_apart_s,
    commands_held_s,
    first_rows,
    held_findings,
    repeated_findings,
)
from cfid.records.logs.any_kind import NO_OPTIONS, read_log
from cfid.records.logs.flights import longest_flight
from cfid.records.logs.hung import without_hung
from cfid.records.logs.limits import COMMANDS, FORCES, RATES, Limits
from cfid.records.logs.log import FlightLog
from cfid.records.logs.motor_numbers import NO_SQUARE
from cfid.records.logs.repeated_times import refuse_repeated_times
from cfid.records.logs.run import log_of_run
from cfid.records.run_notes import run_at
from cfid.records.tables.gyro import at_end_of_range
from cfid.records.tables.schema import Foreign, refuse_for_run
from cfid.units import DEAD_COMMAND, FULL_COMMAND, MOTORS, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
_SLOWEST_S = 0.021  # between rows of a sensor: slower, rates change unseen
_OTHER_UNIT_S = 0.5  # between rows, which is 1000 times what autopilots log at most
_AVERAGED_S = ROW_S / 2  # between rows of a sensor, below which they are averaged
_WEIGHT = (0.2, 5.0)  # of gravity, which a median specific force is nearly: beyond, its unit is another
_SETTLING_S = 0.3  # after a motor left its range, or commands were not seen, in which rotors forget it
_MOST_S = 600.0
_FEWEST = 500  # rows: 5 s, that a gyro has to show of the turning about an axis
_AT_END_S = 2 * ROW_S  # around a gyro's end of range, in which a row's mean has a part of it
_AROUND_S = 5.0  # of rows that are kept before and after, for channels that are logged rarely


@dataclass(frozen=True, kw_only=True, eq=False)
class FlownLog:
    """A log with its flight, and findings about reading it.

    `by_command` is the same flight with drives that are the command over the full one, whether volts are known or not.
    `voltmeter` are the battery's volts (k,) as the log has them, at times since the flight's first drive. `apart_s` is
    how far apart commands and readings of the gyro and of the accelerometer usually are.
    """

    log: FlightLog
    flight: Flight
    by_command: Flight
    findings: tuple[Finding, ...]
    apart_s: tuple[float, float, float]
    voltmeter: tuple[Array, Array] | None = None

    @property
    def in_air_s(self) -> float:
        """How long it flew."""
        return ROW_S * float(np.count_nonzero(self.flight.airborne))

    @property
    def driven_s(self) -> float:
        """How long of that all motors were within their range."""
        return ROW_S * float(np.count_nonzero(self.flight.driven))


def read_flight(
    path: Path, reading: Foreign = NO_OPTIONS, *, from_s: float | None = None, to_s: float | None = None
) -> FlownLog:
    """Read a run or a log of any kind, between two times since its first row of a command.

    Raises DataError for a log without commands of all motors, rates and accelerations, or sampled too slowly, FitError
    for one of a vehicle that other motors than four carry, and ConfigError for a `reading` beside a run.
    """
    run = run_at(path)
    if run is None:
        return flight_of(read_log(path, reading), from_s=from_s, to_s=to_s)
    refuse_for_run(path, reading)
    return flight_of(log_of_run(run), from_s=from_s, to_s=to_s)


def flight_of(log: FlightLog, *, from_s: float | None = None, to_s: float | None = None) -> FlownLog:
    """Take the flight out of a log that was read, as `read_flight`."""
    log = longest_flight(log)
    path = log.path
    _refuse_other_motors(log)
    first = log.channel(command_names(log)[0])[0]
    refuse_repeated_times(path, first)
    _check_spacing(first, log)
    from_s, to_s = _window(first, path, from_s or 0.0, np.inf if to_s is None else to_s)
    around = from_s - _AROUND_S, to_s + _AROUND_S
    whole, log = log, replace(log, series=tuple(one.between(*around) for one in log.series))
    spoilt: list[str] = []
    commands = [
        _possible(*_numbers(*one, name, path), COMMANDS, name, spoilt)
        for name, one in zip(command_names(log), commands_of(log), strict=True)
    ]
    rates, rates_hz = rates_of(log)
    rates = _possible(*rates, RATES, GYRO, spoilt)
    forces, forces_hz = forces_of(log)
    forces = _possible(*forces, FORCES, ACCELEROMETER, spoilt)
    (rates, forces), hung = without_hung({GYRO: rates, ACCELEROMETER: forces})
    timed = [one[0] for one in (*commands, rates, forces)]
    begin, end = max(from_s, *(float(one[0]) for one in timed)), min(to_s, *(float(one[-1]) for one in timed))
    _check_left(end - begin, path)
    for one in timed:
        _check_spacing(one, log)
    (rates, forces), readings = first_rows({GYRO: rates, ACCELEROMETER: forces})
    for time_s in (rates[0], forces[0]):
        _check_spacing(time_s, log, "readings")
    timed[-2:] = rates[0], forces[0]
    rows = int((end - begin) / ROW_S)
    at_s = np.asarray(begin + STEP_S * np.arange(rows * ROW_STEPS), dtype=np.float64)
    command = np.column_stack([held(*one, at_s) for one in commands])
    voltmeter, faults = volts_of(log)
    row_s = np.asarray(begin + ROW_S * np.arange(rows), dtype=np.float64)
    averaged = _apart_s(rates[0]) < _AVERAGED_S
    force = at_rows(*forces, row_s, averaged=averaged)
    spun = at_rows(*rates, row_s, averaged=averaged)
    velocity, attitude = motion(log, row_s)
    if velocity is not None and attitude is not None:
        velocity = turned_back(attitude, velocity)
    share = command[::ROW_STEPS]
    running = (share > 0).all(axis=1)
    _check_weight(force[running], path)
    refuse_other_unit(log, *rates, np.interp(rates[0], row_s, running) == 1)
    unseen, gaps = _unseen(timed, row_s)
    followed = ~late(unseen, _SETTLING_S)
    airborne, touches = without_touches(
        in_air(share, force, spun) & ~unseen, followed, command, force[:, 2], begin_s=begin - float(first[0])
    )
    within = ~unseen & ((share > DEAD_COMMAND) & (share < FULL_COMMAND)).all(axis=1)
    driven = airborne & ~late(np.asarray(~within), _SETTLING_S)
    beyond, clipped = _beyond(*rates, row_s, driven)
    by_command = Flight(
        name=path.stem,
        drive=command / FULL_COMMAND,
        rates=spun,
        force=force,
        airborne=airborne,
        driven=driven,
        beyond=beyond,
        averaged=averaged,
        in_volts=False,
        low_pass_hz=(forces_hz, rates_hz),
        ages_s=(readings[ACCELEROMETER].age_s, readings[GYRO].age_s),
        held_s=commands_held_s(commands, readings),
        velocity=velocity,
        attitude=attitude,
    )
    if voltmeter is not None:
        voltmeter = voltmeter[0] - begin, voltmeter[1]
    return FlownLog(
        log=whole,
        flight=by_command if voltmeter is None else _in_volts(by_command, *voltmeter),
        by_command=by_command,
        voltmeter=voltmeter,
        apart_s=(commands_apart_s(*commands[0], readings), _apart_s(rates[0]), _apart_s(forces[0])),
        findings=(
            *of_recording(path.name, [text for text in log.notes if not text.startswith(NO_SQUARE)]),
            *(note("recording", f"assumed: {text}.").at(path.name) for text in log.assumed),
            *(warning("recording", text).at(path.name) for text in (*spoilt, *hung, *faults, *gaps)),
            *(one.at(path.name) for one in (*repeated_findings(readings), *held_findings(by_command.held_s))),
            *(one.at(path.name) for one in (*touches, *clipped)),
        ),
    )


def _in_volts(flight: Flight, time_s: Array, volts: Array) -> Flight:
    """Return a flight whose drives are commands times the battery's volts (k,), at times since its first drive."""
    at_s = STEP_S * (np.arange(len(flight.drive)) + 0.5)  # in the middle of what a command's mean is over
    volts = np.interp(at_s, time_s, volts)
    return replace(flight, drive=flight.drive * volts[:, np.newaxis], in_volts=True, volts=volts)


def _numbers(time_s: Array, values: Array, what: str, path: Path) -> tuple[Array, Array]:
    """Return the rows of times (n,) and values (n,) with a number, which others do not hold. Raises DataError for none.

    Nobody knows what a motor did without one: such rows are as good as missing.
    """
    known = np.isfinite(values)
    if not known.any():
        raise DataError(f"{path}: '{what}' has no number: a flight's thrust is that of all four motors.")
    return time_s[known], values[known]


def _possible(time_s: Array, values: Array, limits: Limits, what: str, notes: list[str]) -> tuple[Array, Array]:
    """Return the rows of times (n,) and values (n,) or (n, 3) without a few that cannot be, which `notes` then name."""
    outside = limits.outside(values)
    rows, known = (np.atleast_2d(mask.T) for mask in (outside, np.isfinite(values)))
    wrong, count = rows.any(axis=0), int(np.count_nonzero(rows.any(axis=0)))
    if not limits.few(count, int(np.count_nonzero(known.all(axis=0)))):
        return time_s, values
    notes.append(limits.left_out(what, count, float(values[outside][0])))
    return time_s[~wrong], values[~wrong]


def _apart_s(time_s: Array) -> float:
    """Return how far apart rows at times (n,) usually are."""
    return float(np.median(np.diff(time_s)))


def _unseen(timed: Sequence[Array], row_s: Array) -> tuple[Mask, tuple[str, ...]]:
    """Return the rows (m,) at which some channel is silent for long, and a sentence on them; `timed` are its times."""
    unseen = np.zeros(len(row_s), bool)
    for time_s in timed:
        for place in np.flatnonzero(np.diff(time_s) > _SLOWEST_S):
            unseen |= (row_s > time_s[place] - ROW_S) & (row_s < time_s[place + 1] + ROW_S)
    lost_s = ROW_S * int(np.count_nonzero(unseen))
    text = (
        f"{lost_s:.3g} s in gaps without rows, or with rows that have no command or reading (above "
        f"{1e3 * _SLOWEST_S:.0f} ms), and what follows, are left out."
    )
    return unseen, (text,) if unseen.any() else ()


def _beyond(time_s: Array, rates: Array, row_s: Array, driven: Mask) -> tuple[Mask | None, list[Finding]]:
    """Return rows (m,) at which a gyro stood at an end of its range, None if it did not, and a finding on them.

    Where less than 5 s of the rows that are `driven` (m,) would be left, what rests on them is rejected.
    """
    ends = [at_end_of_range(rate, rate) | at_end_of_range(rate, -rate) for rate in rates.T]
    at_s = time_s[np.logical_or.reduce(ends)]
    if not len(at_s):
        return None, []
    beyond = np.searchsorted(at_s, row_s + _AT_END_S) > np.searchsorted(at_s, row_s - _AT_END_S)
    reached = [
        f"{np.degrees(np.abs(rate).max()):.0f} deg/s about {axis}"
        for axis, rate, end in zip(AXES, rates.T, ends, strict=True)
        if end.any()
    ]
    text = f"the gyro reached {', '.join(reached)}, the end of its range, and shows no more than that: "
    left = sum(one.stop - one.start for one in segments(driven & ~beyond))
    lost_s = ROW_S * int(np.count_nonzero(beyond))
    remedy = "Set a larger range, or turn slower."
    if left < _FEWEST:
        text += f"{ROW_S * left:.1f} s are left without it (at least {ROW_S * _FEWEST:g} s). {remedy}"
        return beyond, [rejection("flight-gyro-clipped", text, "flight.inertia_kg_m2.*", "flight.*_s")]
    text += f"{lost_s:.3g} s are left out of what rests on rates. {remedy}"
    return beyond, [warning("flight-gyro-clipped", text, "flight.inertia_kg_m2.*")]


def _check_spacing(time_s: Array, log: FlightLog, what: str = "rows") -> None:
    """Raise DataError for rows, or `what` they show, at times (n,) too far apart for rates to be seen."""
    if len(time_s) < 2 or (apart_s := _apart_s(time_s)) <= _SLOWEST_S:
        return
    other = f" Here {log.clock}: if they are in a smaller unit, give `time_unit`." if apart_s >= _OTHER_UNIT_S else ""
    raise DataError(
        f"{log.path}: {what} {1e3 * apart_s:.0f} ms apart (limit {1e3 * _SLOWEST_S:.0f} ms): log motors, gyro and "
        f"accelerometer every 10 ms at least (PX4: the high rate of SDLOG_PROFILE).{other}"
    )


def _window(time_s: Array, path: Path, from_s: float, to_s: float) -> tuple[float, float]:
    """Return from when to when rows of times (n,) are fitted. Raises ConfigError for too long, or too little of it."""
    begin, end = float(time_s[0]) + from_s, float(min(time_s[-1], time_s[0] + to_s))
    _check_left(end - begin, path)
    if end - begin > _MOST_S:
        gone = np.diff(time_s[(time_s >= begin) & (time_s <= end)])
        longest = int(np.argmax(gone))
        jump = f"; {gone[longest]:.0f} s of them are one gap" if gone[longest] > (end - begin) / 2 else ""
        raise ConfigError(f"{path}: {end - begin:.0f} s at once (limit {_MOST_S:g} s){jump}: give `from_s` and `to_s`.")
    return begin, end


def _check_left(left_s: float, path: Path) -> None:
    if not left_s > 2 * EDGE_S:
        raise ConfigError(f"{path}: {max(left_s, 0.0):.3g} s are left of the log (limit {2 * EDGE_S:g} s).")


def _refuse_other_motors(log: FlightLog) -> None:
    if others := moving_others(log):
        raise FitError(
            f"{log.path}: there are commands of {', '.join(others)} besides those of the motors m1 to m4, "
            f"{len(MOTORS) + len(others)} in all: thrust and moments are fitted, and flights predicted, for "
            "quadrocopters alone."
        )


def _check_weight(force: Array, path: Path) -> None:
    """Raise DataError where specific forces (n, 3) under running motors are not about gravity, upwards."""
    if not len(force):
        return
    size = float(np.median(np.linalg.norm(force, axis=1))) / USUAL_GRAVITY_MPS2
    if not _WEIGHT[0] < size < _WEIGHT[1]:
        reason = "in m/s^2, not in g" if size > _WEIGHT[1] else "in g, not in m/s^2"
        raise DataError(
            f"{path}: accelerations of {size:.2g} g while the motors run, where a flight has about 1: are they "
            f"{reason}? Scale these columns, or state their unit in the header of a table, as in acc.x [m/s^2]."
        )
    if float(np.median(force[:, 2])) < 0:
        raise DataError(
            f"{path}: the acceleration along z is {np.median(force[:, 2]):.2g} m/s^2 while motors run, and a flight "
            "has +9.8: z points down in this log. Turn the axes to x forward, y left, z up."
        )
