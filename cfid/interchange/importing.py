"""Import a recording of another program as a run folder, with the columns that cfid records and the origin."""

import re
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.interchange.columns import changes, chosen_columns, finite_columns, known_rows
from cfid.interchange.several_motors import of_one_motor
from cfid.large import parts, usual_step
from cfid.recordings.read import read_recording
from cfid.recordings.recording import How
from cfid.recordings.vehicle import COMMANDS, VEHICLE_LOG
from cfid.recordings.wrench import AXES, LOADCELL, wrench_of
from cfid.records.campaign import Campaign
from cfid.records.logs.any_kind import read_log
from cfid.records.logs.crazyflie_names import crazyflie_channel, stated_unit
from cfid.records.logs.kinds import Kind, has_times, is_flown, kind_at
from cfid.records.logs.log import Array, Series
from cfid.records.parameters import Source
from cfid.records.run import DeviceRecord, Label, Origin, Run
from cfid.records.run_writer import create_run
from cfid.records.tables.angle import ENCODER, Reading, read_angle
from cfid.records.tables.blocks import open_table
from cfid.records.tables.column_units import unit_of
from cfid.records.tables.gyro import GYRO
from cfid.records.tables.schema import Foreign, TimeUnit
from cfid.records.tables.stand import STAND
from cfid.records.tables.stand_names import with_named
from cfid.records.tables.table import CsvTable
from cfid.records.tables.times import TIME_COLUMN
from cfid.units import MOTORS
from cfid.version import __version__

Mask = npt.NDArray[np.bool_]

_UNIX_S = (1e9, 4e9)  # seconds since the epoch, from 2001 to 2096
_COMMAND_NAMES = tuple(tuple(f"{name}{motor}" for motor in MOTORS) for name in ("motor.m", "pwm.m"))
_OF_AN_ANGLE = 2  # columns: time and angle
_NO_COMMA = re.compile(r'[,;"\n]+')
_NO_COLUMN = re.compile(r'[\s,;"]+')


@dataclass(frozen=True, kw_only=True)
class Imported:
    """An imported run, one line on how the recording was understood, and notes."""

    run: Run
    understood: str
    notes: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Devices:
    """The contents of a run: its devices, their blocks (m, columns), how the recording was read, and its origin."""

    records: dict[str, DeviceRecord]
    blocks: dict[str, Iterator[Array]]
    begin_s: float
    understood: str
    source: Source
    program: str
    clock: str = ""
    assumed: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def kind_of(path: Path, reading: Foreign) -> Kind:
    """Return the kind of a recording that can be imported.

    Raises ConfigError where its columns do not show the kind, or have no times; DataError where it cannot be read.
    """
    kind, named = kind_at(path, reading), any("=" in one for one in reading.columns)
    if kind == "stand" and not (named or has_times(path, reading) or reading.rate_hz):
        raise ConfigError(
            f"{path}: a thrust stand's settled points, which are no recording over time: `cfid fit thrust`, `cfid fit "
            "speed` and `cfid fit torque` read them as they are."
        )
    if kind is None:
        raise ConfigError(
            f"{path}: its columns ({open_table(path, skip_lines=reading.skip_lines).listing}) do not show what was "
            "recorded: give `kind` angle, wrench or flight."
        )
    return kind


def import_angle(campaign: Campaign, path: Path, reading: Reading, *, label: Label, kind: str) -> Imported:
    """Import an angle over time as a run of the encoder, in radians. Raises errors as `read_angle`."""
    found = read_angle(path, reading)
    record = DeviceRecord(file="encoder.csv", columns=("t", "phi"), angle_unit="rad")
    rate = 1 / usual_step(found.time_s)
    rows = f"{counted(len(found.time_s), 'row')} at {rate:.0f} Hz"
    devices = _Devices(
        records={ENCODER: record},
        blocks={ENCODER: _in_parts([found.time_s, found.angle_rad])},
        begin_s=0.0,
        understood=f"{path.name}: an angle, {rows}; kept in radians, continuous over turns.",
        source=found.source,
        program="table of angles",
        notes=(*found.notes, *_others(path, reading.skip_lines, reading.columns)),
    )
    return _imported(campaign, devices, kind=kind, label=label, path=path)


def _others(path: Path, skip_lines: int, columns: Sequence[str]) -> tuple[str, ...]:
    """Return a note for a table with more columns than the time and the angle, which alone are kept."""
    table = open_table(path, skip_lines=skip_lines, columns=tuple(columns))
    if len([name for name in table.names if name]) <= _OF_AN_ANGLE:
        return ()
    return (f"of the columns {table.listing} time and angle alone are kept.",)


def import_wrench(campaign: Campaign, path: Path, how: How, *, label: Label) -> Imported:
    """Import forces and torques as a run of the load cell, in N and N m. Raises errors as `wrench_of`."""
    found = wrench_of(read_recording(path, how), how)
    columns = ("t", *AXES, *(() if found.status is None else ("status",)))
    values = [found.time_s + (found.begin_s or 0.0), *found.force_n.T, *found.torque_nm.T]
    values += [] if found.status is None else [found.status]
    rate = 1 / usual_step(found.time_s)
    devices = _Devices(
        records={LOADCELL: DeviceRecord(file="loadcell.csv", columns=columns, units="n,nm")},
        blocks={LOADCELL: _in_parts(values)},
        begin_s=found.begin_s or 0.0,
        understood=(
            f"{path.name}: forces and torques, {counted(len(found.time_s), 'row')} at {rate:.0f} Hz; kept in N and N m."
        ),
        source=found.source,
        program="table of forces",
        notes=found.notes,
    )
    return _imported(campaign, devices, kind="loadcell", label=label, path=path)


def import_stand(campaign: Campaign, path: Path, reading: Foreign, *, label: Label) -> Imported:
    """Import a thrust stand's recording; columns keep their names or get those of NAME=COLUMN, as fits read them.

    Raises errors as `read_log`, `with_named` and `of_one_motor`.
    """
    original = open_table(path, skip_lines=reading.skip_lines)
    table, named = with_named(original, of_one_motor(original, reading))
    given = dict(zip(original.names, table.names, strict=True))
    log = read_log(path, _timed(table, original, reading))
    (series,) = log.series
    called = (given.get(name) or (f"unused {name}" if name in given else name) for name in series.names)
    columns = ("t", *(_NO_COMMA.sub(" ", name).strip() for name in called))
    if len(set(columns)) < len(columns):
        raise DataError(f"{path}: two columns have one name: rename one.")
    devices = _Devices(
        records={STAND: DeviceRecord(file=f"{STAND}.csv", columns=columns)},
        blocks={STAND: series.blocks()},
        begin_s=float(next(series.blocks())[0, 0]),
        understood=log.understood,
        source=log.source,
        program="thrust stand",
        clock=log.clock,
        assumed=log.assumed,
        notes=(*named, *log.notes),
    )
    return _imported(campaign, devices, kind=STAND, label=label, path=path)


def _timed(table: CsvTable, original: CsvTable, reading: Foreign) -> Foreign:
    """Return the settings that read the times from the original table, in the unit that the table with names states.

    Raises ConfigError where the times have no unit: rows a few seconds apart look like milliseconds.
    """
    reading = replace(reading, columns=tuple(one for one in reading.columns if "=" not in one))
    names = [name for name in table.names if TIME_COLUMN.called.fullmatch(name)]
    if reading.rate_hz or not names:
        return reading
    unit = unit_of(table, TIME_COLUMN.called, names[0], reading.time_unit, "time_unit")
    if unit is None:
        raise ConfigError(f"{table.path}: column '{names[0]}' names no unit: give `time_unit` s, ms or us.")
    place = table.names.index(names[0])
    if original.names[place] != names[0]:
        reading = replace(reading, columns=(original.names[place],))
    return replace(reading, time_unit=cast(TimeUnit, unit))


def import_flight(campaign: Campaign, path: Path, reading: Foreign, *, label: Label, kind: str = "flight") -> Imported:
    """Import a vehicle's log: a device for each series, in the log's own units, and the commands of the motors.

    Columns with the same gaps become a device of their own, with the rows in which they have numbers; a column without
    any number is left out. Raises DataError and ConfigError as `read_log`, and DataError for a swing, which is any
    `kind` but `flight`, without a gyro.
    """
    log = read_log(path, reading)
    if kind != "flight" and not any(set(GYRO) <= {*series.names, *series.variables} for series in log.series):
        raise DataError(
            f"{path}: no {', '.join(GYRO)} among its columns, by which a swing is known: give them these names, with "
            "their unit, as in gyro.x [rad/s]."
        )
    main = max(log.series, key=lambda one: (any(map(is_flown, one.names)), one.rows))
    records: dict[str, DeviceRecord] = {}
    blocks: dict[str, Iterator[Array]] = {}
    commands: Iterator[Array] | None = None
    notes = list(log.notes)
    for series in log.series:
        # Only its name shows what a PX4 topic of one vector holds, so the device keeps that name.
        flown = series is main and any(map(is_flown, series.names)) and "xyz[0]" not in series.names
        kept, remarks = _add(series, VEHICLE_LOG if flown else _word(series.name), records, blocks)
        notes += remarks
        motors = next((motors for motors in _COMMAND_NAMES if set(motors) <= set(kept)), None)
        if series is main and motors is not None:
            commands = changes(series, motors)
            notes.append(f"commands are {motors[0]} to {motors[-1]}, as far as the log shows them.")
    if commands is not None:
        records[COMMANDS] = DeviceRecord(file="commands.csv", columns=("t", "m1", "m2", "m3", "m4"))
        blocks[COMMANDS] = commands
    if not records:
        raise DataError(f"{path}: nothing to import. {' '.join(notes)}")
    begin_s = min(float(next(series.blocks())[0, 0]) for series in log.series)
    devices = _Devices(
        records=records,
        blocks=blocks,
        begin_s=begin_s,
        understood=log.understood,
        source=log.source,
        program=log.program,
        clock=log.clock,
        assumed=log.assumed,
        notes=tuple(notes),
    )
    return _imported(campaign, devices, kind=kind, label=label, path=path)


def _add(
    series: Series, device: str, records: dict[str, DeviceRecord], blocks: dict[str, Iterator[Array]]
) -> tuple[list[str], list[str]]:
    """Add a series as a device, columns with the same gaps as another; return names of gapless columns, and notes."""
    try:
        whole, gaps = finite_columns(series)
    except DataError as fault:  # one invalid series does not make the log invalid
        return [], [f"{series.name}: left out: {fault}"]
    kept = [name for name, all_there in zip(series.names, whole[1:], strict=True) if all_there]
    gappy = [name for names in gaps for name in names]
    notes = []
    if left := [name for name in series.names if name not in kept and name not in gappy]:
        notes.append(f"{series.name}: left out, since they hold no finite number: {', '.join(left)}.")
    if gappy:
        notes.append(f"{series.name}: devices of their own, since some rows have no number: {', '.join(gappy)}.")
    names = [_word(name, _NO_COLUMN) for name in kept]
    of_times_alone = not series.names  # an event without variables
    if not (names or gappy or of_times_alone) or len(set(names)) < len(names):
        why = "two columns have one name" if names else "no column is left"
        return [], [*notes, f"{series.name}: left out: {why}."]
    if names or of_times_alone:
        device = _free(device, records)
        records[device] = DeviceRecord(file=f"{device}.csv", columns=("t", *names), channel_units=_units(series, kept))
        blocks[device] = chosen_columns(series, whole)
    for together in gaps:
        own = _free(_word(f"{device}_{together[0]}"), records)
        columns = ("t", *(_word(name, _NO_COLUMN) for name in together))
        if len(set(columns)) < len(columns):
            notes.append(f"{series.name}: left out, since two of them have one name: {', '.join(together)}.")
            continue
        records[own] = DeviceRecord(file=f"{own}.csv", columns=columns, channel_units=_units(series, together))
        blocks[own] = known_rows(series, together)
    return kept, notes


def _units(series: Series, names: Sequence[str]) -> dict[str, str] | None:
    """Return, by column of a run, the units that channels' names do not show; None where there are none."""
    channels = [series.channels[series.place_of(name)] for name in names]
    stated = {_word(channel.name, _NO_COLUMN): channel for channel in channels if channel.own_unit}
    found = {name: stated_unit(one) for name, one in stated.items() if one != crazyflie_channel(one.name)}
    return found or None


def _imported(campaign: Campaign, devices: _Devices, *, kind: str, label: Label, path: Path) -> Imported:
    dated = _UNIX_S[0] <= devices.begin_s <= _UNIX_S[1]
    started = datetime.fromtimestamp(devices.begin_s, UTC) if dated else datetime.now(UTC)
    origin = Origin(
        file=path.name,
        sha256=devices.source.sha256,
        program=devices.program,
        clock=devices.clock,
        assumed=devices.assumed,
        notes=devices.notes,
    )
    writer = create_run(
        campaign.runs_folder,
        kind=kind,
        label=label,
        devices=devices.records,
        started=started,
        cfid_version=__version__,
        facts=campaign.rig.facts,
        origin=origin,
    )
    with writer:
        for device, blocks in devices.blocks.items():
            for block in blocks:
                writer.append(device, tuple(block.T))
    assumed = f" Assumed: {'; '.join(devices.assumed)}." if devices.assumed else ""
    run = Run(folder=writer.folder, header=writer.header)
    return Imported(run=run, understood=f"{devices.understood}{assumed}", notes=devices.notes)


def _in_parts(columns: Sequence[npt.NDArray[Any]]) -> Iterator[Array]:
    """Yield columns (n,) as blocks (m, columns)."""
    for part in parts(len(columns[0])):
        yield np.column_stack([column[part] for column in columns])


def _word(name: str, pattern: re.Pattern[str] = re.compile(r"[^A-Za-z0-9_-]+")) -> str:
    return pattern.sub("_", name).strip("_.") or "series"


def _free(device: str, taken: Container[str]) -> str:
    """Return a device's name, with underscores appended while another device has it."""
    while device in taken:
        device += "_"
    return device
