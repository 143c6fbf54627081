"""Read a run's commands, vehicle log and instrument readings as arrays.

Times are in seconds since the Unix epoch, as in every file of a run; `begin_s` of another device's record relates them
to a record that counts from its first sample.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cfid.errors import DataError
from cfid.findings import Finding
from cfid.recordings.recording import Array, Series
from cfid.recordings.table import read_table
from cfid.records.parameters import Source
from cfid.records.run import Run
from cfid.units import MOTORS, RPM

COMMANDS, READINGS, VEHICLE_LOG, SUPERVISOR = "commands", "readings", "crazyflie", "supervisor"
TACHOMETER, SCALES = "tachometer", "scales"

HELD_SHARE = 0.98  # of the time for which a step should be held: from there on it counts as held

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
    """Read a device's file; the few rows that lack a number are left out, with a finding.

    Raises DataError naming the file when it is missing, empty or not a table.
    """
    path = run.device_file(device)
    try:
        table = read_table(path, of_run=True)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file.", code="no-file") from None
    columns = tuple(replace(column, name=column.head) for column in table.columns)
    series = Series(
        name=device,
        path=path,
        columns=columns,
        rows=table.rows,
        line_of_row=table.line_of_row,
        findings=table.findings,
    ).complete(table.heads)
    values = {column.name: column.values for column in series.columns}
    if table.heads[0] != "t" or np.any(np.diff(values["t"]) < 0):
        raise DataError(
            f"{path}: its first column is not an increasing time 't': it is not a device's file of a run.",
            code="no-time",
        )
    if device == READINGS and _WITHDRAWN in values:
        kept = _not_withdrawn(values[_WITHDRAWN])
        if not kept:
            raise TakenBackError(f"{path}: every reading was taken back.")
        values = {name: column[kept] for name, column in values.items()}
    place = f"{run.folder.resolve().name}/{path.name}"
    return Rows(
        source=table.source,
        time_s=values["t"],
        columns={name: column for name, column in values.items() if name not in _NO_VALUES},
        findings=tuple(finding.at(place) for finding in series.findings),
    )


def _not_withdrawn(withdrawn: Array) -> list[int]:
    """Return the rows (n,) of readings that were not taken back, without the rows that take others back."""
    kept: list[int] = []
    for row, takes_back in enumerate(withdrawn):
        if takes_back and kept:
            kept.pop()
        elif not takes_back:
            kept.append(row)
    return kept


def read_commands(run: Run) -> tuple[Rows, Array]:
    """Return a run's commands: its rows, and the commands (n, 4) of motors 1 to 4. Raises DataError."""
    rows = read_rows(run, COMMANDS)
    missing = [name for name in _MOTORS if name not in rows.columns]
    if missing:
        raise DataError(f"{rows.source.path}: no column {', '.join(missing)}.", code="no-column")
    return rows, np.column_stack([rows.columns[name] for name in _MOTORS])


def shown_at_commands(run: Run, device: str, column: str) -> tuple[Rows, Array, Array, Array]:
    """Return an instrument's rows, commands (n,) of the motors that ran, the means (n,) that it showed, and their ends.

    Only the second half of each command counts: a display of numbers takes seconds to settle. A command during which
    a run ended early does not count, since `--resume` holds it again. Raises DataError.
    """
    shown, (log, commands) = read_rows(run, device), read_commands(run)
    ends_s = np.append(log.time_s[1:], shown.time_s[-1])
    hold_s = run.header.requested.get("hold_s")
    least_s = HELD_SHARE * hold_s if isinstance(hold_s, int | float) and run.header.state != "complete" else 0.0
    means = []
    for step_s, end_s, command in zip(log.time_s, ends_s, commands.max(axis=1), strict=True):
        inside = (shown.time_s > (step_s + end_s) / 2) & (shown.time_s <= end_s)
        if inside.any() and (command == 0 or end_s - step_s >= least_s):
            means.append((command, shown.columns[column][inside].mean(), end_s))
    return shown, *np.reshape(means, (-1, 3)).T


def reported_speeds_rad_s(rows: Rows) -> dict[int, Array]:
    """Return the speeds (n,) in rad/s that an RPM deck or brushless motors reported, by motor; empty without any."""
    named = {motor: (f"rpm.m{motor}", f"motor.m{motor}_rpm") for motor in MOTORS}
    return {motor: RPM * rows.columns[name] for motor, names in named.items() for name in names if name in rows.columns}
