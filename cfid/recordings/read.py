"""Decide what a path is, a run folder or which kind of file, and read it as a recording."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.recordings.blackbox import BEGIN as BLACKBOX
from cfid.recordings.blackbox import read_blackbox
from cfid.recordings.crazyflie import crazyflie_unit, is_flown, vehicle_of
from cfid.recordings.matlab import is_matlab, read_matlab
from cfid.recordings.recording import ENCODER, TIME, Column, Facts, How, Kind, Recording, Series, is_angle
from cfid.recordings.stand import STAND, is_stand
from cfid.recordings.table import Table, layout_of, read_table
from cfid.recordings.times import series_of
from cfid.recordings.ulog import BEGIN as ULOG
from cfid.recordings.ulog import read_ulog
from cfid.recordings.usd import is_usd, read_usd
from cfid.recordings.wrench import AXES, LOADCELL, described_above
from cfid.records.files import RUN_FILE, check_regular, sha256_of
from cfid.records.parameters import Source
from cfid.records.run import DeviceRecord, Run, losses, read_run
from cfid.units import factor, split_unit

_BEGIN_BYTES, _HEAD_BYTES = 64, 1 << 16
_LISTED = 8  # series, and columns of one unit, that one line names
_UNIT_WORDS = {"": "an unknown unit", "1": "plain numbers"}

# By kind, the names of columns of which any one shows it; a stand is known by several.
_NAMES: Mapping[Kind, re.Pattern[str]] = {
    "wrench": re.compile(r"[ft][xyz]", re.IGNORECASE),
    "ping": re.compile(r"rtt|round[ _-]?trip(?:[ _-]?time)?|latency|ping", re.IGNORECASE),
    "period": re.compile(r"periods?", re.IGNORECASE),
}
_PROGRAMS: Mapping[Kind, str] = {
    "angle": "table of angles",
    "wrench": "table of forces",
    "stand": "thrust stand",
    "ping": "table of pings",
    "period": "table of periods",
}
# The columns that `columns` names without a name for each, by how many there are.
_IN_ORDER: Mapping[int, tuple[str, ...]] = {1: (TIME,), 2: (TIME, "phi"), 7: (TIME, *AXES)}
_IN_ORDER_AT_A_RATE: Mapping[int, tuple[str, ...]] = {1: ("phi",), 6: AXES}


def read_recording(path: Path | str, how: How | None = None, *, kind: Kind | None = None) -> Recording:
    """Read a run folder, whose series are read when they are asked for, or a file of any kind.

    A table without a `kind` is read as that which its columns show, and otherwise as a vehicle's log. Raises DataError
    for what cannot be read, ConfigError for what `how` has to state, or states and nothing uses.
    """
    path, how = Path(path), how or How()
    try:
        is_run = path.is_dir()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.", code="unreadable") from None
    if is_run:
        how.refuse_unused(path)
        return of_run(read_run(path))
    begin = _begin_of(path, _BEGIN_BYTES)
    if is_usd(begin):
        return read_usd(path, how)
    if begin.startswith(ULOG):
        return read_ulog(path, how)
    if begin.startswith(BLACKBOX):
        return read_blackbox(path, how)
    named = _with_names(how)
    table = read_matlab(path, named) if is_matlab(path) else read_table(path, named)
    return _of_table(table, named, kind or kind_of(table.columns))


def _begin_of(path: Path, size: int) -> bytes:
    """Return the first bytes of a file. Raises DataError for what is no file, or cannot be read."""
    try:
        check_regular(path)
        with path.open("rb") as file:
            return file.read(size)
    except (FileNotFoundError, ValueError):  # a name with a zero byte
        raise DataError(f"{path}: no such file.", code="no-file") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.", code="unreadable") from None


def is_binary_log(path: Path) -> bool:
    """Return whether a file is a vehicle's binary log, not a table: uSD card, ULog or blackbox."""
    try:
        begin = _begin_of(path, _BEGIN_BYTES)
    except DataError:
        return False
    return is_usd(begin) or begin.startswith((ULOG, BLACKBOX))


def kind_at(path: Path) -> Kind | None:
    """Return the kind of a file by its first lines; None where they do not show it. Raises DataError for no table."""
    begin = _begin_of(path, _HEAD_BYTES)
    if is_binary_log(path):
        return "flight"
    if is_matlab(path):
        return kind_of(read_matlab(path).columns)
    heads = layout_of(path, begin, How()).heads
    named = ((head, *split_unit(head)) for head in heads)
    return kind_of([Column(name=name, unit=unit, values=np.empty(0), head=head) for head, name, unit in named])


def kind_of(columns: Sequence[Column]) -> Kind | None:
    """Return the kind of a table, by the names of its columns; None where they do not show it."""
    if any(is_flown(column.head or column.name) for column in columns):
        return "flight"
    for kind, pattern in _NAMES.items():
        if any(pattern.fullmatch(column.name) for column in columns):
            return kind
    if any(is_angle(column.name) or (column.name.isdecimal() and factor(column.unit, "rad")) for column in columns):
        return "angle"  # by its name, or by a unit that was stated for a column without one
    return "stand" if is_stand(columns) else None


def description(recording: Recording) -> str:
    """Return one line: the program, and for each series its rows, rate and columns with their units as read."""
    series = sorted(recording.series.values(), key=lambda one: not any(column.unit for column in one.columns))
    more = f"; and {len(series) - _LISTED} more series" if len(series) > _LISTED else ""
    program = f"{recording.facts.program}; " if recording.facts.program else ""
    return f"{recording.path.name}: {program}{'; '.join(map(_described, series[:_LISTED]))}{more}."


def of_run(run: Run) -> Recording:
    """Return a run folder's recording, a series for each device that has rows, in the devices' own units."""
    header, path = run.header, run.folder / RUN_FILE
    origin = header.origin
    return Recording(
        path=run.folder,
        source=Source(str(path), sha256_of(path)),
        series=_Devices(
            {
                device: partial(_device, run, device, record)
                for device, record in header.devices.items()
                if record.rows != 0
            }
        ),
        facts=Facts(
            program="run of cfid" if origin is None else origin.program,
            label=header.label,
            begin_s=header.started.timestamp(),
            clock="computer" if origin is None else origin.clock,
            props_out=None if origin is None else origin.props_out,
            square=None if origin is None else origin.square,
            motors=None if origin is None else origin.motors,
            simulated=header.simulated,
        ),
        run=run,
    )


class _Devices(Mapping[str, Series]):
    """The series of a run folder, each read when it is first asked for."""

    def __init__(self, readers: Mapping[str, Callable[[], Series]]) -> None:
        self._readers = readers
        self._read: dict[str, Series] = {}

    def __getitem__(self, device: str) -> Series:
        if device not in self._read:
            self._read[device] = self._readers[device]()
        return self._read[device]

    def __iter__(self) -> Iterator[str]:
        return iter(self._readers)

    def __len__(self) -> int:
        return len(self._readers)


def _device(run: Run, device: str, record: DeviceRecord) -> Series:
    """Read a device's file; its columns keep their names. Raises DataError for another kind of file."""
    path = run.device_file(device)
    table = read_table(path, of_run=True)
    timed = table.heads[0] == TIME
    if not timed and device != STAND:  # whose settled points have no times
        raise DataError(
            f"{path}: its first column is not the time '{TIME}': it is not a device's file of a run.", code="no-time"
        )
    table = replace(table, columns=tuple(_of_device(device, column, record) for column in table.columns))
    series = series_of(table, How(), name=device, timed=timed)
    name = run.folder.resolve().name
    lost = (one.at(name) for one in losses(run, record, series.rows))
    return replace(series, findings=(*lost, *(one.at(f"{name}/{record.file}") for one in series.findings)))


def _of_device(device: str, column: Column, record: DeviceRecord) -> Column:
    """Return a column of a device's file with the unit that the run states; "" where only its reader knows it."""
    extra, head = record.model_extra or {}, column.head
    # Version 0.2 kept units in names, as in `gyro.x_[rad/s]`.
    name = column.name if crazyflie_unit(column.name) and not crazyflie_unit(head) else head
    unit = (record.channel_units or {}).get(head) or crazyflie_unit(head) or column.unit
    if head == TIME:
        unit = "s"
    elif device == ENCODER and head == "phi":
        unit = "counts" if record.counts_per_turn else str(extra.get("angle_unit") or "")
    elif device == LOADCELL and head in AXES:
        unit = ("N" if head.startswith("F") else "N m") if extra.get("units") == "n,nm" else "counts"
    scale, _, counted_in = unit.partition(" ")  # version 0.2 stated steps of a count, as in `0.00048828125 g`
    if counted_in and scale[:1].isdecimal():
        return replace(column, name=name, unit=counted_in, values=column.values * float(scale))
    return replace(column, name=name, unit=unit)


def _of_table(table: Table, how: How, kind: Kind | None) -> Recording:
    """Return the recording of a text table: one series, over its times where a column or a rate gives them."""
    if kind in (None, "flight"):
        return vehicle_of(table, how)
    if kind == "wrench":
        table, how = described_above(table, how)
    series = series_of(table, how, name=table.path.stem, sort=kind == "stand", timed=kind in ("angle", "wrench"))
    return Recording(
        path=table.path,
        source=table.source,
        series={series.name: series},
        facts=Facts(program=_PROGRAMS[kind], begin_s=series.begin_s),
    )


def _with_names(how: How) -> How:
    """Return settings in which every column of `columns` has a name, that of the kind with as many columns."""
    if not how.columns or any("=" in word for word in how.columns):
        return how
    names = (_IN_ORDER if how.rate_hz is None else _IN_ORDER_AT_A_RATE).get(len(how.columns))
    if names is None:
        raise ConfigError(
            f"`columns` {','.join(how.columns)}: name each, as in t=1,phi=2; without names they are time and angle, or "
            "time, Fx, Fy, Fz, Tx, Ty and Tz, or with `rate_hz` these without the time.",
            code="columns",
        )
    return replace(how, columns=tuple(f"{name}={word}" for name, word in zip(names, how.columns, strict=True)))


def _described(series: Series) -> str:
    steps = np.zeros(0) if series.time_s is None else np.diff(series.time_s[: 1 << 16])
    rate = f" at {1 / np.median(steps[steps > 0]):.0f} Hz" if np.any(steps > 0) else ""
    by_unit: dict[str, list[str]] = {}
    for column in series.columns:
        by_unit.setdefault(_UNIT_WORDS.get(column.unit, column.unit), []).append(column.name)
    columns = ", ".join(f"{_listed(names)} in {unit}" for unit, names in by_unit.items()) or "times alone"
    return f"{series.name}, {counted(series.rows, 'row')}{rate}: {columns}"


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return " ".join(names[:_LISTED]) + more
