"""Speeds of rotors over time with their commands: from a run, a thrust stand, a vehicle's log, or vibration."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError
from cfid.estimate.held_readings import once_each
from cfid.findings import Finding, finding, note, warning
from cfid.motors.rotor.model import RotorRecord, Signal
from cfid.motors.rotor.voltage import volts_at
from cfid.motors.vibration.data import quiet_channels
from cfid.motors.vibration.ridge import speed_ridge
from cfid.recordings import supply
from cfid.recordings.crazyflie import between, findings_in, first_of, is_flown, times_in, windows
from cfid.recordings.limits import COMMANDS, SPEEDS, refuse_repeated_times
from cfid.recordings.read import description, is_binary_log, read_recording
from cfid.recordings.read import of_run as recording_of_run
from cfid.recordings.recording import Recording
from cfid.recordings.stand import StandTable, holds_stand, read_stand, stand_of
from cfid.recordings.table import read_table
from cfid.recordings.vehicle import VEHICLE_LOG, Rows, holds, read_commands, read_rows, reported_speeds_rad_s
from cfid.recordings.wrench import wrench_of
from cfid.records.parameters import Source
from cfid.records.run import Run, run_at
from cfid.units import MOTORS

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_COMMANDS = ("motor.m{}", "pwm.m{}_pwm", "pwm.m{}", "control.m{}")
_SPEEDS = ("rpm.m{}", "motor.m{}_rpm")
_VOLTS = ("pm.vbat", "pm.vbatMV")
_LONGEST_S = 120.0  # of a log that is fitted: its liveliest part
_BREAK_S = 0.1  # without a row, after which the rotor's state is unknown
_OWN_STEPS, _SEEN_ROW_S = (
    0.5,
    3e-3,
)  # share of rows in which a command changes, and their interval: beyond, no row shows
_STRAIGHT_STEPS = 4  # in which a drive then goes straight from row to row
_VOLTS_S = 0.01  # intervals of a command in which the voltage hardly changes
_BLUR_S, _STEP_S = 0.1, 0.02  # of a speed from vibration
_SURE = 0.02  # of a speed from vibration: where its standard uncertainty is larger, within a step, it is left out
_UNSEEN_S = 0.06  # after a piece begins: rotors may still follow a command before it
_LEAST_S = 1e-6
_MOST_IMPOSSIBLE = 0.1  # share of a log's voltages


@dataclass(frozen=True, kw_only=True, eq=False)
class Followed:
    """Rotors that follow commands: a record for each by its number, or one for all that ran together under 0.

    `is_log` is whether a vehicle flew: its log shows the map of the command, too.
    """

    path: Path
    name: str
    rotors: Mapping[int, RotorRecord]
    is_log: bool = False
    findings: tuple[Finding, ...] = ()
    sources: tuple[Source, ...] = ()
    lines: tuple[str, ...] = field(default=())


def followed(
    recording: Recording | StandTable | Run | Path | str,
    *,
    rotor: int | None = None,
    from_s: float | None = None,
    to_s: float | None = None,
) -> Followed:
    """Return the rotors of a recording, or one of them, between two times since its first row with a command.

    A run has speeds that the vehicle reported, or a load cell's vibration; a thrust stand's table and a vehicle's log
    have speeds over time. Raises DataError for a recording that cannot be read, ConfigError for an empty window or a
    rotor that is not there.
    """
    window = (0.0 if from_s is None else from_s), (np.inf if to_s is None else to_s)
    if isinstance(recording, Path | str):
        recording = _read(Path(recording))
    if isinstance(recording, Run) and recording.header.kind == "flight":
        recording = recording_of_run(recording)
    if isinstance(recording, Recording):
        return _of_log(recording, rotor, window)
    if rotor is not None:
        raise ConfigError("`rotor` is for the log of a vehicle: this recording has one speed for the rotors that ran.")
    return _of_table(recording, window) if isinstance(recording, StandTable) else _of_run(recording, window)


def _read(path: Path) -> Recording | StandTable | Run:
    run = run_at(path)
    if run is not None:
        return stand_of(read_stand(path)) if holds_stand(path) else run
    if is_binary_log(path):
        return read_recording(path)
    if any(map(is_flown, read_table(path).heads)):  # a thrust stand's table need not have times
        log = read_recording(path)
        if _of_motors(log, _COMMANDS):
            return log
    return stand_of(read_stand(path))


def _of_table(table: StandTable, window: tuple[float, float]) -> Followed:
    speed = table.square_mean_speed_rad_s
    if table.time_s is None or speed is None or np.isnan(table.command).all():
        raise DataError(f"{table.path}: no speeds and commands over time: there is no step to fit.")
    if not np.any(speed[table.command > 0] > 0):
        raise DataError(f"{table.path}: the speed is 0 or missing under every command: was the tachometer connected?")
    refuse_repeated_times(table.path, table.time_s)
    begin_s = float(table.time_s[0])
    volts = None if table.vbat_v is None else Signal(table.time_s - begin_s, table.vbat_v)
    record, findings = _record(
        Signal(table.time_s - begin_s, speed), Signal(table.time_s - begin_s, table.command), window, volts=volts
    )
    return Followed(
        path=table.path,
        name=table.path.stem,
        rotors={0: _known(record, table.path)},
        findings=(*table.findings, *findings),
        sources=(table.source,),
    )


def _of_run(run: Run, window: tuple[float, float]) -> Followed:
    """Return the speeds that the vehicle reported, else those in the load cell's vibration."""
    log, commands = read_commands(run)
    rows = read_rows(run, VEHICLE_LOG) if holds(run, VEHICLE_LOG) else None
    ran = [motor for motor in MOTORS if commands[:, motor - 1].any()]
    speeds = {} if rows is None else reported_speeds_rad_s(rows)
    findings, sources = list(log.findings), [log.source]
    if rows is not None and ran and all(motor in speeds for motor in ran):
        clock_s, blur_s = float(rows.time_s[0]), 0.0
        speed = Signal(rows.time_s - clock_s, np.mean([speeds[motor] for motor in ran], axis=0))
        findings, sources = [*rows.findings, *findings], [rows.source, *sources]
    else:
        wrench = wrench_of(read_recording(run.folder))
        channels = quiet_channels(wrench)
        ridge = speed_ridge(time_s=wrench.time_s, wrench=channels, window_s=_BLUR_S, step_s=_STEP_S)
        sure = ridge.std_rad_per_s < _SURE * ridge.speed_rad_per_s  # and not NaN
        speed, blur_s = Signal(ridge.time_s, np.where(sure, ridge.speed_rad_per_s, np.nan)), _BLUR_S
        clock_s = wrench.begin_s or 0.0
        text = "this vehicle reports no speed: it is estimated from the load cell's vibration, absent at standstill."
        findings = [*wrench.findings, *findings, note("speed-from-vibration", text, "dynamics.*")]
        sources = [wrench.source, *sources]
    held = Signal(
        np.append(min(0.0, log.time_s[0] - clock_s), log.time_s - clock_s), np.append(0, commands.max(axis=1))
    )
    record, more = _record(speed, held, window, volts=_battery(rows, clock_s), exact=True, blur_s=blur_s)
    return Followed(
        path=run.folder,
        name=run.folder.name,
        rotors={0: _known(record, run.folder)},
        findings=(*findings, *more),
        sources=tuple(sources),
    )


def _battery(rows: Rows | None, clock_s: float) -> Signal | None:
    volts = None if rows is None else rows.columns.get("pm.vbat")
    return None if rows is None or volts is None else Signal(rows.time_s - clock_s, volts)


def _of_log(log: Recording, rotor: int | None, window: tuple[float, float]) -> Followed:
    commands = _of_motors(log, _COMMANDS)
    if not commands:
        raise DataError(
            f"{log.path}: no command of a motor (motor.m1, pwm.m1_pwm, PX4's actuator_motors; the pulse widths of its "
            "actuator_outputs are not read)."
        )
    speeds = {motor: name for motor, name in _of_motors(log, _SPEEDS).items() if motor in commands}
    if not speeds:
        raise DataError(
            f"{log.path}: no rotor speeds (rpm.m1, ...): use `cfid fit flight`, which takes the lag from the gyro "
            "and the accelerometer."
        )
    if rotor is not None and rotor not in speeds:
        raise ConfigError(f"{log.path}: `rotor` {rotor}: the log has speeds of {', '.join(map(str, speeds))} alone.")
    names = [*commands.values(), *speeds.values()]
    begin_s = min(float(times_in(log, log.holding(name))[0]) for name in commands.values())
    (low, high), whole_s = _liveliest(log, list(commands.values()), begin_s, window)
    findings: list[Finding] = list(findings_in(log))
    if log.facts.clock == "unknown":
        findings.append(finding("gyro-clock-undecided", "dynamics.*").at(log.path.name))
    if high - low < whole_s:
        text = f"the liveliest {high - low:.0f} s of {whole_s:.0f} s are fitted, from {low:.0f} s on."
        findings.append(note("log-part-fitted", text, "dynamics.*"))
    volts = first_of(log, _VOLTS)
    channels = [*names, *([] if volts is None else [volts])]
    cut = between(log, begin_s + low, begin_s + high)
    whole = next(windows(cut, channels, from_s=begin_s + low, long_s=high - low + _LEAST_S))
    signals = {name: Signal(time_s - begin_s, value).between(low, high) for name, (time_s, value) in whole.items()}
    limits = dict.fromkeys(commands.values(), COMMANDS) | dict.fromkeys(speeds.values(), SPEEDS)
    for name, limit in limits.items():
        wrong = limit.outside(signals[name].value)
        if limit.few(int(wrong.sum()), len(signals[name].known.value)):
            first = float(signals[name].value[np.argmax(wrong)])
            findings.append(limit.left_out(name, int(wrong.sum()), first).at(log.path.name))
            signals[name] = signals[name].without(wrong)
    battery = None if volts is None else signals[volts].known
    if battery is not None and np.mean(wrong := supply.impossible(battery.value)) <= _MOST_IMPOSSIBLE:
        battery = battery.without(wrong).known
    elif battery is not None:
        text = "the battery's voltage is impossible in more than a tenth of the rows: it is not used."
        findings.append(warning("log-voltage-unused", text, "dynamics.*"))
        battery = None
    rotors = {}
    for motor in speeds if rotor is None else [rotor]:
        command = signals[commands[motor]].known
        refuse_repeated_times(log.path, command.time_s)
        others = [signals[name] for name in speeds.values()]
        own = list(speeds).index(motor)
        record, more = _record(signals[speeds[motor]], command, (low, high), volts=battery, others=others, own=own)
        findings += (one.at(f"rotor {motor}") for one in more)
        if record is not None:
            rotors[motor] = record
    if not rotors:
        raise DataError(f"{log.path}: no rotor has both commands and speeds while it was driven.")
    return Followed(
        path=log.path,
        name=log.path.stem,
        rotors=rotors,
        is_log=True,
        findings=tuple(dict.fromkeys(findings)),
        sources=(log.source,),
        lines=tuple(filter(None, [description(log)])),
    )


def _of_motors(log: Recording, patterns: tuple[str, ...]) -> dict[int, str]:
    named = {motor: first_of(log, patterns, motor) for motor in MOTORS}
    return {motor: name for motor, name in named.items() if name is not None}


def _liveliest(
    log: Recording, names: Sequence[str], begin_s: float, window: tuple[float, float]
) -> tuple[tuple[float, float], float]:
    """Return the two minutes of a window in which commands move most, from and to, and how long the window is."""
    end_s = max(float(times_in(log, log.holding(name))[-1]) for name in names) - begin_s
    low, high = window[0], min(window[1], end_s)
    if not low < high:
        raise ConfigError(f"{log.path}: no rows between `from_s` {window[0]:g} and `to_s` {window[1]:g} s.")
    whole_s = high - low
    if whole_s <= _LONGEST_S:
        return (low, high), whole_s
    moved = []
    for part in windows(log, names, from_s=begin_s + low, long_s=_LONGEST_S):
        inside = [Signal(*part[name]).between(begin_s + low, begin_s + high).value for name in names]
        moved.append(sum(float(np.nansum(np.abs(np.diff(value)))) for value in inside))
    from_s = min(low + int(np.argmax(moved)) * _LONGEST_S, high - _LONGEST_S)
    return (from_s, from_s + _LONGEST_S), whole_s


def _known(record: RotorRecord | None, path: Path) -> RotorRecord:
    if record is None:
        raise DataError(f"{path}: no speeds while a rotor was driven.")
    return record


def _record(
    speed: Signal,
    command: Signal,
    window: tuple[float, float],
    *,
    volts: Signal | None,
    others: Sequence[Signal] = (),
    own: int = 0,
    exact: bool = False,
    blur_s: float = 0.0,
) -> tuple[RotorRecord | None, list[Finding]]:
    """Return a rotor's record within a window, None where it was not driven, and findings.

    `exact` states that commands (m,) came at their times; otherwise rows show them. `others` are the speeds of all
    rotors that load the battery, of which this one is the `own`.
    """
    findings: list[Finding] = []
    counts, readings = once_each(*speed)
    if readings.age_s:
        rate_hz = 1 / readings.row_s
        text = (
            f"each reading is repeated in about {readings.rows / readings.read:.2g} rows: {rate_hz:.3g} rows a second "
            f"show {rate_hz * readings.read / readings.rows:.3g} readings. The first row of each counts."
        )
        findings.append(note("speeds-repeated", text, "dynamics.*"))
    command = Signal(*(one[np.isfinite(command.value)] for one in command))
    time_s, held = command
    row_s = 0.0 if exact or len(time_s) < 2 else float(np.median(np.diff(time_s)))
    driven = _held(command, speed.time_s) > 0
    lost = driven & ~(speed.value > 0)
    if lost.any() and blur_s == 0:
        text = f"{int(lost.sum())} of {len(lost)} speeds are 0 or missing while the rotor is driven, and left out."
        findings.append(note("speeds-missing", text, "dynamics.*"))
    known = counts & ~lost & (speed.time_s >= window[0]) & (speed.time_s <= window[1])
    if not known.any() or not np.any(held > 0):
        return None, findings
    full = float(held.max())
    drive = held / full
    changes = np.diff(drive)[(drive[1:] > 0) & (drive[:-1] > 0)] != 0
    moving = len(changes) > 0 and bool(np.mean(changes) > _OWN_STEPS)
    straight = moving and row_s > _SEEN_ROW_S
    break_s = np.inf if exact else max(_BREAK_S, 5 * row_s)
    first = np.append(True, np.diff(time_s) > break_s)
    place = np.maximum(np.searchsorted(time_s, speed.time_s, side="right") - 1, 0)
    begins = np.flatnonzero(first)[np.cumsum(first)[place] - 1]  # where the piece of each speed begins
    waits = (held[begins] > 0) & (speed.time_s < time_s[begins] + _UNSEEN_S)
    inside = ~waits & (speed.time_s <= time_s[place] + break_s)
    begin_s = time_s - (0.0 if straight else row_s / 2)
    if straight:
        begin_s, drive, first = _straight(begin_s, drive, first)
    kept = first | np.append(True, np.diff(drive) != 0)
    begin_s, drive, first = begin_s[kept], drive[kept], first[kept]
    supply, sag_v, at_v = None, 0.0, 1.0
    if volts is not None and len(volts.known.time_s) > 1:
        loads = [_load(one, command) for one in others or [speed]]
        begin_s, drive, first = _cut(begin_s, drive, first, float(speed.time_s[-1]))
        at_s = np.append(begin_s, max(float(speed.time_s[-1]), float(begin_s[-1]) + _VOLTS_S))
        value, sag_v = volts_at(volts.known, loads, own, at_s)
        square = np.interp(at_s, *loads[own]) ** 2
        at_v = float(np.mean((value + sag_v * square)[:-1][drive > 0]))
        supply = Signal(at_s, value)
    record = RotorRecord(
        time_s=speed.time_s - readings.age_s / 2,
        speed_rad_s=np.where(known & inside, speed.value, np.nan),
        begin_s=begin_s,
        command=drive,
        first=first,
        full=full,
        volts=supply,
        sag_v=sag_v,
        at_v=at_v,
        row_s=row_s,
        age_s=readings.age_s,
        blur_s=blur_s,
        moving=moving,
        straight=straight,
    )
    return record, findings


def _load(speed: Signal, command: Signal) -> Signal:
    """Return a speed with which a rotor loads the battery: none at command 0."""
    return Signal(speed.time_s, np.where(_held(command, speed.time_s) > 0, speed.value, 0.0)).known


def _held(command: Signal, time_s: Array) -> Array:
    """Return the commands that hold at times (n,); before the first, that is the first."""
    return np.asarray(command.value[np.maximum(np.searchsorted(command.time_s, time_s, side="right") - 1, 0)])


def _straight(time_s: Array, drive: Array, first: Mask) -> tuple[Array, Array, Mask]:
    """Return a drive (m,) that goes straight from row to row, in steps that hold."""
    steps = np.arange(_STRAIGHT_STEPS) / _STRAIGHT_STEPS
    rise = np.where(first[1:], 0.0, np.diff(drive))[:, np.newaxis]
    at_s = time_s[:-1, np.newaxis] + np.where(first[1:], 0.0, np.diff(time_s))[:, np.newaxis] * steps
    middle = drive[:-1, np.newaxis] + rise * (steps + 0.5 / _STRAIGHT_STEPS)
    begins = np.zeros(at_s.shape, bool)
    begins[:, 0] = first[:-1]
    return np.append(at_s, time_s[-1]), np.append(middle, drive[-1]), np.append(begins, first[-1])


def _cut(begin_s: Array, drive: Array, first: Mask, end_s: float) -> tuple[Array, Array, Mask]:
    """Return a drive whose intervals are at most as long as the voltage hardly changes."""
    long_s = np.diff(begin_s, append=max(end_s, float(begin_s[-1])))
    counts = np.maximum(np.ceil(long_s / _VOLTS_S).astype(int), 1)
    place = np.repeat(np.arange(len(begin_s)), counts)
    number = np.arange(len(place)) - np.repeat(np.cumsum(counts) - counts, counts)
    return begin_s[place] + number * (long_s / counts)[place], drive[place], first[place] & (number == 0)
