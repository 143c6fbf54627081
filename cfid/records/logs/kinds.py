"""Recognise the kind of another program's recording by its columns."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from cfid.recordings.wrench import AXES
from cfid.records.logs.any_kind import is_binary_log
from cfid.records.tables.angle import SCHEMA as ANGLE_COLUMNS
from cfid.records.tables.blocks import open_table
from cfid.records.tables.matlab import converted_series, is_matlab
from cfid.records.tables.schema import TIME, Foreign
from cfid.records.tables.stand_heads import heads_of, shows_stand
from cfid.records.tables.times import TIME_COLUMN

Kind = Literal["angle", "wrench", "flight", "stand"]

_FLOWN = re.compile(
    r"(?:\w+_)?(?:(?:gyro|acc)[._][xyz]|(?:motor|pwm|rpm)[._]m[1-4]\w*|(?:stateEstimate|stabilizer)[._]\w+|pm[._]vbat\w*)"
    r"(?:\s*[\[(][^\[\]()]+[\])])?"
)
_COLUMNS: dict[Kind, tuple[re.Pattern[str], ...]] = {  # any one column shows the kind
    "wrench": (
        # With any unit, so that one that is not read is refused by name.
        re.compile(rf"(?:{'|'.join(AXES)})(?:_[a-z]+|\s*[\[(][^\[\]()]+[\])])?", re.IGNORECASE),
    ),
    "flight": (_FLOWN,),
    "angle": tuple(column.called for column in ANGLE_COLUMNS.columns if column.key != TIME),
}


def kind_at(path: Path, reading: Foreign) -> Kind | None:
    """Return a recording's kind, None where its columns do not show it; a "flight" is any log of a vehicle.

    Raises DataError where it cannot be read.
    """
    if is_binary_log(path):
        return "flight"
    if any("=" in one for one in reading.columns):  # only columns of motors are named this way
        return "stand"
    if reading.columns:
        of_log = len(reading.columns) == 1 and reading.rate_hz is None  # the one column is the time
        return "flight" if of_log else "wrench" if len(reading.columns) > len(AXES) else "angle"
    if is_matlab(path) and _is_converted_flight(path):
        return "flight"
    table = open_table(path, skip_lines=reading.skip_lines, sha256="")
    return _kind_of(table.names) if table.has_head else None


def _kind_of(names: Sequence[str]) -> Kind | None:
    for kind, columns in _COLUMNS.items():
        if any(column.fullmatch(name) for column in columns for name in names):
            return kind
    return "stand" if shows_stand(heads_of(names)) else None


def _is_converted_flight(path: Path) -> bool:
    """Return whether a MATLAB file is a log that cfid converted, or a run of a vehicle's devices, in several series."""
    series, origin = converted_series(path)
    kinds = {_kind_of(one.names) for one in series} - {None}
    return len(series) > 1 and ("program" in origin or kinds == {"flight"})


def has_times(path: Path, reading: Foreign) -> bool:
    """Return whether a table's header names a time, so that it is a recording. Raises DataError as `kind_at`."""
    table = open_table(path, skip_lines=reading.skip_lines, sha256="")
    return table.has_head and any(TIME_COLUMN.called.fullmatch(name) for name in table.names)


def is_flown(name: str) -> bool:
    """Return whether a column is a variable of a vehicle's firmware, such as `gyro.x` or `imu_gyro_x`."""
    return bool(_FLOWN.fullmatch(name))
