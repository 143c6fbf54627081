"""Find the channels of a log that a flight needs, by the names autopilots use, at the times of the flight's rows.

Whatever the autopilot's axes are, the results are along x forward, y left, z up.
"""

import re
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from cfid.counted import counted
from cfid.errors import DataError
from cfid.flight.rows import ROW_S, STEP_S
from cfid.recordings import supply
from cfid.recordings.crazyflie import Timed, channel, first_of, si_values, times_in
from cfid.recordings.limits import other_scale
from cfid.recordings.recording import Recording, Series
from cfid.units import FULL_COMMAND, MOTORS

Array = npt.NDArray[np.float64]
_Sensor = tuple[tuple[str, ...], tuple[float, ...], float | None]

_COMMANDS = ("motor.m{}", "pwm.m{}_pwm", "pwm.m{}", "control.m{}")
_VOLTS = ("pm.vbat", "pm.vbatMV")
_LIKE_VOLTS = re.compile(r"(?:v_?bat|batt(?:ery)?|voltage)(?:\W.*|_?m?v|_?voltage)?", re.IGNORECASE)
_FURTHER = re.compile(r"(?:motor|control)\[(?:[4-9]|1\d)\]|(?:motor|pwm|control)\.m(?:[5-9]|1\d)")
_OUTPUT = re.compile(r"motor\[[0-3]\]")  # of a blackbox log
_WRONG_SHARE = 0.1  # of the voltage's values: if more are wrong, the whole channel is not used
_DOWN = (1.0, -1.0, -1.0)  # of PX4's axes: x forward, y right, z down
_UP = (1.0, 1.0, 1.0)
_UNFILTERED = ("gyroUnfilt[0]", "gyroUnfilt[1]", "gyroUnfilt[2]")  # the only rates in some blackbox logs
# The names of sensors in order of preference, with the signs that convert their axes to forward, left and up, and the
# cut-off in Hz of the second-order Butterworth filter that the Crazyflie's firmware applies before its log.
_RATES: tuple[_Sensor, ...] = (
    (("gyro.x", "gyro.y", "gyro.z"), _UP, 80.0),
    (("imu_gyro_x", "imu_gyro_y", "imu_gyro_z"), _UP, 80.0),
    (("gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]"), _DOWN, None),
    (("gyroADC[0]", "gyroADC[1]", "gyroADC[2]"), _UP, None),
    (_UNFILTERED, _UP, None),
)
_FORCES: tuple[_Sensor, ...] = (
    (("acc.x", "acc.y", "acc.z"), _UP, 30.0),
    (("accelerometer_m_s2[0]", "accelerometer_m_s2[1]", "accelerometer_m_s2[2]"), _DOWN, None),
    (("accSmooth[0]", "accSmooth[1]", "accSmooth[2]"), _UP, None),
)
_OF_PX4 = ("xyz[0]", "xyz[1]", "xyz[2]")  # of many of its topics
_VELOCITY, _QUATERNION = ("vx", "vy", "vz"), ("qw", "qx", "qy", "qz")  # of motion capture, in the world's axes
_TELLING = 100  # rows of commands that suffice to recognize a flight


def command_names(log: Recording) -> list[str]:
    """Return the channel names of the commands of motors 1 to 4. Raises DataError where one is missing."""
    names = [first_of(log, _COMMANDS, motor) for motor in MOTORS]
    missing = [f"motor.m{motor}" for motor, name in zip(MOTORS, names, strict=True) if name is None]
    if missing:
        raise DataError(f"{log.path}: {_without_commands(log, missing)}")
    return [name for name in names if name is not None]


def _without_commands(log: Recording, missing: Sequence[str]) -> str:
    """Return which motors' commands a log lacks, and what to do about it."""
    needed = "a flight's thrust is that of all four motors"
    if "ULog of PX4" in log.facts.program:
        return (
            f"no topic actuator_motors, and {needed}: PX4 has it from 1.13 on. Log it with the high rate of "
            "SDLOG_PROFILE."
        )
    if "blackbox log of" in log.facts.program:
        outputs = [name for one in log.series.values() for name in one.names if _OUTPUT.fullmatch(name)]
        if len(set(outputs)) == len(MOTORS):
            return (
                f"no header motorOutput with the range of {outputs[0]} to {outputs[-1]}, and {needed}: what an output "
                "is of the full command is not known. Log with a firmware that writes it."
            )
        return f"no motor[0] to motor[3], and {needed}: log them (blackbox_disable_motors = OFF)."
    return f"no {', '.join(missing)}: {needed}. Give the columns of a table these names."


def moving_others(log: Recording) -> list[str]:
    """Return the names of motors beyond m1 to m4, in the same series, that run at any time in the log."""
    series = log.holding(command_names(log)[0])
    further = [column for column in series.columns if _FURTHER.fullmatch(column.name)]
    return [column.name for column in further if np.any(np.nan_to_num(column.values))]


def commands_of(log: Recording) -> list[Timed]:
    """Return the times (n,) and commands (n,), 0 to 65535, of each motor. Raises DataError for other units."""
    found = [channel(log, name) for name in command_names(log)]
    most = max(float(np.nanmax(command, initial=0.0)) for _, command in found)
    if (scale := other_scale(most)) is not None:
        raise DataError(
            f"{log.path}: commands of at most {most:.3g}, where full thrust is {FULL_COMMAND:g}: are they {scale}? "
            "Scale the motors' columns."
        )
    return found


def same_flight(one: Recording, other: Recording) -> bool:
    """Return whether two logs of any kind record the same flight, by their commands.

    Rows of four 16-bit numbers do not repeat by chance in another flight.
    """
    sets = [_command_rows(log) for log in (one, other)]
    fewest = min(map(len, sets))
    return fewest >= _TELLING and len(sets[0] & sets[1]) > fewest / 2


def _command_rows(log: Recording) -> set[bytes]:
    """Return the distinct rows of commands, as whole numbers, in which the four commands are not all equal."""
    commands = commands_of(log)
    if len({len(command) for _, command in commands}) > 1:
        return set()
    rows = np.rint(np.column_stack([command for _, command in commands]))
    rows = rows[np.isfinite(rows).all(axis=1) & (np.ptp(rows, axis=1) > 0)]
    return {row.tobytes() for row in rows.astype(np.int64)}


def rates_of(log: Recording) -> tuple[tuple[Array, Array], float | None]:
    """Return times (n,) and rates (n, 3) in rad/s, and the cut-off of their filter in Hz, None where unknown."""
    return _sensor(log, _RATES, "vehicle_angular_velocity", "rates", "rad/s")


def unit_of_rates(log: Recording) -> str:
    """Return the unit in which the log's rates are read, "" where there are none."""
    there = {column.name: column for series in log.series.values() for column in series.columns}
    return next((there[names[0]].unit for names, _, _ in _RATES if set(names) <= set(there)), "")


def forces_of(log: Recording) -> tuple[tuple[Array, Array], float | None]:
    """Return times (n,) and specific forces (n, 3) in m/s^2, and their filter's cut-off as in `rates_of`."""
    return _sensor(log, _FORCES, "vehicle_acceleration", "accelerations", "m/s^2")


def _sensor(
    log: Recording, kinds: Sequence[_Sensor], topic: str, what: str, unit: str
) -> tuple[tuple[Array, Array], float | None]:
    """Return a sensor's times (n,) and values (n, 3) along the vehicle's axes, and the cut-off of its filter in Hz."""
    for names, signs, low_pass_hz in (*kinds, (_OF_PX4, _DOWN, None)):
        for series in _from_that_of_commands(log):
            if set(names) <= set(series.names) and (names is not _OF_PX4 or series.name == topic):
                values = np.column_stack(
                    [sign * series.si(name, unit) for name, sign in zip(names, signs, strict=True)]
                )
                known = np.isfinite(values).all(axis=1)
                if np.count_nonzero(known) > 1:
                    return (times_in(log, series)[known], values[known]), low_pass_hz
    raise DataError(f"{log.path}: no {what} along three axes (as {', '.join(kinds[0][0])}).")


def _from_that_of_commands(log: Recording) -> list[Series]:
    """Return a recording's series, first that of the commands: others may be of another flight."""
    commanded = log.holding(command_names(log)[0])
    return [commanded, *(series for series in log.series.values() if series is not commanded)]


def motion(log: Recording, at_s: Array) -> tuple[Array | None, Array | None]:
    """Return velocity (m, 3) in the world's axes and attitude (m, 4) of motion capture, None where there is none."""
    for series in log.series.values():
        if {*_VELOCITY, *_QUATERNION} <= set(series.names):
            time_s = times_in(log, series)
            velocity = np.column_stack([np.interp(at_s, time_s, si_values(series.column(name))) for name in _VELOCITY])
            attitude = np.column_stack([series.column(name).values for name in _QUATERNION])
            flips = np.cumprod(np.where(np.sum(attitude[1:] * attitude[:-1], axis=1) < 0, -1.0, 1.0))
            attitude[1:] *= flips[:, np.newaxis]
            attitude = np.column_stack([np.interp(at_s, time_s, column) for column in attitude.T])
            return velocity, attitude / np.linalg.norm(attitude, axis=1)[:, np.newaxis]
    return None, None


def volts_of(log: Recording) -> tuple[tuple[Array, Array] | None, tuple[str, ...]]:
    """Return times and the battery's voltage (n,), None where it is not known, and sentences on what is not used.

    Single values that no battery has, or that are far from the others, are left out.
    """
    name = first_of(log, _VOLTS)
    if name is None:
        return None, _may_be_volts(log)
    time_s, volts = channel(log, name)
    there = np.isfinite(volts)
    wrong = supply.impossible(volts)
    if not there.any():
        return None, (f"'{name}' has no number: no voltage is used.",)
    limits = f"which no battery is ({supply.RANGE_V[0]:g} to {supply.RANGE_V[1]:g} V)"
    if np.count_nonzero(wrong) > _WRONG_SHARE * np.count_nonzero(there):
        middle = float(np.median(volts[wrong]))
        unit = " Is it in mV? State it in the header of a table, as in pm.vbat [mV]." if middle > 1e3 else ""
        return None, (f"'{name}' is {middle:.4g} V, {limits}: no voltage is used.{unit}",)
    known = there & ~wrong
    values, first = counted(int(np.count_nonzero(wrong)), "value"), float(volts[np.argmax(wrong)])
    if supply.RANGE_V[0] < first < supply.RANGE_V[1]:
        limits = f"where the others are about {np.median(volts[known]):.3g} V"
    text = f"{values} of '{name}', the first {first:.4g} V, {limits}: left out."
    return (time_s[known], volts[known]), (text,) if wrong.any() else ()


def _may_be_volts(log: Recording) -> tuple[str, ...]:
    """Return a sentence on a column of a table that may be the voltage although it has another name."""
    names = [column.name for series in log.series.values() for column in series.columns]
    may_be = next((name for name in names if _LIKE_VOLTS.fullmatch(name)), None)
    return () if may_be is None else (f"column '{may_be}' is not used: if it is the voltage, call it pm.vbat.",)


def held(time_s: Array, command: Array, at_s: Array) -> Array:
    """Return the mean command (n,) over each step; a logged command (k,) holds until the log's next row."""
    total = np.concatenate([[0.0], np.cumsum(command[:-1] * np.diff(time_s))])
    edges = np.append(at_s, at_s[-1] + STEP_S)
    place = np.clip(np.searchsorted(time_s, edges, side="right") - 1, 0, len(time_s) - 1)
    gone = total[place] + command[place] * (edges - time_s[place])
    return np.asarray(np.diff(gone) / STEP_S)


def at_rows(time_s: Array, values: Array, row_s: Array, *, averaged: bool) -> Array:
    """Return values (m, 3) at rows: means over each row's 10 ms, or interpolated."""
    if not averaged:
        return np.column_stack([np.interp(row_s, time_s, column) for column in values.T])
    later = np.append(True, np.diff(np.maximum.accumulate(time_s)) > 0)
    time_s, values = time_s[later], values[later]
    total = CubicSpline(time_s, values).antiderivative()  # straight lines between rows of 2 ms lose 1 % at 20 Hz
    low, high = (np.clip(row_s + side * ROW_S / 2, time_s[0], time_s[-1]) for side in (-1, 1))
    return np.asarray((total(high) - total(low)) / ROW_S)
