"""Convert logs to drives, rates, specific forces and velocities along the vehicle's axes, and find when it flew."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError, FitError
from cfid.findings import Finding, finding, rejection, warning
from cfid.flight.airborne import in_air, late, without_touches
from cfid.flight.channels import at_rows, held, motion, moving_others, volts_of
from cfid.flight.gyro_unit import refuse_other_unit
from cfid.flight.repeated import ACCELEROMETER, GYRO, commands_held_s, held_findings, repeated_findings
from cfid.flight.rows import AXES, ROW_S, ROW_STEPS, STEP_S, Flight, segments, turned_back
from cfid.flight.sensed import SLOWEST_S, Sensed, sensed_in
from cfid.recordings.crazyflie import findings_in
from cfid.recordings.gyro import at_end_of_range
from cfid.recordings.read import read_recording
from cfid.recordings.recording import Recording
from cfid.units import DEAD_COMMAND, FULL_COMMAND, MOTORS, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
_WEIGHT = (0.2, 5.0)  # of gravity: the median specific force is close to it; outside these limits, the unit is wrong
# Rows are left out for this time after a motor left its range or commands are missing: until then, the rotors still
# follow what happened before.
_SETTLING_S = 0.3
_FEWEST = 500  # rows: 5 s, the least that a gyro has to show of the rotation about an axis
_AT_END_S = 2 * ROW_S  # around an end of the gyro's range: the means of these rows contain a part of it


@dataclass(frozen=True, kw_only=True, eq=False)
class FlownLog:
    """A log with its flight, and findings about reading it.

    `by_command` is the same flight with the commands relative to full command as its drives, whether the voltage is
    known or not. `voltmeter` is the battery's voltage (k,) as logged, at times since the flight's first drive.
    `apart_s` are the usual times between commands, between readings of the gyro and between readings of the
    accelerometer.
    """

    log: Recording
    flight: Flight
    by_command: Flight
    findings: tuple[Finding, ...]
    apart_s: tuple[float, float, float]
    voltmeter: tuple[Array, Array] | None = None

    @property
    def in_air_s(self) -> float:
        """The time in the air."""
        return ROW_S * float(np.count_nonzero(self.flight.airborne))

    @property
    def driven_s(self) -> float:
        """The time in the air during which all motors were within their range."""
        return ROW_S * float(np.count_nonzero(self.flight.driven))


def read_flight(
    path: Path,
    *,
    from_s: float | None = None,
    to_s: float | None = None,
    props_out: bool = False,
) -> FlownLog:
    """Read a run or a log of any kind, between two times since its first row of a command.

    With `props_out`, rotors turn the other way than a Crazyflie's, whether the log states it or not.

    Raises DataError for a log that lacks commands of all motors, rates or accelerations, or is sampled too slowly,
    FitError for one of a vehicle with other than four motors.
    """
    return flight_of(read_recording(path), from_s=from_s, to_s=to_s, props_out=props_out)


def flight_of(
    whole: Recording, *, from_s: float | None = None, to_s: float | None = None, props_out: bool = False
) -> FlownLog:
    """Extract the flight from a log that has been read, as in `read_flight`."""
    if props_out:
        whole = replace(whole, facts=replace(whole.facts, props_out=True))
    _refuse_other_motors(whole)
    sensed = sensed_in(whole, from_s or 0.0, np.inf if to_s is None else to_s)
    voltmeter, faults = volts_of(sensed.log)
    if voltmeter is not None:
        voltmeter = voltmeter[0] - sensed.begin_s, voltmeter[1]
    by_command, gaps, found = _by_command(sensed)
    name = whole.path.name
    return FlownLog(
        log=whole,
        flight=by_command if voltmeter is None else _in_volts(by_command, *voltmeter),
        by_command=by_command,
        voltmeter=voltmeter,
        apart_s=sensed.apart_s,
        findings=(
            *findings_in(whole),
            *_of_facts(whole),
            *(one.at(name) for one in sensed.findings),
            *(warning("recording", text).at(name) for text in (*faults, *gaps)),
            *(one.at(name) for one in repeated_findings(sensed.readings)),
            *(one.at(name) for one in held_findings(by_command.held_s)),
            *(one.at(name) for one in found),
        ),
    )


def _by_command(sensed: Sensed) -> tuple[Flight, tuple[str, ...], tuple[Finding, ...]]:
    """Return the flight with commands as drives, a sentence on gaps, and findings on touches and the gyro's range."""
    row_s = sensed.row_s
    command = np.column_stack([held(*one, sensed.step_s) for one in sensed.commands])
    force = at_rows(*sensed.forces, row_s, averaged=sensed.averaged)
    spun = at_rows(*sensed.rates, row_s, averaged=sensed.averaged)
    velocity, attitude = motion(sensed.log, row_s)
    if velocity is not None and attitude is not None:
        velocity = turned_back(attitude, velocity)
    share = command[::ROW_STEPS]
    running = (share > 0).all(axis=1)
    _check_weight(force[running], sensed.log.path)
    refuse_other_unit(sensed.log, *sensed.rates, np.interp(sensed.rates[0], row_s, running) == 1)
    unseen, gaps = _unseen(sensed.times_s, row_s)
    airborne, touches = without_touches(
        in_air(share, force, spun) & ~unseen,
        ~late(unseen, _SETTLING_S),
        command,
        force[:, 2],
        begin_s=sensed.begin_s - sensed.first_s,
    )
    within = ~unseen & ((share > DEAD_COMMAND) & (share < FULL_COMMAND)).all(axis=1)
    driven = airborne & ~late(np.asarray(~within), _SETTLING_S)
    beyond, clipped = _beyond(*sensed.rates, row_s, driven)
    flight = Flight(
        name=sensed.log.path.stem,
        drive=command / FULL_COMMAND,
        rates=spun,
        force=force,
        airborne=airborne,
        driven=driven,
        beyond=beyond,
        averaged=sensed.averaged,
        in_volts=False,
        low_pass_hz=sensed.low_pass_hz,
        ages_s=(sensed.readings[ACCELEROMETER].age_s, sensed.readings[GYRO].age_s),
        held_s=commands_held_s(sensed.commands, sensed.readings),
        velocity=velocity,
        attitude=attitude,
        props_out=sensed.log.facts.props_out is True,
    )
    return flight, gaps, (*touches, *clipped)


def _of_facts(log: Recording) -> tuple[Finding, ...]:
    """Return findings on what a log, or an option, states of its rotors and of its clock."""
    found = []
    if log.facts.props_out:
        found.append(finding("flight-props-out"))
    if log.facts.clock == "unknown":
        found.append(finding("gyro-clock-undecided", "flight.inertia_kg_m2.*", "flight.*_s", "flight.drag*"))
    return tuple(one.at(log.path.name) for one in found)


def _in_volts(flight: Flight, time_s: Array, volts: Array) -> Flight:
    """Return a flight whose drives are commands times the battery's volts (k,), at times since its first drive."""
    at_s = STEP_S * (np.arange(len(flight.drive)) + 0.5)  # the middle of the step over which each command is averaged
    volts = np.interp(at_s, time_s, volts)
    return replace(flight, drive=flight.drive * volts[:, np.newaxis], in_volts=True, volts=volts)


def _unseen(timed: Sequence[Array], row_s: Array) -> tuple[Mask, tuple[str, ...]]:
    """Return the rows (m,) in long gaps of some channel, and a sentence on them; `timed` are the channels' times."""
    unseen = np.zeros(len(row_s), bool)
    for time_s in timed:
        for place in np.flatnonzero(np.diff(time_s) > SLOWEST_S):
            unseen |= (row_s > time_s[place] - ROW_S) & (row_s < time_s[place + 1] + ROW_S)
    lost_s = ROW_S * int(np.count_nonzero(unseen))
    text = (
        f"{lost_s:.3g} s in gaps without rows, or with rows that have no command or reading (above "
        f"{1e3 * SLOWEST_S:.0f} ms), and what follows, are left out."
    )
    return unseen, (text,) if unseen.any() else ()


def _beyond(time_s: Array, rates: Array, row_s: Array, driven: Mask) -> tuple[Mask | None, list[Finding]]:
    """Return rows (m,) at which a gyro was at an end of its range, None if it never was, and a finding on them.

    Where less than 5 s of the rows that are `driven` (m,) would remain, the quantities that depend on rates are
    rejected.
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


def _refuse_other_motors(log: Recording) -> None:
    if others := moving_others(log):
        raise FitError(
            f"{log.path}: there are commands of {', '.join(others)} besides those of the motors m1 to m4, "
            f"{len(MOTORS) + len(others)} in all: thrust and moments are fitted, and flights predicted, for "
            "quadrocopters alone."
        )


def _check_weight(force: Array, path: Path) -> None:
    """Raise DataError where specific forces (n, 3) under running motors are not about 1 g, or point down."""
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
