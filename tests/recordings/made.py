"""Angles and logs of a vehicle made of arrays, and the rows of a log's only series as one array."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.recordings.angle import AngleRecord
from cfid.recordings.recording import Column, Facts, Recording, Series
from cfid.records.parameters import Source
from cfid.records.run import Label

Array = npt.NDArray[np.float64]


def made_angle(time_s: Array, angle_rad: Array, *, name: str = "one", **more: Any) -> AngleRecord:
    """Return a recording of an angle; `more` are its other fields, such as the label."""
    path = Path(f"{name}.csv")
    fields = {"path": path, "source": Source(path.name, "0" * 64), "label": Label(), **more}
    return AngleRecord(time_s=time_s, angle_rad=angle_rad, **fields)


def made_series(name: str, time_s: Array, columns: Sequence[tuple[str, str]], values: Sequence[Array]) -> Series:
    """Return a series of arrays (n,), one for the name and the unit of each column."""
    begin_s = float(time_s[0]) if len(time_s) else 0.0
    return Series(
        name=name,
        path=Path("flight.csv"),
        columns=tuple(
            Column(name=own, unit=unit, values=np.asarray(value, dtype=np.float64))
            for (own, unit), value in zip(columns, values, strict=True)
        ),
        rows=len(time_s),
        time_s=np.asarray(time_s - begin_s, dtype=np.float64),
        begin_s=begin_s,
    )


def made_log(
    *series: Series, path: Path = Path("flight.csv"), number: int = 0, program: str = "simulated"
) -> Recording:
    """Return a log of series."""
    return Recording(
        path=path,
        source=Source(str(path), f"{number:064x}"),
        series={one.name: one for one in series},
        facts=Facts(program=program),
    )


def with_series(log: Recording, *series: Series) -> Recording:
    return replace(log, series={one.name: one for one in series})


def only(log: Recording) -> Series:
    """Return a log's only series."""
    (series,) = log.series.values()
    return series


def table_of(log: Recording | Series) -> Array:
    """Return the rows (n, 1 + columns) of a series, or of a log's only one; the times are first."""
    series = only(log) if isinstance(log, Recording) else log
    assert series.time_s is not None
    return np.column_stack([series.time_s + (series.begin_s or 0.0), *(one.values for one in series.columns)])


def with_rows(log: Recording, rows: Array) -> Recording:
    """Return a log whose only series has these rows (n, 1 + columns)."""
    series = only(log)
    columns = [(one.name, one.unit) for one in series.columns]
    return with_series(log, made_series(series.name, rows[:, 0], columns, list(rows[:, 1:].T)))
