"""Read the reports of a sine's crossings from a run folder or any CSV file.

The analysis assigns them to samples of the sine and finds missing ones.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cfid.counted import counted
from cfid.errors import DataError
from cfid.findings import Finding, of_recording
from cfid.records.parameters import Source
from cfid.records.run import run_at
from cfid.records.tables.blocks import open_table
from cfid.records.tables.schema import TIME, Column, TableSchema, TimeUnit
from cfid.records.tables.table import Array, CsvTable
from cfid.records.tables.times import (
    MISSING_SHARE,
    TIME_COLUMN,
    VEHICLE_CLOCK,
    known_rows,
    line_notes,
    seconds_of,
    vehicle_us,
)
from cfid.units import FULL_COMMAND

CROSSINGS = "crossings"

_COMMAND, _SAMPLE, _VEHICLE = "thrust_rec", "sample", VEHICLE_CLOCK.key
SCHEMA = TableSchema(
    columns=(
        TIME_COLUMN,
        Column(_COMMAND, re.compile(r"thrust_rec|command|cmd|pwm|thrust", re.IGNORECASE), _COMMAND),
        Column(_SAMPLE, re.compile(r"sample(?:[ _-]?(?:index|number))?", re.IGNORECASE), _SAMPLE, optional=True),
        VEHICLE_CLOCK,
    ),
    hint="It should hold the commands that the vehicle reported. Is it the file of another device?",
)


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


def read_crossings(path: Path, *, time_unit: TimeUnit | None = None) -> CrossingRecord:
    """Read a run's crossings, or a CSV file with a time and `thrust_rec`, and `sample` and `vehicle_us` if it has both.

    A file without a header has time and command in its first two columns, like the thesis' files. From a file
    outside a run, rows without a number, with single wrong times or commands, and repeated rows are left out: a missing
    report affects nothing else.
    Raises DataError with file, line and next step.
    """
    run = run_at(path)
    path = path if run is None else run.device_file(CROSSINGS)
    table = open_table(path)
    places = SCHEMA.places(table) if table.has_head else {TIME: "1", _COMMAND: "2"}
    stamped = {_SAMPLE, _VEHICLE} <= places.keys()
    keys = (TIME, _COMMAND, *((_SAMPLE, _VEHICLE) if stamped else ()))
    names = [places[key] for key in keys]
    table, values, left_out = known_rows(table, names, timed=True) if run is None else (table, table.numbers(names), ())
    if run is None:
        table, values, faulty = _without_faults(table, values)
        left_out = (*left_out, *faulty)
    columns = dict(zip(keys, values.T, strict=True))
    host_s = seconds_of(table, places[TIME], values[:, 0], unit=time_unit)
    backwards = np.flatnonzero(np.diff(host_s) < 0)
    if len(backwards):
        line = table.line_of_row(int(backwards[0]) + 1)
        raise DataError(f"{path}:{line}: time goes back. Was the clock set, or are two recordings in one file?")
    return CrossingRecord(
        path=path,
        source=Source(str(path), table.sha256),
        host_s=host_s,
        command=values[:, 1],
        sample=values[:, 2] if stamped else None,
        vehicle_us=vehicle_us(table, places, columns) if stamped else None,
        findings=of_recording(path.name, (*left_out, *line_notes(table))),
    )


def _without_faults(table: CsvTable, values: Array) -> tuple[CsvTable, Array, tuple[str, ...]]:
    """Return a table and its values (n, k) without rows that repeat the one before, and single impossible commands."""
    notes = []
    repeated = np.append(False, np.all(np.diff(values, axis=0) == 0, axis=1)) if len(values) else np.zeros(0, bool)
    impossible = ~((values[:, 1] >= 0) & (values[:, 1] <= FULL_COMMAND))
    if np.count_nonzero(impossible) > max(MISSING_SHARE * len(values), 1):
        impossible[:] = False  # of another unit: the analysis reports with what they are compared
    for wrong, one, many in (
        (repeated, "that repeats the one before is", "that repeat the one before are"),
        (impossible & ~repeated, "whose command is not 0 to 65535 is", "whose commands are not 0 to 65535 are"),
    ):
        if count := int(np.count_nonzero(wrong)):
            row = int(np.argmax(wrong))
            first = f"first: {values[row, 1]:g} in line {table.line_of_row(row)}"
            notes.append(f"{counted(count, 'report')} {one if count == 1 else many} left out ({first}).")
    wrong = repeated | impossible
    return table.without(np.flatnonzero(wrong)), values[~wrong], tuple(notes)
