"""Read the reports of a sine's crossings from a run folder or any CSV file.

The analysis assigns them to samples of the sine and finds missing ones.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cfid.errors import DataError
from cfid.records.parameters import Source
from cfid.records.run import Run
from cfid.records.tables.table import Array, CsvTable, open_table
from cfid.records.tables.times import CUT_LINE, TimeUnit, seconds_of, time_column

CROSSINGS = "crossings"

_COMMAND, _SAMPLE, _VEHICLE = "thrust_rec", "sample", "vehicle_us"


@dataclass(frozen=True, kw_only=True)
class CrossingRecord:
    """Reports (n,): host times in seconds, commands, and where the vehicle reported them, samples and microseconds."""

    path: Path
    source: Source
    host_s: Array
    command: Array
    sample: Array | None
    vehicle_us: Array | None
    notes: tuple[str, ...]


def read_run_crossings(run: Run) -> CrossingRecord:
    """Read the crossings of a run. Raises DataError naming the file."""
    return read_crossings(run.device_file(CROSSINGS))


def read_crossings(path: Path, *, time_unit: TimeUnit | None = None) -> CrossingRecord:
    """Read a CSV file with a time and `thrust_rec`, and `sample` and `vehicle_us` where it has both.

    A file without a header has time and command in its first two columns, like the thesis' files. Raises DataError with
    file, line and next step.
    """
    table = open_table(path)
    time = time_column(table, "a header t,thrust_rec") if table.has_head else "1"
    stamped = table.has_head and {_SAMPLE, _VEHICLE} <= set(table.names)
    columns = [time, _command(table), *((_SAMPLE, _VEHICLE) if stamped else ())]
    values = table.numbers(columns)
    host_s = seconds_of(table, time, values[:, 0], unit=time_unit)
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
        vehicle_us=values[:, 3] if stamped else None,
        notes=(f"{path.name}: {CUT_LINE}",) if table.cut else (),
    )


def _command(table: CsvTable) -> str:
    if not table.has_head:
        return "2"
    if _COMMAND not in table.names:
        raise DataError(
            f"{table.path}: no column {_COMMAND} among {table.listing}: it should hold the commands that the vehicle "
            "reported. Is it the file of another device?"
        )
    return _COMMAND
