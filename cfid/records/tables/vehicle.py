"""Read a run's commands, vehicle log and instrument readings as arrays.

Times are in seconds since the Unix epoch, as in every file of a run; `begin_s` of another device's file relates them
to a record that counts from its first sample.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cfid.errors import DataError
from cfid.findings import Finding, of_recording
from cfid.records.files import check_regular
from cfid.records.parameters import Source
from cfid.records.run import Run
from cfid.records.tables.blocks import open_table
from cfid.records.tables.line_faults import REPAIR
from cfid.records.tables.table import Array
from cfid.records.tables.text import is_finite, short
from cfid.records.tables.times import line_notes
from cfid.units import MOTORS, RPM

COMMANDS, READINGS, VEHICLE_LOG, SUPERVISOR = "commands", "readings", "crazyflie", "supervisor"
TACHOMETER, SCALES = "tachometer", "scales"

ENOUGH = 0.98  # of the time for which a step should be held: from there on it counts as held

_LONGEST_LINE = 1 << 20  # bytes
_WITHDRAWN = "withdrawn"
_NO_VALUES = ("t", _WITHDRAWN)
_MOTORS = ("m1", "m2", "m3", "m4")


class TakenBackError(DataError):
    """Every reading of a run was taken back, as if none had been typed."""


@dataclass(frozen=True, kw_only=True)
class Rows:
    """A device's file: times (n,) in Unix seconds, every other column (n,) by its name, and findings on its lines."""

    source: Source
    time_s: Array
    columns: Mapping[str, Array]
    findings: tuple[Finding, ...]


def holds(run: Run, device: str) -> bool:
    """Return whether a run has rows of a device; for a run that was not closed, the device's file shows it."""
    record = run.header.devices.get(device)
    if record is None or record.rows is not None:
        return record is not None and record.rows != 0
    return _has_row(run.device_file(device))


def _has_row(path: Path) -> bool:
    """Return whether a file has a whole line below its header; True where it is unreadable, as its reader reports."""
    try:
        if not path.is_file():
            return True
        with path.open("rb") as file:
            return bool(file.readline(_LONGEST_LINE)) and file.readline(_LONGEST_LINE).endswith(b"\n")
    except OSError:
        return True


def read_rows(run: Run, device: str) -> Rows:
    """Read a device's file. Raises DataError naming the file when it is missing, empty or not a table."""
    path = run.device_file(device)
    table = open_table(path)
    values = table.numbers(table.names)
    if not len(values):
        raise DataError(f"{path}: has no rows.")
    if table.names[0] != "t" or np.any(np.diff(values[:, 0]) < 0):
        raise DataError(f"{path}: its first column is not an increasing time 't': it is not a device's file of a run.")
    if device == READINGS and _WITHDRAWN in table.names:
        values = _not_withdrawn(values, table.names.index(_WITHDRAWN))
        if not len(values):
            raise TakenBackError(f"{path}: every reading was taken back.")
    columns = {name: column for name, column in zip(table.names, values.T, strict=True) if name not in _NO_VALUES}
    return Rows(
        source=Source(str(path), table.sha256),
        time_s=values[:, 0],
        columns=columns,
        findings=of_recording(f"{run.folder.resolve().name}/{path.name}", line_notes(table)),
    )


def _not_withdrawn(values: Array, place: int) -> Array:
    """Return the rows of readings without those that were taken back, and without the rows that take them back."""
    kept: list[int] = []
    for row, withdrawn in enumerate(values[:, place]):
        if withdrawn and kept:
            kept.pop()
        elif not withdrawn:
            kept.append(row)
    return np.asarray(values[kept])


def read_commands(run: Run) -> tuple[Rows, Array]:
    """Return a run's commands: its rows, and the commands (n, 4) of motors 1 to 4. Raises DataError."""
    rows = read_rows(run, COMMANDS)
    missing = [name for name in _MOTORS if name not in rows.columns]
    if missing:
        raise DataError(f"{rows.source.path}: no column {', '.join(missing)}.")
    return rows, np.column_stack([rows.columns[name] for name in _MOTORS])


def shown_at_commands(run: Run, device: str, column: str) -> tuple[Rows, Array, Array]:
    """Return an instrument's rows, commands (n,) of the motors that ran, and the mean (n,) that it showed at each.

    Only the second half of each command counts: a display of numbers takes seconds to settle. A command during which
    a run ended early does not count, since `--resume` holds it again. Raises DataError.
    """
    shown, (log, commands) = read_rows(run, device), read_commands(run)
    ends_s = np.append(log.time_s[1:], shown.time_s[-1])
    hold_s = run.header.requested.get("hold_s")
    least_s = ENOUGH * hold_s if isinstance(hold_s, int | float) and run.header.state != "complete" else 0.0
    found = []
    for begin_s, end_s, command in zip(log.time_s, ends_s, commands.max(axis=1), strict=True):
        inside = (shown.time_s > (begin_s + end_s) / 2) & (shown.time_s <= end_s)
        if inside.any() and (command == 0 or end_s - begin_s >= least_s):
            found.append((command, shown.columns[column][inside].mean()))
    return shown, *np.reshape(found, (-1, 2)).T


def reported_speeds_rad_s(rows: Rows) -> dict[int, Array]:
    """Return the speeds (n,) in rad/s that an RPM deck or brushless motors reported, by motor; empty without any."""
    named = {motor: (f"rpm.m{motor}", f"motor.m{motor}_rpm") for motor in MOTORS}
    return {motor: RPM * rows.columns[name] for motor, names in named.items() for name in names if name in rows.columns}


def begin_s(path: Path) -> float:
    """Return the time of the first row of a device's file. Raises DataError where there is none, or no number."""
    try:
        check_regular(path)
        with path.open(encoding="utf-8", errors="replace") as file:
            file.readline()
            first = file.readline().partition(",")[0].strip()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.") from None
    if not first:
        raise DataError(f"{path}: has no rows.")
    if not is_finite(first):
        raise DataError(f"{path}:2: the time is '{short(first)}', not a number. {REPAIR}")
    return float(first)
