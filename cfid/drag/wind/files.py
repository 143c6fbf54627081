"""The files of `cfid fit drag`: an index of recordings, a row a run, and a table of forces that are reduced already."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from cfid.errors import DataError
from cfid.records.tables.index import IndexRow, read_index
from cfid.units import FULL_COMMAND

if TYPE_CHECKING:
    from cfid.drag.experiments import DragExperiments
    from cfid.records.parameters import Source

INDEX_COLUMNS = ("command", "angle_deg", "wind_min_mps", "wind_max_mps", "tach_rpm", "loadcell")
INDEX_MAY_HAVE = ("azimuth_deg", "azimuth_rad", "from_s", "to_s")
TABLE_COLUMNS = (
    "command", "angle_deg", "vx_mps", "vy_mps", "vz_mps", "speed_sum_rad_s", "fx_n", "fy_n", "fz_n",
)  # fmt: skip


class WindRow(NamedTuple):
    """A row of an index; None where it leaves a field empty."""

    where: str
    command: int
    angle_deg: float | None
    min_mps: float
    max_mps: float
    tach_rpm: float | None
    loadcell: Path
    azimuth_deg: float | None
    window_s: tuple[float, float] | None


def read_wind_index(path: Path) -> "tuple[list[WindRow], Source, tuple[str, ...]]":
    """Read an index of recordings in wind and without; with its source and what is to be said of it.

    Raises DataError with file and line for what is missing or no number, and for a file that two rows name.
    """
    rows, source, notes = read_index(path, columns=INDEX_COLUMNS, optional=INDEX_MAY_HAVE)
    found = [_row(row) for row in rows]
    _check_files(found)
    return found, source, notes


def read_reduced(path: Path) -> "tuple[DragExperiments, Source, tuple[str, ...]]":
    """Read a table of reduced forces. Raises DataError naming the file, and the line of what is no number."""
    from cfid.drag.experiments import UNSTATED_WIND_STD, experiments_from_table
    from cfid.records.parameters import Source
    from cfid.records.tables.table import open_table

    table = open_table(path)
    missing = [name for name in TABLE_COLUMNS if name not in table.names]
    if missing:
        wanted = ",".join(TABLE_COLUMNS)
        raise DataError(f"{path}: no column {', '.join(missing)} among {table.listing}: its head should be {wanted}.")
    values = table.numbers(TABLE_COLUMNS)
    try:
        experiments = experiments_from_table(
            command=values[:, 0],
            angle_deg=values[:, 1],
            velocity_mps=values[:, 2:5],
            speed_sum_rad_s=values[:, 5],
            force_n=values[:, 6:],
        )
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    left_out = len(values) - len(experiments.command)
    notes = [f"{left_out} row(s) without wind or with standing rotors hold no drag: not used."] if left_out else []
    notes.append(
        f"a table of forces states no noise, which the models' residuals tell; its winds are taken to be known to "
        f"{100 * UNSTATED_WIND_STD:g} %."
    )
    return experiments, Source(str(path), table.sha256), tuple(f"{path.name}: {note}" for note in notes)


def _row(row: IndexRow) -> WindRow:
    return WindRow(
        where=f"{row.path.name}:{row.line}",
        command=row.whole("command", 0, FULL_COMMAND),
        angle_deg=_maybe(row, "angle_deg"),
        min_mps=row.number("wind_min_mps"),
        max_mps=row.number("wind_max_mps"),
        tach_rpm=_maybe(row, "tach_rpm"),
        loadcell=row.file("loadcell"),
        azimuth_deg=_azimuth_deg(row),
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


def _check_files(rows: Sequence[WindRow]) -> None:
    seen: dict[Path, str] = {}
    for row in rows:
        if row.loadcell in seen:
            raise DataError(f"{row.where}: {row.loadcell} is the file of {seen[row.loadcell]} too: which is it?")
        seen[row.loadcell] = row.where
