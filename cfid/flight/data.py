"""Logs of flights as drives, rates, specific forces and velocities along the vehicle's axes, and when it was flying.

Whatever the autopilot's axes, they become x forward, y left, z up.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, note, of_recording, warning
from cfid.flight.model import ROW_S, ROW_STEPS, STEP_S, Flight
from cfid.records.logs.any_kind import NO_OPTIONS, read_log
from cfid.records.logs.log import FlightLog
from cfid.records.logs.run import log_of_run
from cfid.records.tables.schema import Foreign, refuse_for_run
from cfid.records.tables.times import run_at
from cfid.units import DEAD_COMMAND, FULL_COMMAND, MOTORS, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
_Sensor = tuple[tuple[str, ...], tuple[float, ...], float | None]

_COMMANDS = ("motor.m{}", "pwm.m{}_pwm", "pwm.m{}", "control.m{}")
_VOLTS = ("pm.vbat", "pm.vbatMV")
_DOWN = (1.0, -1.0, -1.0)  # of PX4's axes: x forward, y right, z down
_UP = (1.0, 1.0, 1.0)
# What sensors are called, in order of preference, with the signs that turn them to forward, left and up, and the
# cut-off in Hz of the second-order Butterworth filter that the Crazyflie's firmware puts before its log.
_RATES: tuple[_Sensor, ...] = (
    (("gyro.x", "gyro.y", "gyro.z"), _UP, 80.0),
    (("imu_gyro_x", "imu_gyro_y", "imu_gyro_z"), _UP, 80.0),
    (("gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]"), _DOWN, None),
    (("gyroADC[0]", "gyroADC[1]", "gyroADC[2]"), _UP, None),
)
_FORCES: tuple[_Sensor, ...] = (
    (("acc.x", "acc.y", "acc.z"), _UP, 30.0),
    (("accelerometer_m_s2[0]", "accelerometer_m_s2[1]", "accelerometer_m_s2[2]"), _DOWN, None),
    (("accSmooth[0]", "accSmooth[1]", "accSmooth[2]"), _UP, None),
)
_OF_PX4 = ("xyz[0]", "xyz[1]", "xyz[2]")  # of many of its topics
_RATES_TOPIC, _FORCES_TOPIC = "vehicle_angular_velocity", "vehicle_acceleration"
_VELOCITY, _QUATERNION = ("vx", "vy", "vz"), ("qw", "qx", "qy", "qz")  # of motion capture, in the world's axes

_SLOWEST_S = 0.021  # between rows of a sensor: slower, rates change unseen
_AVERAGED_S = ROW_S / 2  # between rows of a sensor, below which they are averaged
_CLOSE_S = 0.005  # between commands: farther apart, those of an autopilot are guessed
_LIFTED = 0.8  # of the median sum of squared drives, above which the vehicle is in the air
_EDGE_S = 1.0  # from there on, and before its end: the ground's air, and touching it
_WEIGHT = (0.2, 5.0)  # of gravity, which a median specific force is nearly: beyond, its unit is another
_CRASH_MPS2 = 60.0
_STRUCK_S = 0.5  # around such a specific force
_SETTLING_S = 0.3  # after a motor left its range, in which rotors forget it
_TURNED = 34.0  # rad/s, near the range of the gyro, 2000 deg/s
_MOST_S = 600.0
_AROUND_S = 5.0  # of rows that are kept before and after, for channels that are logged rarely


@dataclass(frozen=True, kw_only=True, eq=False)
class FlownLog:
    """A log with its flight, and findings about reading it.

    `by_command` is the same flight with drives that are the command over the full one, whether volts are known or not.
    """

    log: FlightLog
    flight: Flight
    by_command: Flight
    findings: tuple[Finding, ...]

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

    Raises DataError for a log without commands of all motors, rates and accelerations, or sampled too slowly, and
    ConfigError for a `reading` beside a run.
    """
    run = run_at(path)
    if run is None:
        return flight_of(read_log(path, reading), from_s=from_s, to_s=to_s)
    refuse_for_run(path, reading)
    return flight_of(log_of_run(run), from_s=from_s, to_s=to_s)


def flight_of(log: FlightLog, *, from_s: float | None = None, to_s: float | None = None) -> FlownLog:
    """Take the flight out of a log that was read, as `read_flight`."""
    path = log.path
    names = [_first(log, _COMMANDS, motor) for motor in MOTORS]
    missing = [f"motor.m{motor}" for motor, name in zip(MOTORS, names, strict=True) if name is None]
    if missing:
        raise DataError(f"{path}: no {', '.join(missing)}: a flight's thrust is that of all four motors.")
    motors = [name for name in names if name is not None]
    from_s, to_s = _window(log.channel(motors[0])[0], path, from_s or 0.0, np.inf if to_s is None else to_s)
    around = from_s - _AROUND_S, to_s + _AROUND_S
    whole, log = log, replace(log, series=tuple(one.between(*around) for one in log.series))
    commands = [log.channel(name) for name in motors]
    rates, rates_hz = _sensor(log, _RATES, _RATES_TOPIC, "rates")
    forces, forces_hz = _sensor(log, _FORCES, _FORCES_TOPIC, "accelerations")
    timed = [one[0] for one in (*commands, rates, forces)]
    begin, end = max(from_s, *(float(one[0]) for one in timed)), min(to_s, *(float(one[-1]) for one in timed))
    _check_left(end - begin, path)
    slowest = max(float(np.median(np.diff(one))) for one in timed)
    if slowest > _SLOWEST_S:
        raise DataError(
            f"{path}: rows {1e3 * slowest:.0f} ms apart (limit {1e3 * _SLOWEST_S:.0f} ms): log motors, gyro and "
            "accelerometer every 10 ms at least (PX4: the high rate of SDLOG_PROFILE)."
        )
    rows = int((end - begin) / ROW_S)
    at_s = np.asarray(begin + STEP_S * np.arange(rows * ROW_STEPS), dtype=np.float64)
    command = np.column_stack([_held(*one, at_s) for one in commands])
    volts, faults = _volts(log, at_s)
    row_s = np.asarray(begin + ROW_S * np.arange(rows), dtype=np.float64)
    averaged = float(np.median(np.diff(rates[0]))) < _AVERAGED_S
    force = _at(*forces, row_s, averaged=averaged)
    spun = _at(*rates, row_s, averaged=averaged)
    velocity, attitude = _motion(log, row_s)
    if velocity is not None and attitude is not None:
        velocity = turned_back(attitude, velocity)
    share = command[::ROW_STEPS]
    _check_weight(force[(share > 0).all(axis=1)], path)
    unseen, gaps = _unseen(timed, row_s)
    airborne = _airborne(share, force, spun) & ~unseen
    within = ~unseen & ((share > DEAD_COMMAND) & (share < FULL_COMMAND)).all(axis=1)
    by_command = Flight(
        name=path.stem,
        drive=command / FULL_COMMAND,
        rates=spun,
        force=force,
        airborne=airborne,
        driven=airborne & ~_late(np.asarray(~within), _SETTLING_S),
        averaged=averaged,
        in_volts=False,
        low_pass_hz=(forces_hz, rates_hz),
        velocity=velocity,
        attitude=attitude,
    )
    flight = by_command
    if volts is not None:
        flight = replace(by_command, drive=by_command.drive * volts[:, np.newaxis], in_volts=True)
    return FlownLog(
        log=whole,
        flight=flight,
        by_command=by_command,
        findings=(
            *of_recording(path.name, log.notes),
            *(note("recording", f"assumed: {text}.").at(path.name) for text in log.assumed),
            *(warning("recording", text).at(path.name) for text in (*faults, *gaps)),
            *(one.at(path.name) for one in _between(commands[0][0])),
        ),
    )


def _between(time_s: Array) -> list[Finding]:
    """Return what commands at times (n,) that are far apart do to lags: an autopilot sends two to ten between them."""
    apart_s = float(np.median(np.diff(time_s)))
    if apart_s <= _CLOSE_S:
        return []
    text = (
        f"commands are {1e3 * apart_s:.0f} ms apart (limit {1e3 * _CLOSE_S:.0f} ms): those between are not seen, and "
        "lags can come out nearly twice as long. Log them at 500 Hz for lags."
    )
    return [warning("flight-commands-apart", text)]


def _unseen(timed: Sequence[Array], row_s: Array) -> tuple[Mask, tuple[str, ...]]:
    """Return the rows (m,) at which some channel is silent for long, and a sentence on them; `timed` are its times."""
    unseen = np.zeros(len(row_s), bool)
    for time_s in timed:
        for place in np.flatnonzero(np.diff(time_s) > _SLOWEST_S):
            unseen |= (row_s > time_s[place] - ROW_S) & (row_s < time_s[place + 1] + ROW_S)
    lost_s = ROW_S * int(np.count_nonzero(unseen))
    text = f"{lost_s:.3g} s in gaps without rows (above {1e3 * _SLOWEST_S:.0f} ms), and what follows, are left out."
    return unseen, (text,) if unseen.any() else ()


def _window(time_s: Array, path: Path, from_s: float, to_s: float) -> tuple[float, float]:
    """Return from when to when rows of times (n,) are fitted. Raises ConfigError for too long, or too little of it."""
    begin, end = float(time_s[0]) + from_s, float(min(time_s[-1], time_s[0] + to_s))
    _check_left(end - begin, path)
    if end - begin > _MOST_S:
        raise ConfigError(f"{path}: {end - begin:.0f} s at once (limit {_MOST_S:g} s): give `from_s` and `to_s`.")
    return begin, end


def _check_left(left_s: float, path: Path) -> None:
    if not left_s > 2 * _EDGE_S:
        raise ConfigError(f"{path}: {max(left_s, 0.0):.3g} s are left of the log (limit {2 * _EDGE_S:g} s).")


def turned_back(attitude: Array, vector: Array) -> Array:
    """Return vectors (m, 3) of the world's axes along the vehicle's, of attitude w, x, y, z (m, 4)."""
    w, v = attitude[:, :1], -attitude[:, 1:]
    across = 2 * np.cross(v, vector)
    return np.asarray(vector + w * across + np.cross(v, across))


def _sensor(
    log: FlightLog, kinds: Sequence[_Sensor], topic: str, what: str
) -> tuple[tuple[Array, Array], float | None]:
    """Return a sensor's times (n,) and values (n, 3) along the vehicle's axes, and the cut-off of its filter in Hz."""
    for names, signs, low_pass_hz in (*kinds, (_OF_PX4, _DOWN, None)):
        for series in log.series:
            if set(names) <= set(series.names) and (names is not _OF_PX4 or series.name == topic):
                values = np.column_stack([sign * series.values(name) for name, sign in zip(names, signs, strict=True)])
                known = np.isfinite(values).all(axis=1)
                if np.count_nonzero(known) > 1:
                    return (series.time_s[known], values[known]), low_pass_hz
    raise DataError(f"{log.path}: no {what} along three axes (as {', '.join(kinds[0][0])}).")


def _check_weight(force: Array, path: Path) -> None:
    """Raise DataError where specific forces (n, 3) under running motors are not about gravity, upwards."""
    if not len(force):
        return
    size = float(np.median(np.linalg.norm(force, axis=1))) / USUAL_GRAVITY_MPS2
    if not _WEIGHT[0] < size < _WEIGHT[1]:
        reason = "in m/s^2, not in g" if size > _WEIGHT[1] else "in g, not in m/s^2"
        raise DataError(
            f"{path}: accelerations of {size:.2g} g while the motors run, where a flight has about 1: are they "
            f"{reason}? Scale these columns."
        )
    if float(np.median(force[:, 2])) < 0:
        raise DataError(
            f"{path}: the acceleration along z is {np.median(force[:, 2]):.2g} m/s^2 while motors run, and a flight "
            "has +9.8: z points down in this log. Turn the axes to x forward, y left, z up."
        )


def _motion(log: FlightLog, at_s: Array) -> tuple[Array | None, Array | None]:
    """Return velocity (m, 3) in the world's axes and attitude (m, 4) of motion capture, None where there is none."""
    for series in log.series:
        if {*_VELOCITY, *_QUATERNION} <= set(series.names):
            time_s = series.time_s
            velocity = np.column_stack([np.interp(at_s, time_s, series.values(name)) for name in _VELOCITY])
            attitude = np.column_stack([series.values(name) for name in _QUATERNION])
            flips = np.cumprod(np.where(np.sum(attitude[1:] * attitude[:-1], axis=1) < 0, -1.0, 1.0))
            attitude[1:] *= flips[:, np.newaxis]
            attitude = np.column_stack([np.interp(at_s, time_s, column) for column in attitude.T])
            return velocity, attitude / np.linalg.norm(attitude, axis=1)[:, np.newaxis]
    return None, None


def _volts(log: FlightLog, at_s: Array) -> tuple[Array | None, tuple[str, ...]]:
    name = _first(log, _VOLTS)
    if name is None:
        return None, ()
    time_s, volts = log.channel(name)
    known = np.isfinite(volts) & (volts > 1.0) & (volts < 60.0)
    if not known.all() or not len(volts):
        return None, ("the battery's voltage has impossible values: it is not used.",)
    return np.interp(at_s, time_s, volts), ()


def _held(time_s: Array, command: Array, at_s: Array) -> Array:
    """Return the mean command (n,) over each step, which holds from row to row of the log."""
    known = np.isfinite(command)
    time_s, command = time_s[known], command[known]
    total = np.concatenate([[0.0], np.cumsum(command[:-1] * np.diff(time_s))])
    edges = np.append(at_s, at_s[-1] + STEP_S)
    place = np.clip(np.searchsorted(time_s, edges, side="right") - 1, 0, len(time_s) - 1)
    gone = total[place] + command[place] * (edges - time_s[place])
    return np.asarray(np.diff(gone) / STEP_S)


def _at(time_s: Array, values: Array, row_s: Array, *, averaged: bool) -> Array:
    """Return values (m, 3) at rows: means over each row's 10 ms, or interpolated."""
    if not averaged:
        return np.column_stack([np.interp(row_s, time_s, column) for column in values.T])
    middle = (values[1:] + values[:-1]) / 2 * np.diff(time_s)[:, np.newaxis]
    total = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(middle, axis=0)])
    low, high = row_s - ROW_S / 2, row_s + ROW_S / 2
    return np.column_stack(
        [(np.interp(high, time_s, column) - np.interp(low, time_s, column)) / ROW_S for column in total.T]
    )


def _airborne(command: Array, force: Array, rates: Array) -> Mask:
    """Return the rows (m,) in the air: under a thrust that carries, away from the ground, and not struck."""
    lift = np.sum(command**2, axis=1)
    carried = lift > _LIFTED * np.median(lift[lift > 0]) if np.any(lift > 0) else np.zeros(len(lift), bool)
    count = round(_EDGE_S / ROW_S)
    flown = np.zeros(len(lift), bool)
    if carried.any():
        flown[np.argmax(carried) + count : len(carried) - np.argmax(carried[::-1]) - count] = True
    running = (command > 0).all(axis=1)
    struck = np.linalg.norm(force, axis=1) > _CRASH_MPS2
    wild = (np.abs(rates) > _TURNED).any(axis=1)
    around = round(_STRUCK_S / ROW_S)
    return np.asarray(flown & running & ~_late(_late(struck | wild, _STRUCK_S)[::-1], around * ROW_S)[::-1])


def _late(mask: Mask, for_s: float) -> Mask:
    """Return rows (m,) that are marked, and those for a time after them."""
    count = round(for_s / ROW_S)
    total = np.cumsum(np.concatenate([[0], mask.astype(int)]))
    return np.asarray(total[1:] - total[np.maximum(np.arange(len(mask)) - count, 0)] > 0)


def _first(log: FlightLog, patterns: Sequence[str], motor: int = 0) -> str | None:
    there = {name for series in log.series for name in series.names}
    return next((name for pattern in patterns if (name := pattern.format(motor)) in there), None)
