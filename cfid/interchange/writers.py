"""Write a recording to files of other programs, block by block: CSV, Parquet, MATLAB, MCAP.

Numbers are those of the recording, in the units of whoever recorded them; Parquet, MATLAB and MCAP files have the units
and the origin.
"""

import csv
import json
import re
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pandas import DataFrame
from scipy.io import savemat

from cfid.errors import DataError
from cfid.interchange.recording import Recording
from cfid.records.extras import optional_library
from cfid.records.logs.crazyflie_names import stated_unit
from cfid.records.logs.log import Array, Series
from cfid.version import __version__

TIME = "t"

_EXACT_INTEGER = 2.0**53


def write_csv(series: Series, recording: Recording, path: Path) -> None:
    """Write one series as a CSV file with a header; a missing number is written as `nan`."""
    with path.open("x", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow([TIME, *series.names])
        for block in series.blocks():
            columns = {at: _whole(column) for at, column in enumerate(block.T)}
            DataFrame(columns).to_csv(file, header=False, index=False, na_rep="nan", lineterminator="\n")


def write_parquet(series: Series, recording: Recording, path: Path) -> None:
    """Write one series as a Parquet file; units are metadata of the fields, the origin is metadata of the file.

    Raises ConfigError without pyarrow.
    """
    arrow = optional_library("pyarrow", extra="parquet", what="a Parquet file")
    parquet = optional_library("pyarrow.parquet", extra="parquet", what="a Parquet file")
    names = _different([TIME, *series.names])
    units = _units(series)
    fields = [
        arrow.field(name, arrow.float64(), metadata={"unit": unit}) for name, unit in zip(names, units, strict=True)
    ]
    schema = arrow.schema(fields, metadata=dict(recording.origin))
    with path.open("xb") as file, parquet.ParquetWriter(file, schema) as writer:
        for block in series.blocks():
            writer.write_table(arrow.table(list(map(np.ascontiguousarray, block.T)), schema=schema))


def write_mat(recording: Recording, path: Path) -> None:
    """Write a MATLAB file of version 5: a variable for each column, after its series' name if there are several.

    The struct `cfid_origin` has the origin, and for each variable the name and the unit in the recording.
    Raises DataError where a column is larger than the format allows.
    """
    columns = _Columns(recording)
    try:
        with path.open("xb") as file:
            savemat(file, columns, oned_as="column")
    except (ValueError, OverflowError, TypeError) as fault:  # SciPy's: beyond 2 GB per variable, or 4 GB in all
        raise DataError(f"{path}: a MATLAB file of version 5 cannot hold this: {fault}. Use `to` parquet.") from None


def write_mcap(recording: Recording, path: Path) -> None:
    """Write an MCAP file: a topic with a JSON schema for each series, and a JSON message for each row.

    A number that is not finite is written as text: "NaN", "Infinity", "-Infinity". Raises ConfigError without mcap,
    DataError for times before zero, which the format cannot hold.
    """
    mcap = optional_library("mcap.writer", extra="mcap", what="an MCAP file")
    with path.open("xb") as file:
        writer = mcap.Writer(file)
        writer.start(profile="", library=f"cfid {__version__}")
        writer.add_metadata("origin", dict(recording.origin))
        for series in recording.series:
            names = _different([TIME, *series.names])
            schema = writer.register_schema(name=series.name, encoding="jsonschema", data=_json_schema(names, series))
            channel = writer.register_channel(topic=series.name, message_encoding="json", schema_id=schema)
            for block in series.blocks():
                if block[0, 0] < 0:
                    raise DataError(f"{series.name} begins at {block[0, 0]:g} s: MCAP has no times before zero.")
                for row in block.tolist():
                    stamp_ns = round(row[0] * 1e9)
                    data = json.dumps(dict(zip(names, map(_json_number, row), strict=True))).encode()
                    writer.add_message(channel, log_time=stamp_ns, data=data, publish_time=stamp_ns)
        writer.finish()


class _Columns(Mapping[str, Any]):
    """The variables of a MATLAB file; each is read when it is written, so that only one at a time is in memory."""

    def __init__(self, recording: Recording) -> None:
        several = len(recording.series) > 1
        wanted = [(series, name, at) for series in recording.series for at, name in enumerate((TIME, *series.names))]
        names = _different([_matlab_name(f"{one.name}_{name}" if several else name) for one, name, _ in wanted])
        self._read: dict[str, Callable[[], Any]] = {
            name: partial(series.column, at) for name, (series, _, at) in zip(names, wanted, strict=True)
        }
        described = {
            "variable": names,
            "name": [name for _, name, _ in wanted],
            "unit": [_units(series)[at] for series, _, at in wanted],
        }
        texts = {_matlab_name(key): text for key, text in recording.origin.items()}
        lists = {key: np.array(each, dtype=object) for key, each in described.items()}
        self._read["cfid_origin"] = lambda: {**texts, **lists}

    def __getitem__(self, name: str) -> Any:
        return self._read[name]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._read)

    def __len__(self) -> int:
        return len(self._read)


def _units(series: Series) -> list[str]:
    """Return the units of the time and of every channel."""
    return ["s", *map(stated_unit, series.channels)]


def _whole(column: Array) -> Any:
    """Return a column of whole numbers as integers, so that they are written without a decimal point."""
    exact = np.isfinite(column) & (np.abs(column) < _EXACT_INTEGER) & (column == np.rint(column))
    return column.astype(np.int64) if exact.all() and not np.signbit(column[column == 0]).any() else column


def _matlab_name(name: str) -> str:
    word = re.sub(r"\W", "_", name, flags=re.ASCII)[:60]
    return word if word[:1].isalpha() else f"x{word}"


def _different(names: list[str]) -> list[str]:
    """Return the names, with a number appended to each repeated one."""
    found: list[str] = []
    for name in names:
        number, word = 2, name
        while word in found:
            word, number = f"{name}_{number}", number + 1
        found.append(word)
    return found


def _json_schema(names: list[str], series: Series) -> bytes:
    units = _units(series)
    properties = {
        name: {"type": "number", "description": unit or "unit unknown"} for name, unit in zip(names, units, strict=True)
    }
    return json.dumps({"title": series.name, "type": "object", "properties": properties}).encode()


def _json_number(value: float) -> float | str:
    if np.isfinite(value):
        return value
    return "NaN" if np.isnan(value) else "Infinity" if value > 0 else "-Infinity"
