"""Speeds over time with their commands: from a thrust stand, from the vehicle, or from vibration."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.estimate.held_readings import once_each
from cfid.findings import Finding, note
from cfid.motors.repeated import repeated_finding
from cfid.motors.steps.model import CommandStep, command_steps
from cfid.motors.steps.sag import LoggedBattery
from cfid.motors.vibration.data import quiet_channels
from cfid.motors.vibration.ridge import speed_ridge
from cfid.recordings.read import read_recording
from cfid.recordings.stand import StandTable
from cfid.recordings.vehicle import VEHICLE_LOG, Rows, holds, read_commands, read_rows, reported_speeds_rad_s
from cfid.recordings.wrench import wrench_of
from cfid.records.parameters import Source
from cfid.records.run import Run
from cfid.units import MOTORS

Array = npt.NDArray[np.float64]

_BLUR_S, _STEP_S = 0.1, 0.02  # of a speed from vibration
_MOST_REPEATED = 0.1  # of a table's times
_SURE = 0.02  # of a speed: where its standard uncertainty is larger, within a step, it is left out


@dataclass(frozen=True, kw_only=True, eq=False)
class SpeedRecord:
    """Speeds (n,) in rad/s at times (n,) in seconds, and the commands (m,) that hold from times (m,) on.

    Each speed is a mean over `blur_s`, NaN where it is not known. The battery's voltage is by the same clock. Where
    commands are known from rows alone, these are `command_row_s` apart, and each is taken to hold from the middle
    between two rows on, its mean; so is a speed that may be older than its row by up to `age_s`.
    """

    name: str
    path: Path
    time_s: Array
    speed_rad_s: Array
    command_time_s: Array
    command: Array
    blur_s: float = 0.0
    command_row_s: float = 0.0
    age_s: float = 0.0
    battery: LoggedBattery | None = None
    findings: tuple[Finding, ...] = ()
    sources: tuple[Source, ...] = ()

    @property
    def steps(self) -> tuple[CommandStep, ...]:
        """The steps of the command while speeds were recorded; before its first value, it is 0."""
        first, last = (float(self.time_s[place]) for place in (0, -1))
        begin, end = np.searchsorted(self.command_time_s, [first, last], side="right")
        held = np.append(0.0, self.command)[begin : end + 1]  # from the beginning, and from each change on
        at_s = np.array([first, *self.command_time_s[begin:end], last])
        return command_steps(time_s=at_s, command=np.append(held, held[-1]))


def of_table(table: StandTable) -> SpeedRecord:
    """Return a thrust stand's speeds over time. Raises DataError for settled points and for a dead tachometer."""
    speed = table.square_mean_speed_rad_s
    if table.time_s is None or speed is None or np.isnan(table.command).all():
        raise DataError(f"{table.path}: no speeds and commands over time: there is no step to fit.")
    if not np.any(speed[table.command > 0] > 0):
        raise DataError(f"{table.path}: the speed is 0 or missing under every command: was the tachometer connected?")
    repeated = int(np.count_nonzero(np.diff(table.time_s) == 0))
    if repeated > _MOST_REPEATED * len(speed):
        raise DataError(
            f"{table.path}: {repeated} of {len(speed)} rows repeat the time of the one before, which shows no lag. "
            "Delete rows that were written twice; give `rate_hz` where the others are evenly spaced."
        )
    row_s = float(np.median(np.diff(table.time_s)))
    record = SpeedRecord(
        name=table.path.stem,
        path=table.path,
        time_s=table.time_s,
        speed_rad_s=speed,
        command_time_s=table.time_s - row_s / 2,
        command=table.command,
        command_row_s=row_s,
        battery=None if table.vbat_v is None else LoggedBattery(table.time_s, table.vbat_v),
        findings=table.findings,
        sources=(table.source,),
    )
    return _once_each(record)


def of_run(run: Run) -> SpeedRecord:
    """Return the speeds that the vehicle reported, else those in the load cell's vibration. Raises DataError."""
    log, commands = read_commands(run)
    command = commands.max(axis=1)
    rows = read_rows(run, VEHICLE_LOG) if holds(run, VEHICLE_LOG) else None
    ran = [motor for motor in MOTORS if commands[:, motor - 1].any()]
    speeds = {} if rows is None else reported_speeds_rad_s(rows)
    if rows is None or not ran or not all(motor in speeds for motor in ran):
        return _of_vibration(run, log, command, rows)
    record = SpeedRecord(
        name=run.folder.name,
        path=run.folder,
        time_s=rows.time_s - rows.time_s[0],
        speed_rad_s=np.mean([speeds[motor] for motor in ran], axis=0),
        command_time_s=log.time_s - rows.time_s[0],
        command=command,
        battery=_battery(rows, rows.time_s[0]),
        findings=(*rows.findings, *log.findings),
        sources=(rows.source, log.source),
    )
    return _once_each(record)


def _once_each(record: SpeedRecord) -> SpeedRecord:
    """Return a record without the speeds of rows that repeat a reading."""
    counts, readings = once_each(record.time_s, record.speed_rad_s)
    if not readings.age_s:
        return record
    return replace(
        record,
        time_s=record.time_s - readings.age_s / 2,
        speed_rad_s=np.where(counts, record.speed_rad_s, np.nan),
        age_s=readings.age_s,
        findings=(*record.findings, repeated_finding(readings)),
    )


def _of_vibration(run: Run, commands: Rows, command: Array, rows: Rows | None) -> SpeedRecord:
    record = wrench_of(read_recording(run.folder))
    channels = quiet_channels(record)
    ridge = speed_ridge(time_s=record.time_s, wrench=channels, window_s=_BLUR_S, step_s=_STEP_S)
    sure = ridge.std_rad_per_s < _SURE * ridge.speed_rad_per_s  # and not NaN
    clock_s = record.begin_s or 0.0
    text = "this vehicle reports no speed: it is estimated from the load cell's vibration, absent at standstill."
    return SpeedRecord(
        name=run.folder.name,
        path=run.folder,
        time_s=ridge.time_s,
        speed_rad_s=np.where(sure, ridge.speed_rad_per_s, np.nan),
        command_time_s=commands.time_s - clock_s,
        command=command,
        blur_s=_BLUR_S,
        battery=None if rows is None else _battery(rows, clock_s),
        findings=(*record.findings, note("speed-from-vibration", text, "dynamics.*")),
        sources=(record.source, commands.source),
    )


def _battery(rows: Rows, clock_s: float) -> LoggedBattery | None:
    volts = rows.columns.get("pm.vbat")
    return None if volts is None else LoggedBattery(rows.time_s - clock_s, volts)
