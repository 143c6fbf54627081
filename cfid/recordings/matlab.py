"""Read the table of a MATLAB file: arrays of one length, or Simulink's structure of time and signals.

Files of version 5 to 7.2 are read by SciPy, those of 7.3, which are HDF5, by h5py; both in a process of their own,
since SciPy trusts the types that a file states: a damaged one ends the process, and no error can be caught.
"""

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from cfid.errors import ConfigError, DataError
from cfid.large import empty
from cfid.recordings import matlab_arrays
from cfid.recordings.recording import Array, Column, How
from cfid.recordings.table import Layout, Table, with_units
from cfid.records.extras import optional_library
from cfid.records.files import check_regular, sha256_of
from cfid.records.parameters import Source
from cfid.units import split_unit

_HDF5 = b"\x89HDF\r\n\x1a\n"
_BEGINS = (matlab_arrays.VERSION_5, b"MATLAB 7.3 MAT-file", _HDF5)
_FEWEST_ROWS = 16  # of a recording; shorter arrays next to one are parameters
_MOST_LISTED = 20
_LONGEST_S = 600.0


class _Array(NamedTuple):
    """An array of a file: its name after those of the structs that it is in, and its columns (n,)."""

    name: str
    columns: list[Array]

    @property
    def rows(self) -> int:
        return len(self.columns[0])


class MatlabTable(Table):
    """A table of a MATLAB file, which has no lines."""

    def line_of_row(self, row: int) -> int:
        """Return the number of a row, counted from 1."""
        return row + 1


def is_matlab(path: Path) -> bool:
    """Return whether a file is a MATLAB file, by its first bytes."""
    try:
        check_regular(path)
        with path.open("rb") as file:
            return file.read(len(_BEGINS[0])).startswith(_BEGINS)
    except OSError:
        return False


def read_matlab(path: Path, how: How | None = None) -> Table:
    """Return the arrays of one length as columns; of several lengths, those that `how.columns` names.

    Raises DataError for a file that cannot be read, or whose arrays have several lengths; ConfigError where h5py is
    missing, or for a name that is not there.
    """
    how = how or How()
    if not matlab_arrays.is_version_5(path):
        optional_library("h5py", extra="mat", what="a MATLAB file of version 7.3")
    arrays = _arrays(path)
    columns = [column for array in _of_one_length(path, arrays, how) for column in _columns(array)]
    named = dict(word.partition("=")[::2] for word in how.columns if "=" in word)
    known = {own: column for column in columns for own in (column.head, column.name)}
    for name, head in named.items():
        if head not in known:
            raise ConfigError(
                f"{path}: no array '{head}'; it has {', '.join(one.head for one in columns)}.", code="no-column"
            )
        columns[columns.index(known[head])] = known[head] = Column(
            name=name, unit=known[head].unit, values=known[head].values, head=known[head].head
        )
    return MatlabTable(
        path=path,
        source=Source(str(path), sha256_of(path)),
        layout=Layout(
            separator=None,
            decimal=".",
            heads=tuple(column.head for column in columns),
            has_head=True,
            above="",
            lines_above=0,
        ),
        columns=with_units(path, columns, how),
        rows=len(columns[0].values),
        findings=(),
    )


def _of_one_length(path: Path, arrays: list[_Array], how: How) -> list[_Array]:
    """Return the arrays of more than one row, where they have one length or those named do. Raises DataError."""
    long = [array for array in arrays if array.rows >= _FEWEST_ROWS] or arrays
    wanted = {word.partition("=")[2] or word for word in how.columns}
    lengths = {array.rows for array in long if array.name in wanted} or {array.rows for array in long}
    if len(lengths) == 1:
        return [array for array in long if array.rows in lengths]
    if not long:
        raise DataError(
            f"{path}: no arrays of numbers. Objects, such as tables and timeseries, cannot be read outside MATLAB: "
            "save their time and values as arrays.",
            code="no-arrays",
        )
    listing = ", ".join(f"{array.name} ({array.rows})" for array in long[:_MOST_LISTED])
    raise DataError(
        f"{path}: arrays of several lengths: {listing}. Save the time and its signals with one length, or name "
        "those of one by `columns`, as in t=time,phi=angle.",
        code="several-lengths",
    )


def _columns(array: _Array) -> list[Column]:
    """Return the columns of an array, numbered from 1 where there are several."""
    heads = [array.name] if len(array.columns) == 1 else [f"{array.name}_{1 + at}" for at in range(len(array.columns))]
    columns = []
    for head, values in zip(heads, array.columns, strict=True):
        name, unit = split_unit(head.rpartition(".")[2] if head.count(".") > 1 else head)
        columns.append(Column(name=name, unit=unit, values=values, head=head))
    return columns


def _arrays(path: Path) -> list[_Array]:
    """Return the arrays of numbers of a file, which another process reads. Raises DataError where it fails or dies."""
    with TemporaryDirectory(prefix="cfid-") as folder:
        command = [sys.executable, "-m", matlab_arrays.__name__, str(path.resolve()), folder]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST_S, check=False)
        except subprocess.TimeoutExpired:
            raise _damaged(path, f"it was not read within {_LONGEST_S:g} s") from None
        if done.returncode:
            reason = (done.stderr.strip().splitlines() or [""])[-1] if done.returncode == 1 else "an unknown type"
            raise _damaged(path, reason.rstrip("."))
        names: list[str] = json.loads((Path(folder) / "names.json").read_text(encoding="utf-8"))
        return [_Array(name, _in_columns(Path(folder) / f"{at}.npy")) for at, name in enumerate(names)]


def _damaged(path: Path, reason: str) -> DataError:
    return DataError(f"{path}: not readable as a MATLAB file: it is damaged ({reason}). Save it again.", code="damaged")


def _in_columns(file: Path) -> list[Array]:
    """Return the columns (n,) of a stored array; its longer side is time, whether rows or columns."""
    stored = np.load(file, mmap_mode="r")
    columns = []
    for values in [stored] if stored.ndim == 1 else stored if stored.shape[0] < stored.shape[1] else stored.T:
        column = empty(len(values))
        column[:] = values
        columns.append(column)
    return columns
