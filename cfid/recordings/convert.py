"""Write a recording as CSV, Parquet or MCAP: its numbers in the units of whoever recorded them, its origin as text."""

import contextlib
import csv
import json
import re
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from pandas import DataFrame

from cfid.errors import ConfigError, DataError
from cfid.large import parts
from cfid.recordings.crazyflie import crazyflie_unit
from cfid.recordings.recording import TIME, Column, Recording, Series
from cfid.records.extras import optional_library
from cfid.records.files import RUN_FILE, refuse_kept

Array = npt.NDArray[np.float64]
Format = Literal["csv", "parquet", "mcap"]

_EXACT_INTEGER = 2.0**53


def convert(recording: Recording, to: Format, out: Path | None) -> list[Path]:
    """Write a recording and return its files: one, or for several series as CSV or Parquet one each, in a folder.

    `out` is that file or folder; by default it is in the current folder and named after the recording. Raises
    ConfigError when it exists or cannot be written, DataError where the format cannot hold the recording; no file is
    left behind in either case.
    """
    name = recording.name
    if to == "mcap":
        return [_written(out or Path(f"{name}.mcap"), partial(write_mcap, recording))]
    write = write_csv if to == "csv" else write_parquet
    series = [one for one in recording.series.values() if one.columns or one.time_s is not None]
    if len(series) == 1:
        return [_written(out or Path(f"{name}.{to}"), partial(write, series[0], recording))]
    folder = out or Path(f"{name}-{to}")
    try:
        refuse_kept(folder)
        folder.mkdir()
    except FileExistsError:
        raise ConfigError(f"{folder}: exists already, and is left as it is: give another `out`.") from None
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be created: {error.strerror}.") from None
    paths: list[Path] = []
    try:
        for each in series:
            path = folder / f"{re.sub(r'[^A-Za-z0-9_.-]', '_', each.name)}.{to}"
            paths.append(_written(path, partial(write, each, recording)))
    except BaseException:
        for path in paths:
            path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            folder.rmdir()
        raise
    return paths


def write_csv(series: Series, recording: Recording, path: Path) -> None:
    """Write one series as a CSV file with a header; a missing number is written as `nan`."""
    with path.open("x", encoding="utf-8", newline="") as file:
        columns = _columns(series)
        csv.writer(file, lineterminator="\n").writerow(_head(column, recording) for column in columns)
        for rows in parts(series.rows):
            block = {place: _whole(column.values[rows]) for place, column in enumerate(columns)}
            DataFrame(block).to_csv(file, header=False, index=False, na_rep="nan", lineterminator="\n")


def write_parquet(series: Series, recording: Recording, path: Path) -> None:
    """Write one series as a Parquet file; units are metadata of the fields, the origin is metadata of the file.

    Raises ConfigError without pyarrow.
    """
    arrow = optional_library("pyarrow", extra="parquet", what="a Parquet file")
    parquet = optional_library("pyarrow.parquet", extra="parquet", what="a Parquet file")
    columns = _columns(series)
    names = _different(column.name for column in columns)
    fields = [
        arrow.field(name, arrow.float64(), metadata={"unit": column.unit})
        for name, column in zip(names, columns, strict=True)
    ]
    schema = arrow.schema(fields, metadata=dict(_origin(recording)))
    with path.open("xb") as file, parquet.ParquetWriter(file, schema) as writer:
        for rows in parts(series.rows):
            block = [np.ascontiguousarray(column.values[rows]) for column in columns]
            writer.write_table(arrow.table(block, schema=schema))


def write_mcap(recording: Recording, path: Path) -> None:
    """Write an MCAP file: a topic with a JSON schema for each series, and a JSON message for each row.

    A number that is not finite is written as text: "NaN", "Infinity", "-Infinity". Raises ConfigError without mcap,
    DataError for a table without times, and for times before zero, which the format cannot hold.
    """
    mcap = optional_library("mcap.writer", extra="mcap", what="an MCAP file")
    with path.open("xb") as file:
        writer = mcap.Writer(file)
        writer.start(profile="", library="cfid")
        writer.add_metadata("origin", dict(_origin(recording)))
        for series in recording.series.values():
            if series.time_s is None:
                raise DataError(f"{recording.path}: has no times, by which an MCAP file orders its messages.")
            columns = _columns(series)
            names = _different(column.name for column in columns)
            if series.rows and (begin_s := columns[0].values[0]) < 0:
                raise DataError(f"{series.name} begins at {begin_s:g} s: MCAP has no times before zero.")
            properties = {
                name: {"type": "number", "description": column.unit or "unit unknown"}
                for name, column in zip(names, columns, strict=True)
            }
            content = json.dumps({"title": series.name, "type": "object", "properties": properties}).encode()
            schema = writer.register_schema(name=series.name, encoding="jsonschema", data=content)
            channel = writer.register_channel(topic=series.name, message_encoding="json", schema_id=schema)
            for rows in parts(series.rows):
                for row in zip(*(column.values[rows].tolist() for column in columns), strict=True):
                    stamp_ns = round(row[0] * 1e9)
                    data = json.dumps(dict(zip(names, map(_json_number, row), strict=True))).encode()
                    writer.add_message(channel, log_time=stamp_ns, data=data, publish_time=stamp_ns)
        writer.finish()


def _written(path: Path, write: Callable[[Path], None]) -> Path:
    if path.exists() or path.is_symlink():
        raise ConfigError(f"{path}: exists already, and is left as it is: give another `out`.")
    try:
        refuse_kept(path)
        write(path)
    except OSError as error:
        path.unlink(missing_ok=True)
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}.") from None
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    return path


def _origin(recording: Recording) -> Mapping[str, str]:
    """Return the texts that state where a converted file comes from: its run's run.toml, or the file that was read."""
    if recording.run is not None:
        name = recording.run.folder.resolve().name
        return {"run": name, RUN_FILE: (recording.run.folder / RUN_FILE).read_text(encoding="utf-8")}
    facts = recording.facts
    stated = {"clock": facts.clock, "motors": facts.motors, "props_out": facts.props_out}
    return {
        "file": recording.path.name,
        "sha256": recording.source.sha256,
        "program": facts.program,
        **{key: str(value) for key, value in stated.items() if value is not None},
    }


def _columns(series: Series) -> list[Column]:
    """Return the times by the recording's own clock, where there are any, and the columns."""
    if series.time_s is None:
        return list(series.columns)
    return [Column(name=TIME, unit="s", values=series.time_s + (series.begin_s or 0.0)), *series.columns]


def _head(column: Column, recording: Recording) -> str:
    """Return a column's name, with the unit in brackets where a file's name alone does not state it."""
    stated = recording.run is None and column.name != TIME and column.unit not in ("", crazyflie_unit(column.name))
    return f"{column.name} [{column.unit}]" if stated else column.name


def _whole(column: Array) -> Any:
    """Return a column of whole numbers as integers, so that they are written without a decimal point."""
    exact = np.isfinite(column) & (np.abs(column) < _EXACT_INTEGER) & (column == np.rint(column))
    return column.astype(np.int64) if exact.all() and not np.signbit(column[column == 0]).any() else column


def _different(names: Iterable[str]) -> list[str]:
    """Return the names, with a number appended to each repeated one."""
    different: list[str] = []
    for name in names:
        number, word = 2, name
        while word in different:
            word, number = f"{name}_{number}", number + 1
        different.append(word)
    return different


def _json_number(value: float) -> float | str:
    if np.isfinite(value):
        return value
    return "NaN" if np.isnan(value) else "Infinity" if value > 0 else "-Infinity"
