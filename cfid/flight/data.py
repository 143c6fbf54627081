"""Read flights from logs: commands, rates, specific forces, velocity and voltage along the vehicle's axes.

Channels are found by the names that autopilots use. Each reading counts once, single impossible values are left out,
and everything is brought to the rows of a `Flight`, whose axes are x forward, y left, z up.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from cfid.counted import counted
from cfid.errors import ConfigError, DataError, FitError
from cfid.estimate.held_readings import Readings, once_each
from cfid.findings import Finding, finding, note, rejection, warning
from cfid.flight.airborne import EDGE_S, in_air, late, without_touches
from cfid.flight.capture import motion_of, refuse_unlike_gyro, velocity_findings
from cfid.flight.rows import AXES, ROW_S, ROW_STEPS, STEP_S, Flight, segments
from cfid.recordings import supply
from cfid.recordings.crazyflie import Timed, between, channel, findings_in, first_of, times_in
from cfid.recordings.gyro import at_end_of_range
from cfid.recordings.limits import (
    COMMANDS,
    FORCES,
    RATES,
    SPEEDS,
    Limits,
    other_scale,
    refuse_repeated_times,
    without_hung,
)
from cfid.recordings.read import read_recording
from cfid.recordings.recording import Recording
from cfid.units import DEAD_COMMAND, FULL_COMMAND, MOTORS, RPM, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
_Sensor = tuple[tuple[str, ...], tuple[float, ...], float | None]

GYRO, ACCELEROMETER = "gyro", "accelerometer"
_LATE_KEYS = {GYRO: "flight.delay_s", ACCELEROMETER: "flight.single_lag_s"}  # contain that readings are late
_COMMANDS = ("motor.m{}", "pwm.m{}_pwm", "pwm.m{}", "control.m{}")
_SPEEDS = ("motor.m{}_rpm", "rpm.m{}")
_NO_SPEED_RAD_S = FULL_COMMAND * RPM  # 65535 rpm in a row for which a Crazyflie's motor controller sent nothing
_VOLTS = ("pm.vbat", "pm.vbatMV")
_FURTHER = re.compile(r"(?:motor|control)\[(?:[4-9]|1\d)\]|(?:motor|pwm|control)\.m(?:[5-9]|1\d)")
_DOWN = (1.0, -1.0, -1.0)  # of PX4's axes: x forward, y right, z down
_UP = (1.0, 1.0, 1.0)
# The names of sensors in order of preference, with the signs that convert their axes to forward, left and up, and the
# cut-off in Hz of the second-order Butterworth filter that the Crazyflie's firmware applies before its log. Names of
# several topics of PX4 count in the one named.
_OF_PX4 = ("xyz[0]", "xyz[1]", "xyz[2]")
_RATES: tuple[_Sensor, ...] = (
    (("gyro.x", "gyro.y", "gyro.z"), _UP, 80.0),
    (("imu_gyro_x", "imu_gyro_y", "imu_gyro_z"), _UP, 80.0),
    (("gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]"), _DOWN, None),
    (("gyroADC[0]", "gyroADC[1]", "gyroADC[2]"), _UP, None),
    (("gyroUnfilt[0]", "gyroUnfilt[1]", "gyroUnfilt[2]"), _UP, None),
    (_OF_PX4, _DOWN, None),
)
_FORCES: tuple[_Sensor, ...] = (
    (("acc.x", "acc.y", "acc.z"), _UP, 30.0),
    (("accelerometer_m_s2[0]", "accelerometer_m_s2[1]", "accelerometer_m_s2[2]"), _DOWN, None),
    (("accSmooth[0]", "accSmooth[1]", "accSmooth[2]"), _UP, None),
    (_OF_PX4, _DOWN, None),
)

_SLOWEST_S = 0.021  # the largest time between rows of a sensor: with more, changes of the rates are missed
_OTHER_UNIT_S = 0.5  # between rows, 1000 times the longest that autopilots log
_AVERAGED_S = ROW_S / 2  # between rows of a sensor: if they are closer, they are averaged
_MOST_S = 600.0  # of a flight
_AROUND_S = 5.0  # of rows that are kept before and after, for channels that are logged rarely
_COMMANDS_APART_S = 0.005  # farther apart, the autopilot's commands in between are unknown
_SENSORS_APART_S = 0.012  # for quantities that depend on how fast a sensor responds
_HELD_S = 0.003  # the longest time for which commands are held without a finding: drives have steps of 2 ms
_WRONG_SHARE = 0.1  # of the voltage's values: if more are wrong, the whole channel is not used
_WEIGHT = (0.2, 5.0)  # of gravity: outside these limits, the accelerometer's unit or direction is another
_WILD_SHARE = 0.02  # of the gyro's rows: public logs have none beyond a gyro's range, 6 to 80 % where read in degrees
# Rows are left out for this time after a motor left its range or commands are missing: until then, the rotors still
# follow what happened before.
_SETTLING_S = 0.3
_FEWEST = 500  # rows: 5 s, the least that a gyro has to show of the rotation about an axis
_AT_END_S = 2 * ROW_S  # around an end of the gyro's range: the means of these rows contain a part of it
_SAME_ROWS = 100  # rows of commands that suffice to recognize a flight


@dataclass(frozen=True, kw_only=True, eq=False)
class FlownLog:
    """A log with its flight, and findings about reading it.

    `voltmeter` is the battery's voltage (k,) as logged, at times since the flight's first command.
    """

    log: Recording
    flight: Flight
    findings: tuple[Finding, ...]
    voltmeter: Timed | None = None

    @property
    def by_command(self) -> Flight:
        """The flight with the commands relative to full command as its drives, whether the voltage is known or not."""
        return self.flight if self.flight.volts is None else replace(self.flight, volts=None)

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

    Raises DataError for a log that lacks commands and speeds of all motors, rates or accelerations, or is sampled too
    slowly, FitError for one of a vehicle with other than four motors.
    """
    return flight_of(read_recording(path), from_s=from_s, to_s=to_s, props_out=props_out)


def flight_of(
    whole: Recording, *, from_s: float | None = None, to_s: float | None = None, props_out: bool = False
) -> FlownLog:
    """Extract the flight from a log that has been read, as in `read_flight`."""
    if props_out:
        whole = replace(whole, facts=replace(whole.facts, props_out=True))
    _refuse_other_motors(whole)
    first_s = channel(whole, drive_names(whole)[0]).time_s
    refuse_repeated_times(whole.path, first_s)
    _check_spacing(first_s, whole)
    begin_s, end_s = _window(first_s, whole.path, from_s or 0.0, np.inf if to_s is None else to_s)
    log = between(whole, begin_s - _AROUND_S, end_s + _AROUND_S)

    findings: list[Finding] = []
    commands, speeds, rates, forces, low_pass_hz = _signals(log, findings)
    speeds = _usable(speeds, log, findings, instead=bool(commands))
    drives = speeds or commands  # which carry the vehicle
    timed_s = [signal.time_s for signal in (*commands, *speeds, rates, forces)]
    begin_s, end_s = max(begin_s, *(time_s[0] for time_s in timed_s)), min(end_s, *(time_s[-1] for time_s in timed_s))
    _check_left(end_s - begin_s, log.path)
    rates, of_rates = _first_rows(rates)
    forces, of_forces = _first_rows(forces)
    timed_s = [signal.time_s for signal in (*drives, rates, forces)]
    for time_s in timed_s:
        _check_spacing(time_s, log)
    findings += [*_sensor_findings(GYRO, rates, of_rates), *_sensor_findings(ACCELEROMETER, forces, of_forces)]
    held_s = 0.0
    if not speeds:
        held_s, of_commands = _held_commands(commands, filled=bool(of_rates.age_s or of_forces.age_s))
        findings += of_commands

    rows = int((end_s - begin_s) / ROW_S)
    row_s = np.asarray(begin_s + ROW_S * np.arange(rows), dtype=np.float64)
    step_s = np.asarray(begin_s + STEP_S * np.arange(rows * ROW_STEPS), dtype=np.float64)
    averaged = _apart_s(rates.time_s) < _AVERAGED_S
    command = np.column_stack([_held(motor, step_s) for motor in commands]) if commands else np.zeros((0, 4))
    force, rate = (at_rows(*sensor, row_s, averaged=averaged) for sensor in (forces, rates))
    of_rows = np.column_stack([_held(motor, step_s)[::ROW_STEPS] for motor in drives])
    running = (of_rows > 0).all(axis=1)
    _check_units(log.path, force[running], rates.value[np.interp(rates.time_s, row_s, running) == 1])
    unseen = _in_gaps(timed_s, row_s, findings)
    airborne = in_air(of_rows, force, rate) & ~unseen
    within = ~unseen
    if commands:
        within &= np.all((command > DEAD_COMMAND) & (command < FULL_COMMAND), axis=1)[::ROW_STEPS]
    velocity, attitude = motion_of(log, row_s)
    voltmeter = _voltmeter(log, begin_s, findings)
    flight = Flight(
        name=log.path.stem,
        command=command / FULL_COMMAND,
        rates=rate,
        force=force,
        airborne=airborne,
        driven=airborne & ~late(~within, _SETTLING_S),
        beyond=_beyond(rates, row_s),
        averaged=averaged,
        low_pass_hz=low_pass_hz,
        ages_s=(of_forces.age_s, of_rates.age_s),
        held_s=held_s,
        velocity=velocity,
        attitude=attitude,
        # In the middle of the step over which each command is averaged.
        volts=None if voltmeter is None else np.interp(step_s - begin_s + STEP_S / 2, *voltmeter),
        speeds=_together(speeds, begin_s) if speeds else None,
        props_out=log.facts.props_out is True,
    )
    flight, touches = without_touches(flight, begin_s=begin_s - first_s[0])
    refuse_unlike_gyro(log.path, flight)
    findings += [*touches, *_clipped_findings(rates, flight), *velocity_findings(flight)]
    if log.facts.clock == "unknown":
        findings.append(finding("gyro-clock-undecided", "flight.inertia_kg_m2.*", "flight.*_s", "flight.drag*"))
    return FlownLog(
        log=whole,
        flight=flight,
        voltmeter=voltmeter,
        findings=(*findings_in(whole), *(each.at(whole.path.name) for each in findings)),
    )


def _usable(speeds: list[Timed], log: Recording, findings: list[Finding], *, instead: bool) -> list[Timed]:
    """Return the speeds without rows that have none, or nothing where commands are followed `instead`.

    PX4 logs speeds rarely by default, and a motor's controller that sends none leaves 65535 in a Crazyflie's log.
    Raises DataError for a speed that stands still where there are no commands.
    """
    missing = ", ".join(f"m{motor}" for motor in MOTORS if first_of(log, _SPEEDS, motor) is None)
    fault = f"the speed of {missing} is missing" if missing and any(first_of(log, _SPEEDS, m) for m in MOTORS) else ""
    if any(np.ptp(motor.value) == 0 for motor in speeds):
        fault = "a rotor's speed stands still all the time"
    if fault and not instead:
        raise DataError(f"{log.path}: {fault}, and there are no commands instead.")
    if fault:
        text = f"{fault}: commands are followed. Log the speeds of all four, and see that all controllers send them."
        findings.append(warning("flight-speeds-unused", text))
    if fault or (instead and any(_apart_s(motor.time_s) > _SLOWEST_S for motor in speeds)):
        return []
    sent = [~np.isclose(motor.value, _NO_SPEED_RAD_S) for motor in speeds]
    return [Timed(motor.time_s[known], motor.value[known]) for motor, known in zip(speeds, sent, strict=True)]


def drive_names(log: Recording) -> list[str]:
    """Return the names of the channels of motors 1 to 4: their commands, or where one is missing their speeds.

    Raises DataError where there is neither.
    """
    if names := _of_all_motors(log, _COMMANDS) or _of_all_motors(log, _SPEEDS):
        return names
    missing = ", ".join(f"motor.m{motor}" for motor in MOTORS if first_of(log, _COMMANDS, motor) is None)
    remedy = f"no {missing}. Give the columns of a table these names."
    if "ULog of PX4" in log.facts.program:
        remedy = "no topic actuator_motors: PX4 has it from 1.13 on. Log it with the high rate of SDLOG_PROFILE."
    if "blackbox log of" in log.facts.program:
        remedy = (
            "no motor[0] to motor[3] with a header motorOutput, which states their range: log them "
            "(blackbox_disable_motors = OFF)."
        )
    raise DataError(f"{log.path}: a flight's thrust is that of all four motors, and there is {remedy}")


def _of_all_motors(log: Recording, patterns: Sequence[str]) -> list[str]:
    """Return the names of the channels of motors 1 to 4, none where one is missing."""
    names = [name for motor in MOTORS if (name := first_of(log, patterns, motor)) is not None]
    return names if len(names) == len(MOTORS) else []


def same_flight(log: Recording, other: Recording) -> bool:
    """Return whether two logs of any kind record the same flight, by their commands.

    Rows of four 16-bit numbers do not repeat by chance in another flight.
    """
    sets = [_command_rows(each) for each in (log, other)]
    fewest = min(map(len, sets))
    return fewest >= _SAME_ROWS and len(sets[0] & sets[1]) > fewest / 2


def at_rows(time_s: Array, values: Array, row_s: Array, *, averaged: bool) -> Array:
    """Return values (m, 3) at rows: means over each row's 10 ms, or interpolated."""
    if not averaged:
        return np.column_stack([np.interp(row_s, time_s, column) for column in values.T])
    later = np.append(True, np.diff(np.maximum.accumulate(time_s)) > 0)
    time_s, values = time_s[later], values[later]
    total = CubicSpline(time_s, values).antiderivative()  # straight lines between rows of 2 ms lose 1 % at 20 Hz
    low, high = (np.clip(row_s + side * ROW_S / 2, time_s[0], time_s[-1]) for side in (-1, 1))
    return np.asarray((total(high) - total(low)) / ROW_S)


def _refuse_other_motors(log: Recording) -> None:
    """Raise FitError where motors beyond m1 to m4 run at any time in the series of the commands."""
    series = log.holding(drive_names(log)[0])
    further = [column for column in series.columns if _FURTHER.fullmatch(column.name)]
    others = [column.name for column in further if np.any(np.nan_to_num(column.values))]
    if others:
        raise FitError(
            f"{log.path}: there are commands of {', '.join(others)} besides those of the motors m1 to m4, "
            f"{len(MOTORS) + len(others)} in all: thrust and moments are fitted, and flights predicted, for "
            "quadrocopters alone."
        )


def _window(time_s: Array, path: Path, from_s: float, to_s: float) -> tuple[float, float]:
    """Return the first and last time of the rows (n,) to fit. Raises ConfigError for too long or too short a window."""
    begin, end = float(time_s[0]) + from_s, float(min(time_s[-1], time_s[0] + to_s))
    _check_left(end - begin, path)
    if end - begin > _MOST_S:
        raise ConfigError(f"{path}: {end - begin:.0f} s at once (limit {_MOST_S:g} s): give `from_s` and `to_s`.")
    return begin, end


def _check_left(left_s: float, path: Path) -> None:
    if not left_s > 2 * EDGE_S:
        raise ConfigError(f"{path}: {max(left_s, 0.0):.3g} s are left of the log (limit {2 * EDGE_S:g} s).")


def _check_spacing(time_s: Array, log: Recording) -> None:
    """Raise DataError for readings at times (n,) too far apart to follow rates."""
    if len(time_s) < 2 or (apart_s := _apart_s(time_s)) <= _SLOWEST_S:
        return
    other = " If times are in a smaller unit, import the table with `unit`." if apart_s >= _OTHER_UNIT_S else ""
    raise DataError(
        f"{log.path}: readings {1e3 * apart_s:.0f} ms apart (limit {1e3 * _SLOWEST_S:.0f} ms): log motors, gyro and "
        f"accelerometer every 10 ms at least (PX4: the high rate of SDLOG_PROFILE).{other}"
    )


def _apart_s(time_s: Array) -> float:
    """Return the usual time between rows at times (n,)."""
    return float(np.median(np.diff(time_s)))


def _signals(
    log: Recording, findings: list[Finding]
) -> tuple[list[Timed], list[Timed], Timed, Timed, tuple[float | None, float | None]]:
    """Return commands and speeds of each motor, rates (n, 3), specific forces (n, 3), and both sensors' filters.

    Of commands and speeds, one may be missing. Impossible values and rows in which a sensor hung are left out, and are
    then in `findings`. A missing command is not replaced by the one before: what the motor did without it is unknown,
    so the row is treated as missing.
    """
    speeds = {name: channel(log, name) for name in _of_all_motors(log, _SPEEDS)}
    motors = []
    for named, limits in ((_commands_of(log), COMMANDS), (speeds, SPEEDS)):
        motors.append([_known(log, name, motor, limits, findings) for name, motor in named.items()])
    rates, rates_hz = _sensor(log, _RATES, "vehicle_angular_velocity", "rates", "rad/s")
    forces, forces_hz = _sensor(log, _FORCES, "vehicle_acceleration", "accelerations", "m/s^2")
    sensors = {
        GYRO: _possible(rates, RATES, GYRO, findings),
        ACCELEROMETER: _possible(forces, FORCES, ACCELEROMETER, findings),
    }
    (rates_left, forces_left), hung = without_hung(sensors)
    findings += hung
    return motors[0], motors[1], Timed(*rates_left), Timed(*forces_left), (forces_hz, rates_hz)


def _known(log: Recording, name: str, motor: Timed, limits: Limits, findings: list[Finding]) -> Timed:
    """Return a motor's values (n,) that are numbers and possible. Raises DataError where there is none."""
    known = np.isfinite(motor.value)
    if not known.any():
        raise DataError(f"{log.path}: '{name}' has no number: a flight's thrust is that of all four motors.")
    return _possible(Timed(motor.time_s[known], motor.value[known]), limits, name, findings)


def _together(speeds: Sequence[Timed], begin_s: float) -> Timed:
    """Return the speeds (k, 4) at the times of the first motor's, since `begin_s`, each in the middle of its step.

    Telemetry counts the whole steps of a rotor's period, so that a speed is between the one that is shown and the next
    smaller one of the log; where speeds have no steps, that is hardly another.
    """
    time_s = np.unique(speeds[0].time_s)
    columns = []
    for motor in speeds:
        steps, place = np.unique(np.abs(motor.value), return_inverse=True)
        steps[1:] = (steps[1:] + steps[:-1]) / 2
        columns.append(np.interp(time_s, motor.time_s, steps[place]))
    return Timed(time_s - begin_s, np.column_stack(columns))


def _commands_of(log: Recording) -> dict[str, Timed]:
    """Return the times (n,) and commands (n,), 0 to 65535, of each motor by name. Raises DataError for other units."""
    commands = {name: channel(log, name) for name in _of_all_motors(log, _COMMANDS)}
    most = max((float(np.nanmax(motor.value, initial=0.0)) for motor in commands.values()), default=0.0)
    if (scale := other_scale(most)) is not None:
        raise DataError(
            f"{log.path}: commands of at most {most:.3g}, where full thrust is {FULL_COMMAND:g}: are they {scale}? "
            "Scale the motors' columns."
        )
    return commands


def _command_rows(log: Recording) -> set[bytes]:
    """Return the distinct rows of commands or speeds, as whole numbers, in which the four are not all equal."""
    commands = [channel(log, name).value for name in drive_names(log)]
    if len(set(map(len, commands))) > 1:
        return set()
    rows = np.rint(np.column_stack(commands))
    rows = rows[np.isfinite(rows).all(axis=1) & (np.ptp(rows, axis=1) > 0)]
    return {row.tobytes() for row in rows.astype(np.int64)}


def _sensor(log: Recording, kinds: Sequence[_Sensor], topic: str, what: str, unit: str) -> tuple[Timed, float | None]:
    """Return a sensor's values (n, 3) along the vehicle's axes, and the cut-off of its filter in Hz, None if unknown.

    The series of the commands comes first: others may be of another flight.
    """
    commanded = log.holding(drive_names(log)[0])
    others = [series for series in log.series.values() if series is not commanded]
    for names, signs, low_pass_hz in kinds:
        for series in (commanded, *others):
            if set(names) <= set(series.names) and (names is not _OF_PX4 or series.name == topic):
                values = np.column_stack(
                    [sign * series.si(name, unit) for name, sign in zip(names, signs, strict=True)]
                )
                known = np.isfinite(values).all(axis=1)
                if np.count_nonzero(known) > 1:
                    return Timed(times_in(log, series)[known], values[known]), low_pass_hz
    raise DataError(f"{log.path}: no {what} along three axes (as {', '.join(kinds[0][0])}).")


def _possible(signal: Timed, limits: Limits, what: str, findings: list[Finding]) -> Timed:
    """Return values (n,) or (n, 3) without a few impossible rows, which are then in `findings`."""
    outside = limits.outside(signal.value)
    rows, known = (np.atleast_2d(mask.T) for mask in (outside, np.isfinite(signal.value)))
    wrong, count = rows.any(axis=0), int(np.count_nonzero(rows.any(axis=0)))
    if not limits.few(count, int(np.count_nonzero(known.all(axis=0)))):
        return signal
    findings.append(limits.left_out(what, count, float(signal.value[outside][0])))
    return Timed(signal.time_s[~wrong], signal.value[~wrong])


def _first_rows(sensor: Timed) -> tuple[Timed, Readings]:
    """Return those rows of a sensor that have a new reading, and the counts of rows and readings."""
    new, readings = once_each(*sensor)
    return Timed(sensor.time_s[new], sensor.value[new]), readings


def _sensor_findings(sensor: str, signal: Timed, readings: Readings) -> list[Finding]:
    """Return a note where rows repeat a sensor's readings, and a rejection where readings are far apart.

    Readings at times (n,) that are far apart do not show how fast the sensor responds.
    """
    findings = []
    key, apart_s, age_s = _LATE_KEYS[sensor], _apart_s(signal.time_s), readings.age_s
    if age_s:
        text = (
            f"the {sensor} has {readings.read} readings in {readings.rows} rows: the first row of each counts, and may "
            f"show it up to {1e3 * age_s:.3g} ms late, for which the standard uncertainty of {key} contains "
            f"{1e3 * age_s / math.sqrt(3):.2g} ms."
        )
        findings.append(note("flight-readings-repeated", text, key))
    if apart_s > _SENSORS_APART_S:
        text = (
            f"readings of the {sensor} are {1e3 * apart_s:.0f} ms apart (limit {1e3 * _SENSORS_APART_S:.0f} ms): lags "
            "come out several per cent long, and moments small where it is the accelerometer. Log them every 10 ms at "
            "least."
        )
        lost = ("flight.*_s", *(["flight.inertia_kg_m2.*"] * (sensor == ACCELEROMETER)))
        findings.append(rejection("flight-rows-apart", text, *lost))
    return findings


def _held_commands(commands: Sequence[Timed], *, filled: bool) -> tuple[float, list[Finding]]:
    """Return the time for which motors' commands are repeated, 0 if they are not, and findings on their distance.

    In a `filled` log, sensors' readings are repeated too, so that the commands in between were not logged. If each row
    has a new reading, the log does not show whether the autopilot holds the commands or only the log does.
    """
    time_s = commands[0].time_s
    same_series = np.column_stack([motor.value for motor in commands if len(motor.time_s) == len(time_s)])
    new, readings = once_each(time_s, same_series)
    changed_s = _apart_s(time_s[new])
    apart_s = changed_s if filled else _apart_s(time_s)
    findings = []
    if apart_s > _COMMANDS_APART_S:
        text = (
            f"commands are {1e3 * apart_s:.0f} ms apart (limit {1e3 * _COMMANDS_APART_S:.0f} ms): those between are "
            "not seen, and lags come out up to twice as long. Log them at 500 Hz for lags."
        )
        findings.append(rejection("flight-rows-apart", text, "flight.*_s"))
    if filled or not readings.age_s or changed_s <= _HELD_S:
        return 0.0, findings
    text = (
        f"commands are repeated for {1e3 * changed_s:.2g} ms, while sensors go on. If the log alone holds them, and "
        f"the autopilot changes them more often, delays come out up to {1e3 * changed_s / 2:.2g} ms short, and lags "
        "some per cent long: the standard uncertainty of flight.delay_s contains "
        f"{1e3 * changed_s / 2 / math.sqrt(3):.2g} ms for that. Log every command."
    )
    lost = "flight.delay_s", "flight.rising_s", "flight.falling_s"
    return changed_s, [*findings, warning("flight-commands-held", text, *lost)]


def _held(motor: Timed, at_s: Array) -> Array:
    """Return the mean command (n,) over each step; a logged command (k,) holds until the log's next row."""
    time_s, command = motor
    total = np.concatenate([[0.0], np.cumsum(command[:-1] * np.diff(time_s))])
    edges = np.append(at_s, at_s[-1] + STEP_S)
    place = np.clip(np.searchsorted(time_s, edges, side="right") - 1, 0, len(time_s) - 1)
    gone = total[place] + command[place] * (edges - time_s[place])
    return np.asarray(np.diff(gone) / STEP_S)


def _check_units(path: Path, force: Array, rates: Array) -> None:
    """Raise DataError where, under running motors, specific forces (n, 3) or rates (k, 3) are no flight's."""
    if len(force):
        size = float(np.median(force[:, 2])) / USUAL_GRAVITY_MPS2
        if not _WEIGHT[0] < size < _WEIGHT[1]:
            raise DataError(
                f"{path}: the acceleration along z is {size:.2g} g while the motors run, where a flight has about 1: "
                "state its unit in the header of a table, as in acc.z [m/s^2], and turn the axes to x forward, y left, "
                "z up.",
                code="other-acceleration",
            )
    if len(rates) and np.mean(RATES.outside(rates).any(axis=1)) > _WILD_SHARE:
        raise DataError(
            f"{path}: the gyro turns by up to {math.degrees(float(np.abs(rates).max())):.0f} deg/s while the motors "
            "run, and gyros end at 2000: state its unit in the header of a table, as in gyro.x [deg/s].",
            code="other-rate",
        )


def _in_gaps(timed_s: Sequence[Array], row_s: Array, findings: list[Finding]) -> Mask:
    """Return the rows (m,) in long gaps of any channel, which are then in `findings`."""
    unseen = np.zeros(len(row_s), bool)
    for time_s in timed_s:
        for place in np.flatnonzero(np.diff(time_s) > _SLOWEST_S):
            unseen |= (row_s > time_s[place] - ROW_S) & (row_s < time_s[place + 1] + ROW_S)
    if unseen.any():
        text = (
            f"{ROW_S * np.count_nonzero(unseen):.3g} s in gaps without rows, or with rows that have no command or "
            f"reading (above {1e3 * _SLOWEST_S:.0f} ms), and what follows, are left out."
        )
        findings.append(warning("recording", text))
    return unseen


def _beyond(rates: Timed, row_s: Array) -> Mask:
    """Return the rows (m,) at which a gyro was at an end of its range."""
    at_s = rates.time_s[_at_ends(rates.value).any(axis=1)]
    return np.searchsorted(at_s, row_s + _AT_END_S) > np.searchsorted(at_s, row_s - _AT_END_S)


def _at_ends(rates: Array) -> Mask:
    """Return which rates (n, 3) are those of an end of the gyro's range."""
    return np.column_stack([at_end_of_range(rate, rate) | at_end_of_range(rate, -rate) for rate in rates.T])


def _clipped_findings(rates: Timed, flight: Flight) -> list[Finding]:
    """Return a finding where a gyro reached an end of its range; a rejection where less than 5 s are left."""
    ends = _at_ends(rates.value)
    if not ends.any():
        return []
    reached = ", ".join(
        f"{np.degrees(np.abs(rate).max()):.0f} deg/s about {axis}"
        for axis, rate, end in zip(AXES, rates.value.T, ends.T, strict=True)
        if end.any()
    )
    rows = sum(each.stop - each.start for each in segments(flight.rates_known))
    text = (
        f"the gyro reached {reached}, the end of its range: {ROW_S * np.count_nonzero(flight.beyond):.3g} s are left "
        f"out of what rests on rates, and {ROW_S * rows:.1f} s are left (at least {ROW_S * _FEWEST:g} s). Set a larger "
        "range, or turn slower."
    )
    if rows < _FEWEST:
        return [rejection("flight-gyro-clipped", text, "flight.inertia_kg_m2.*", "flight.*_s")]
    return [warning("flight-gyro-clipped", text, "flight.inertia_kg_m2.*")]


def _voltmeter(log: Recording, begin_s: float, findings: list[Finding]) -> Timed | None:
    """Return the battery's voltage (n,) at times since `begin_s`, None where it is not known.

    Single values that no battery has, or that are far from the others, are left out, and are then in `findings`.
    """
    name = first_of(log, _VOLTS)
    if name is None:
        return None
    time_s, volts = channel(log, name)
    known, wrong = np.isfinite(volts), supply.impossible(volts)
    count, used = int(np.count_nonzero(wrong)), known & ~wrong
    unusable = count >= _WRONG_SHARE * np.count_nonzero(known)
    if count or unusable:
        low, high = supply.RANGE_V
        first = f", the first {float(volts[np.argmax(wrong)]):.4g} V," if count else ""
        text = (
            f"{counted(count, 'value')} of '{name}'{first} cannot be a battery's ({low:g} to {high:g} V) or are far "
            f"off the others, {counted(int(np.count_nonzero(used)), 'value')} can: "
        )
        text += "no voltage is used. State its unit, as in pm.vbat [mV]." if unusable else "the former are left out."
        findings.append(warning("recording", text))
    return None if unusable else Timed(time_s[used] - begin_s, volts[used])
