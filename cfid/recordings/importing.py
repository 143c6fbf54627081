"""Make a run folder of another program's recording: its columns with their units, its facts, and its origin."""

import hashlib
import re
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, finding
from cfid.large import parts
from cfid.recordings.angle import angle_of
from cfid.recordings.crazyflie import is_flown
from cfid.recordings.periods import PERIODS, periods_of
from cfid.recordings.read import description, kind_of
from cfid.recordings.recording import ENCODER, Array, Column, How, Kind, Recording, Series
from cfid.recordings.sines import PINGS, read_pings
from cfid.recordings.stand import STAND, canonical_stand
from cfid.recordings.vehicle import COMMANDS, VEHICLE_LOG
from cfid.recordings.wrench import LOADCELL, wrench_of
from cfid.records.campaign import Campaign
from cfid.records.rig_file import NONE_STATED
from cfid.records.run import DeviceRecord, Label, Origin, Run
from cfid.records.run_writer import create_run
from cfid.units import MOTORS
from cfid.version import __version__

_UNIX_S = (1e9, 4e9)  # seconds since the epoch, from 2001 to 2096
_COMMAND_NAMES = tuple(tuple(f"{name}{motor}" for motor in MOTORS) for name in ("motor.m", "pwm.m"))
_GYRO = ("gyro.x", "gyro.y", "gyro.z")
_NO_COLUMN = re.compile(r'[\s,;"]+')
_NO_DEVICE = re.compile(r"[^A-Za-z0-9_-]+")


@dataclass(frozen=True, kw_only=True, eq=False)
class _Device:
    """A device of a run to be: columns (n,) by the names they get, the first of which are times, and further facts."""

    columns: Mapping[str, npt.NDArray[Any]]
    facts: Mapping[str, Any]

    @classmethod
    def of(cls, series: Series, *, begin_s: float) -> "_Device":
        """Return a series as a device, with the unit of each column that has one."""
        names = [_NO_COLUMN.sub("_", column.name).strip("_.") or "column" for column in series.columns]
        if len(set(names)) < len(names):
            raise DataError(f"{series.path}: two columns of {series.name} have one name: rename one.", code="names")
        times = {} if series.time_s is None else {"t": series.time_s + begin_s}
        units = {name: column.unit for name, column in zip(names, series.columns, strict=True) if column.unit}
        columns = {**times, **{name: one.values for name, one in zip(names, series.columns, strict=True)}}
        return cls(columns=columns, facts={"channel_units": units} if units else {})


@dataclass(frozen=True, kw_only=True)
class Imported:
    """An imported run, one line on how the recording was understood, and findings."""

    run: Run
    understood: str
    findings: tuple[Finding, ...]


def import_recording(
    recording: Recording,
    how: How | None = None,
    *,
    campaign: Campaign | None = None,
    kind: Kind | None = None,
    label: Label | None = None,
) -> Imported:
    """Write a recording that `read_recording` returned as a run folder, read by the same settings.

    Without a campaign the run is made in the current folder. Raises ConfigError where its columns do not show its
    `kind`, and for what `how` has to state; DataError as the reader of the kind.
    """
    if recording.run is not None:
        raise ConfigError(f"{recording.path}: a run already: every fit takes it as it is.", code="a-run")
    how = how or How()
    label, kind = label or Label(), kind or _kind(recording)
    if recording.facts.clock == "unknown":
        raise ConfigError(
            f"{recording.path}: the log does not show whether its microseconds are true or run at 84/85 of real time, "
            "as on a Crazyflie 2.x with firmware up to 2026.08: give `clock` true or 84/85.",
            code="no-clock",
        )
    if kind is None:
        listing = ", ".join(column.head or column.name for one in recording.series.values() for column in one.columns)
        raise ConfigError(
            f"{recording.path}: its columns ({listing}) do not show what was recorded: give `kind` angle, wrench, "
            "stand, flight, ping or period.",
            code="no-kind",
        )
    if kind != "wrench" and label.pull is not None:
        raise ConfigError("`pull` is for forces of a load cell under a known weight.", code="pull")
    if kind == "angle":
        known, devices = _angle(recording, how, None if campaign is None else campaign.rig.encoder.counts_per_turn)
    else:
        known, devices = _DEVICES[kind](recording, how)
    hung = "swing" if label.axis else "drop" if label.weight_g else ""
    if kind == "flight" and hung and not any(set(_GYRO) <= {*device.columns} for device in devices.values()):
        raise DataError(
            f"{recording.path}: no {', '.join(_GYRO)} among its columns, by which a swing is known: name them so by "
            "`columns`, as in gyro.x=3.",
            code="no-gyro",
        )
    begin_s = next((begin for one in recording.series.values() if (begin := one.begin_s) is not None), 0.0)
    dated = _UNIX_S[0] <= begin_s <= _UNIX_S[1]
    names = {"angle": hung or ENCODER, "wrench": LOADCELL, "stand": STAND, "flight": hung or "flight", "ping": "ping"}
    writer = create_run(
        Path() if campaign is None else campaign.runs_folder,
        kind=names.get(kind, hung or "swing"),
        label=label,
        devices={
            name: DeviceRecord.model_validate({"file": f"{name}.csv", "columns": tuple(one.columns), **one.facts})
            for name, one in devices.items()
        },
        started=datetime.fromtimestamp(begin_s, UTC) if dated else datetime.now(UTC),
        cfid_version=__version__,
        facts=NONE_STATED if campaign is None else campaign.rig.facts,
        origin=Origin.model_validate(
            {
                "file": recording.path.name,
                "sha256": recording.source.sha256,
                "program": known.facts.program,
                "clock": known.facts.clock,
                "props_out": known.facts.props_out,
                "square": known.facts.square,
                "motors": known.facts.motors,
                "notes": tuple(one.text for one in known.findings),
            }
        ),
    )
    with writer:
        for name, device in devices.items():
            columns = list(device.columns.values())
            for rows in parts(len(columns[0])):
                writer.append(name, [column[rows] for column in columns])
    run = Run(folder=writer.folder, header=writer.header)
    return Imported(run=run, understood=description(recording), findings=known.findings)


def _kind(recording: Recording) -> Kind | None:
    """Return the kind of a file's recording: a log of several series is a vehicle's."""
    series = list(recording.series.values())
    return "flight" if len(series) > 1 else kind_of(series[0].columns)


def _angle(
    recording: Recording, how: How, rig_counts_per_turn: float | str | None
) -> tuple[Recording, dict[str, _Device]]:
    """Return the encoder's angle in rad, continuous over turns."""
    record = angle_of(recording, how, rig_counts_per_turn=rig_counts_per_turn)
    begin_s = recording.series[next(iter(recording.series))].begin_s or 0.0
    device = _Device(columns={"t": record.time_s + begin_s, "phi": record.angle_rad}, facts={"angle_unit": "rad"})
    return replace(recording, findings=record.findings), {ENCODER: device}


def _wrench(recording: Recording, how: How) -> tuple[Recording, dict[str, _Device]]:
    """Return forces and torques in N and N m, with the load cell's status where it is known."""
    record = wrench_of(recording, how)
    columns: dict[str, npt.NDArray[Any]] = {"t": record.time_s + (record.begin_s or 0.0)}
    columns |= {axis: record.values_of(axis) for axis in record.axes}
    if record.status is not None:
        columns["status"] = record.status
    return replace(recording, findings=record.findings), {LOADCELL: _Device(columns=columns, facts={"units": "n,nm"})}


def _stand(recording: Recording, how: How) -> tuple[Recording, dict[str, _Device]]:
    stand = canonical_stand(recording, how)
    series = stand.series[STAND]
    return stand, {STAND: _Device.of(series, begin_s=series.begin_s or 0.0)}


def _pings(recording: Recording, how: How) -> tuple[Recording, dict[str, _Device]]:
    record = read_pings(recording.path, how)
    sent_s = np.cumsum(record.rtt_s) - record.rtt_s if record.sent_s is None else record.sent_s
    columns = {"t": sent_s, "rtt_s": record.rtt_s}
    if record.vehicle_us is not None:
        columns["vehicle_us"] = record.vehicle_us
    return replace(recording, findings=record.findings), {PINGS: _Device(columns=columns, facts={})}


def _periods(recording: Recording, how: How) -> tuple[Recording, dict[str, _Device]]:
    """Return timed periods in s and rad."""
    record = periods_of(recording, how)
    return replace(recording, findings=record.findings), {PERIODS: _Device(columns=record.columns, facts={})}


def _flight(recording: Recording, _how: How) -> tuple[Recording, dict[str, _Device]]:
    """Return a device for each series of a vehicle's log, in the log's own units, and the commands of the motors.

    Columns with the same gaps become a device of their own, with the rows in which they have numbers; a column without
    any number is left out.
    """
    main = max(recording.series.values(), key=lambda one: (any(map(is_flown, one.names)), one.rows))
    devices: dict[str, _Device] = {}
    findings = list(recording.findings)
    for series in recording.series.values():
        # Only its name shows what a PX4 topic of one vector holds, so the device keeps that name.
        flown = series is main and any(map(is_flown, series.names)) and "xyz[0]" not in series.names
        device = VEHICLE_LOG if flown else _NO_DEVICE.sub("_", series.name).strip("_.") or "series"
        try:
            findings += _add(series, device, devices)
        except DataError as fault:  # one invalid series does not make the log invalid
            findings.append(finding("series-left-out", fault=str(fault)).at(series.name))
    motors = next((motors for motors in _COMMAND_NAMES if set(motors) <= set(main.names)), None)
    if motors is not None:
        changed = _changes(main, motors)
        devices[COMMANDS] = _Device(columns=changed, facts={})
        findings.append(finding("log-commands", first=motors[0], last=motors[-1]).at(recording.path.name))
    if not devices:
        raise DataError(f"{recording.path}: nothing to import: no series has a column of numbers.", code="no-rows")
    return replace(recording, findings=tuple(findings)), devices


def _add(series: Series, device: str, devices: dict[str, _Device]) -> list[Finding]:
    """Add a series as a device, and its columns with gaps as devices of their own. Raises DataError."""
    if series.time_s is None:
        raise DataError(f"{series.path}: it has no times.", code="no-time")
    begin_s, findings = series.begin_s or 0.0, list[Finding]()
    whole, gappy, empty = _by_gaps(series.columns)
    if empty:
        findings.append(finding("columns-without-number", names=", ".join(empty)).at(series.name))
    if gappy:
        names = ", ".join(column.name for columns in gappy.values() for column in columns)
        findings.append(finding("columns-with-gaps", names=names).at(series.name))
    if whole or not series.columns:  # an event without variables has times alone
        made = _Device.of(replace(series, columns=tuple(whole)), begin_s=begin_s)
        devices[_free(device, devices)] = made
    for columns in gappy.values():
        known = replace(series, columns=tuple(columns)).kept(np.isfinite(columns[0].values))
        name = _NO_DEVICE.sub("_", f"{device}_{columns[0].name}").strip("_.")
        devices[_free(name, devices)] = _Device.of(known, begin_s=begin_s)
    return findings


def _by_gaps(columns: Sequence[Column]) -> tuple[list[Column], dict[bytes, list[Column]], list[str]]:
    """Return the columns without gaps, those with some by their gaps, and the names of those without any number."""
    whole, gappy, empty = list[Column](), dict[bytes, list[Column]](), list[str]()
    for column in columns:
        finite = np.isfinite(column.values)
        if finite.all():
            whole.append(column)
        elif finite.any():
            gappy.setdefault(hashlib.sha256(np.packbits(finite).tobytes()).digest(), []).append(column)
        else:
            empty.append(column.name)
    return whole, gappy, empty


def _changes(series: Series, motors: Sequence[str]) -> dict[str, Array]:
    """Return times and commands of the rows in which a motor's command differs from that of the row before."""
    if series.time_s is None:
        return {}
    commands = [series.column(name).values for name in motors]
    changed = np.ones(series.rows, np.bool_)
    changed[1:] = np.any([np.diff(command) != 0 for command in commands], axis=0)
    changed &= np.all([np.isfinite(command) for command in commands], axis=0)
    times = series.time_s[changed] + (series.begin_s or 0.0)
    return {"t": times, **{f"m{motor}": command[changed] for motor, command in zip(MOTORS, commands, strict=True)}}


def _free(device: str, taken: Container[str]) -> str:
    """Return a device's name, with underscores appended while another device has it."""
    while device in taken:
        device += "_"
    return device


_DEVICES: Mapping[Kind, Callable[[Recording, How], tuple[Recording, dict[str, _Device]]]] = {
    "wrench": _wrench,
    "stand": _stand,
    "ping": _pings,
    "period": _periods,
    "flight": _flight,
}
