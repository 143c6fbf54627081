"""Read what sines need beside forces: reports of crossings, round trips, and an index that lists files of runs."""

import csv
import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, finding
from cfid.recordings.outliers import outliers
from cfid.recordings.recording import TIME, Array, How, Series
from cfid.recordings.table import read_table
from cfid.recordings.times import time_column
from cfid.records.files import read_small
from cfid.records.parameters import Source
from cfid.records.run import losses, run_at
from cfid.units import FULL_COMMAND

CROSSINGS, PINGS = "crossings", "pings"

_COMMAND, _SAMPLE, _CLOCK, _RTT = "thrust_rec", "sample", "vehicle", "rtt"
_CALLED = {
    _COMMAND: re.compile(r"thrust_rec|command|cmd|pwm|thrust", re.IGNORECASE),
    _SAMPLE: re.compile(r"sample(?:[ _-]?(?:index|number))?", re.IGNORECASE),
    _CLOCK: re.compile(r"(?:vehicle|device|drone|crazyflie|cf)(?:[ _-]?(?:time|timestamp|clock))?", re.IGNORECASE),
    _RTT: re.compile(r"rtt|round[ _-]?trip(?:[ _-]?time)?|latency|ping", re.IGNORECASE),
}
_USUAL_UNITS = {TIME: "s", _CLOCK: "us"}  # where a name has none
_LONGEST_STEP_S = 60.0  # from one report or ping to the next, and by when an answer comes, if at all
_STAMP_OFF_S = 1.0  # by which a wrong stamp of the vehicle's is off the others


@dataclass(frozen=True, kw_only=True)
class CrossingRecord:
    """Reports (n,): host times in seconds, commands, and where the vehicle reported them, samples and microseconds."""

    path: Path
    source: Source
    host_s: Array
    command: Array
    sample: Array | None
    vehicle_us: Array | None
    findings: tuple[Finding, ...]


@dataclass(frozen=True, kw_only=True)
class PingRecord:
    """Round-trip times (n,) in seconds; the host's times of sending and the vehicle's of answering, where known.

    `circumstances` is the operator's note.
    """

    path: Path
    source: Source
    rtt_s: Array
    sent_s: Array | None
    vehicle_us: Array | None
    circumstances: str
    findings: tuple[Finding, ...]

    @property
    def name(self) -> str:
        """The run's name, or the file's."""
        return self.path.stem


def read_crossings(path: Path) -> CrossingRecord:
    """Read a run's crossings, or a table with a time and `thrust_rec`, and `sample` and `vehicle_us` if it has both.

    Raises DataError with file, line and next step.
    """
    run = run_at(path)
    file = path if run is None else run.device_file(CROSSINGS)
    series, source = _events(file, How(), (TIME, _COMMAND), (_SAMPLE, _CLOCK), of_run=run is not None)
    stamped = {_SAMPLE, _CLOCK} <= set(series.names)
    command = series.column(_COMMAND).values
    if run is None and not np.all((command >= 0) & (command <= FULL_COMMAND)):
        row = int(np.argmin((command >= 0) & (command <= FULL_COMMAND)))
        raise DataError(
            f"{series.line(row)}: a command of {command[row]:g}: it is 0 to {FULL_COMMAND}. Correct that line, or the "
            "unit of the column.",
            code="impossible-command",
        )
    return CrossingRecord(
        path=file,
        source=source,
        host_s=_times(series),
        command=command,
        sample=series.column(_SAMPLE).values if stamped else None,
        vehicle_us=_microseconds(series) if stamped else None,
        findings=series.findings,
    )


def read_pings(path: Path, how: How | None = None) -> PingRecord:
    """Read a run of `cfid log ping`, or a table with a column rtt_s, and t and vehicle_us if it has them.

    Raises DataError with file, line and next step, ConfigError for a column without a unit.
    """
    run = run_at(path)
    file = path if run is None else run.device_file(PINGS)
    series, source = _events(file, how or How(), (_RTT,), (TIME, _CLOCK), of_run=run is not None)
    timed, stamped = TIME in series.names, _CLOCK in series.names
    notes = [] if run is None else losses(run, run.header.devices[PINGS], series.rows)
    rtt_s = series.si(_RTT, "s")
    possible = (rtt_s > 0) & (rtt_s < _LONGEST_STEP_S)
    if not possible.all():
        row = int(np.argmin(possible))
        raise DataError(
            f"{series.line(row)}: a round trip of {rtt_s[row]:.6g} s: it takes more than zero seconds, and "
            f"{_LONGEST_STEP_S:g} at most. Correct that line, or the unit of the column.",
            code="impossible-trip",
        )
    if run is None and stamped and timed:
        off = outliers(1e-6 * _microseconds(series) - _times(series), _STAMP_OFF_S)
        if off.any():
            row = int(np.argmax(off))
            raise DataError(
                f"{series.line(row)}: a stamp of {series.column(_CLOCK).values[row]:.9g}, off the vehicle's clock in "
                "the rows around. Correct that line.",
                code="stamp-off",
            )
    return PingRecord(
        path=path,
        source=source,
        rtt_s=rtt_s,
        sent_s=_times(series) if timed else None,
        vehicle_us=_microseconds(series) if stamped else None,
        circumstances="" if run is None else run.header.label.note or "",
        findings=(*(one.at(path.name) for one in notes), *series.findings),
    )


def _events(
    path: Path, how: How, needed: Sequence[str], optional: Sequence[str], *, of_run: bool
) -> tuple[Series, Source]:
    """Return a table of events under the names of its columns here, without rows that lack a number, and its source.

    Raises DataError for a column that is missing, or that several are called.
    """
    how.refuse_unused(path, "columns", "units", "skip_lines", "decimal", "rows")
    table = read_table(path, how, of_run=of_run)
    times = time_column(table, how)
    columns = []
    for name in (*needed, *optional):
        if table.layout.has_head:
            called = _CALLED.get(name)
            there = [one for one in table.columns if (one is times if called is None else called.fullmatch(one.name))]
            there = there or [one for one in table.columns if called is not None and called.fullmatch(one.head)]
        else:  # time and command, as in the thesis' files
            there = list(table.columns[needed.index(name) :][:1]) if name in needed else []
        if len(there) > 1 or (not there and name in needed):
            what = "more than one" if there else "no"
            raise DataError(
                f"{path}: {what} column of {name} among {', '.join(table.heads)}. Is it the file of another device?",
                code="no-column",
            )
        columns += [replace(one, name=name, unit=one.unit or _USUAL_UNITS.get(name, "")) for one in there]
    series = Series(
        name=path.stem,
        path=path,
        columns=tuple(columns),
        rows=table.rows,
        line_of_row=table.line_of_row,
        findings=table.findings,
    )
    return series.complete(series.names), table.source


def _times(series: Series) -> Array:
    """Return times of events (n,) in s by the file's clock.

    Raises DataError where they go back, and ConfigError where events would be more than a minute apart.
    """
    time_s = series.si(TIME, "s")
    steps = np.diff(time_s)
    if np.any(steps < 0):
        raise DataError(
            f"{series.line(int(np.argmax(steps < 0)) + 1)}: time goes back. Was the clock set, or are two recordings "
            "in one file?",
            code="time-goes-back",
        )
    if len(steps) and float(np.median(steps)) > _LONGEST_STEP_S:
        raise ConfigError(
            f"{series.path}: the rows of column '{series.column(TIME).head}' would be {float(np.median(steps)):.4g} s "
            "apart: write its unit into its name, as in t_ms.",
            code="no-unit",
        )
    return time_s


def _microseconds(series: Series) -> Array:
    """Return the vehicle's clock (n,) in microseconds."""
    column = series.column(_CLOCK)
    return column.values if column.unit == "us" else 1e6 * series.si(_CLOCK, "s")


@dataclass(frozen=True, kw_only=True)
class IndexRow:
    """A row of an index: its fields by column, its file and its line."""

    path: Path
    line: int
    fields: Mapping[str, str]

    def number(self, column: str) -> float:
        """Return a finite number. Raises DataError with file and line."""
        text = self.fields[column]
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise self.fault(f"'{text}' in column '{column}' is not a number with a decimal point.")
        return value

    def whole(self, column: str, least: int, most: int) -> int:
        """Return a whole number within bounds. Raises DataError with file and line."""
        value = self.number(column)
        if not (value.is_integer() and least <= value <= most):
            raise self.fault(f"{column} is {value:g}: it should be a whole number from {least} to {most}.")
        return int(value)

    def file(self, column: str) -> Path:
        """Return a path, relative to the index. Raises DataError where there is none."""
        if not self.fields[column]:
            raise self.fault(f"column '{column}' is empty.")
        return self.path.parent / self.fields[column]

    def fault(self, what: str) -> DataError:
        """Return an error that names the file and the line."""
        return DataError(f"{self.path}:{self.line}: {what}")


class Index(NamedTuple):
    """The rows of an index, its file, and findings about it."""

    rows: list[IndexRow]
    source: Source
    findings: tuple[Finding, ...]


def read_index(path: Path, *, columns: Sequence[str], optional: Sequence[str] = ()) -> Index:
    """Read a CSV file with a header of the named columns, in any order. Raises DataError with file and line."""
    try:
        content = read_small(path)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.", code="unreadable") from None
    if b"\0" in content:
        raise DataError(f"{path}: no text: an index is a CSV file.")
    text = content.decode("utf-8-sig", errors="replace")
    lines = [(at, line) for at, line in enumerate(text.splitlines(), start=1) if line.strip()]
    separator = next((sign for sign in (";", "\t") if lines and sign in lines[0][1]), ",")
    table = [(at, _fields(line, separator)) for at, line in lines]
    names = table[0][1] if table else []
    wrong = [name for name in (*columns, *optional) if names.count(name) != (name in columns or name in names)]
    if wrong:
        wanted = ",".join(columns) + "".join(f"[,{name}]" for name in optional)
        raise DataError(f"{path}: no column {', '.join(wrong)}, or several: its header should be {wanted}.")
    if len(table) == 1:
        raise DataError(f"{path}: a header and no rows: it names no run.", code="no-rows")
    for line, fields in table[1:]:
        if len(fields) != len(names):
            raise DataError(f"{path}:{line}: {counted(len(fields), 'field')} where its header has {len(names)}.")
    unused = ", ".join(name for name in names if name not in (*columns, *optional))
    findings = [finding("index-unused", names=unused, known=", ".join(optional))] if unused else []
    return Index(
        [IndexRow(path=path, line=line, fields=dict(zip(names, fields, strict=True))) for line, fields in table[1:]],
        Source(str(path), hashlib.sha256(content).hexdigest()),
        tuple(one.at(path.name) for one in findings),
    )


def _fields(line: str, separator: str) -> list[str]:
    return [field.strip() for field in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
