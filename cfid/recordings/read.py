"""Decide what a path is, a run folder or which kind of file, and read it as a recording."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from cfid.counted import counted
from cfid.errors import DataError
from cfid.findings import of_recording
from cfid.recordings.blackbox import BEGIN as BLACKBOX
from cfid.recordings.blackbox import read_blackbox
from cfid.recordings.crazyflie import crazyflie_unit, vehicle_of
from cfid.recordings.matlab import is_matlab, read_matlab
from cfid.recordings.recording import Facts, How, Recording, Series
from cfid.recordings.table import read_table
from cfid.recordings.times import TIME, series_of
from cfid.recordings.ulog import BEGIN as ULOG
from cfid.recordings.ulog import read_ulog
from cfid.recordings.usd import is_usd, read_usd
from cfid.records.files import RUN_FILE, check_regular, sha256_of
from cfid.records.parameters import Source
from cfid.records.run import DeviceRecord, Run, losses, read_run

_BEGIN_BYTES = 64
_LISTED = 8  # series, and columns of one unit, that one line names
_UNIT_WORDS = {"": "an unknown unit", "1": "plain numbers"}


def read_recording(path: Path | str, how: How | None = None) -> Recording:
    """Read a run folder, whose series are read when they are asked for, or a file of any kind.

    Raises DataError for what cannot be read, ConfigError for what `how` has to state, or states and nothing uses.
    """
    path, how = Path(path), how or How()
    try:
        check_regular(path)
        if path.is_dir():
            how.refuse_unused(path)
            return of_run(read_run(path))
        with path.open("rb") as file:
            begin = file.read(_BEGIN_BYTES)
    except (FileNotFoundError, ValueError):  # a name with a zero byte
        raise DataError(f"{path}: no such file.", code="no-file") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.", code="unreadable") from None
    if is_usd(begin):
        return read_usd(path, how)
    if begin.startswith(ULOG):
        return read_ulog(path, how)
    if begin.startswith(BLACKBOX):
        return read_blackbox(path, how)
    return vehicle_of(read_matlab(path, how) if is_matlab(path) else read_table(path, how), how)


def is_binary_log(path: Path) -> bool:
    """Return whether a file is a vehicle's binary log, not a table: uSD card, ULog or blackbox."""
    try:
        check_regular(path)
        with path.open("rb") as file:
            begin = file.read(_BEGIN_BYTES)
    except OSError:
        return False
    return is_usd(begin) or begin.startswith((ULOG, BLACKBOX))


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
    """Read a device's file, with the units of the run. Raises DataError for a file that is none of a device."""
    path = run.device_file(device)
    table = read_table(path)
    if table.heads[0] != TIME:
        raise DataError(
            f"{table.path}: its first column is not the time '{TIME}': it is not a device's file of a run.",
            code="no-time",
        )
    columns = []
    for column in table.columns:
        name = column.name if crazyflie_unit(column.name) and not crazyflie_unit(column.head) else column.head
        unit = "s" if name == TIME else (record.channel_units or {}).get(column.head) or crazyflie_unit(column.head)
        scale, _, counted_in = unit.partition(" ")  # version 0.2 stated steps of a count, as in `0.00048828125 g`
        values = column.values
        if counted_in and scale[:1].isdecimal():
            unit, values = counted_in, values * float(scale)
        columns.append(replace(column, name=name, unit=unit or column.unit, values=values))
    series = series_of(replace(table, columns=tuple(columns)), How(), name=device)
    notes = of_recording(f"{run.folder.resolve().name}/{record.file}", losses(run, record, series.rows))
    return replace(series, findings=(*series.findings, *notes))


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
