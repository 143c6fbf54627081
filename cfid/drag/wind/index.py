"""Read the index of recordings in wind: a CSV file with one row per recording, each of one command."""

import math
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from cfid.drag.wind.plan import WindSetting
from cfid.errors import DataError
from cfid.findings import Finding
from cfid.recordings.sines import IndexRow, read_index
from cfid.records.parameters import Source
from cfid.units import FULL_COMMAND

COLUMNS = ("command", "angle_deg", "wind_min_mps", "wind_max_mps", "tach_rpm", "loadcell")
OPTIONAL = ("azimuth_deg", "azimuth_rad", "from_s", "to_s")


class IndexedRun(NamedTuple):
    """A row of an index: the load cell's file at one command, the tachometer's reading, and a window if given."""

    where: str
    setting: WindSetting
    command: int
    tach_rpm: float | None
    loadcell: Path
    window_s: tuple[float, float] | None

    @property
    def name(self) -> str:
        """The row and the file's name."""
        return f"{self.where} {self.loadcell.name}"


def read_wind_index(path: Path) -> tuple[list[IndexedRun], Source, tuple[Finding, ...]]:
    """Read an index of recordings in wind and without, with its source and findings.

    Raises DataError with file and line for a value that is missing or not a number, and for a file in two rows.
    """
    rows, source, findings = read_index(path, columns=COLUMNS, optional=OPTIONAL)
    found = [_run_of(row) for row in rows]
    seen: dict[Path, str] = {}
    for run in found:
        if run.loadcell in seen:
            raise DataError(f"{run.where}: {run.loadcell} is the file of {seen[run.loadcell]} too: name it in one row.")
        seen[run.loadcell] = run.where
    return found, source, tuple(replace(one, quantities=("drag.*",)) for one in findings)


def _run_of(row: IndexRow) -> IndexedRun:
    return IndexedRun(
        where=f"{row.path.name}:{row.line}",
        setting=WindSetting(
            angle_deg=_maybe(row, "angle_deg"),
            min_mps=row.number("wind_min_mps"),
            max_mps=row.number("wind_max_mps"),
            azimuth_deg=_azimuth_deg(row),
        ),
        command=row.whole("command", 0, FULL_COMMAND),
        tach_rpm=_maybe(row, "tach_rpm"),
        loadcell=row.file("loadcell"),
        window_s=_window_s(row),
    )


def _maybe(row: IndexRow, column: str) -> float | None:
    return row.number(column) if row.fields.get(column) else None


def _azimuth_deg(row: IndexRow) -> float | None:
    in_deg, in_rad = _maybe(row, "azimuth_deg"), _maybe(row, "azimuth_rad")
    if in_deg is not None and in_rad is not None:
        raise row.fault("azimuth_deg and azimuth_rad are the same: fill one of them.")
    return in_deg if in_rad is None else math.degrees(in_rad)


def _window_s(row: IndexRow) -> tuple[float, float] | None:
    from_s, to_s = _maybe(row, "from_s"), _maybe(row, "to_s")
    if from_s is None and to_s is None:
        return None
    if from_s is None or to_s is None or not 0 <= from_s < to_s:
        raise row.fault("a window begins at from_s, 0 or later, and ends at a later to_s.")
    return from_s, to_s
