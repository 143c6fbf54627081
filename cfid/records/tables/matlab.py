"""Read the table of a MATLAB file: arrays of one length, a matrix, or Simulink's struct of time and signals.

Files of version 5 to 7.2 are read by SciPy, those of 7.3, which are HDF5, by h5py.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError
from cfid.large import stored_together
from cfid.lazy import later
from cfid.records.extras import optional_library
from cfid.records.files import check_regular
from cfid.records.tables.matlab_elements import check_elements
from cfid.records.tables.matlab_hdf5 import Hdf5Tree
from cfid.records.tables.matlab_origin import ORIGIN, Variable, texts_of, variables_of, with_own_names
from cfid.records.tables.matlab_structs import (
    MatlabTable,
    clean,
    columns_of,
    is_numeric,
    named,
    of_dspace,
    of_simulink,
    of_timeseries,
)

_loadmat, _whosmat = later("scipy.io", "loadmat"), later("scipy.io", "whosmat")

Tree = Any  # as in matlab_structs

_HDF5 = b"\x89HDF\r\n\x1a\n"
_BEGINS = (b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file", _HDF5)
_BLOCK_ROWS = 1 << 15
_LARGE_BYTES = 1 << 26  # from there on a file's variables are read one by one
_FEWEST_ROWS = 16  # of a recording; shorter arrays next to one are parameters
_TIMES = ("t", "tout", "time", "timestamp")


def is_matlab(path: Path) -> bool:
    """Return whether a file is a MATLAB file, by its first bytes."""
    try:
        check_regular(path)
        with path.open("rb") as file:
            return file.read(len(_BEGINS[0])).startswith(_BEGINS)
    except OSError:
        return False


def csv_blocks(table: MatlabTable) -> Iterator[bytes]:
    """Yield a table as blocks of lines of CSV text, in which every number is exact; a header is in the first."""
    head = [",".join(table.names)] if table.names else []
    for begin in range(0, table.rows, _BLOCK_ROWS):
        rows = zip(*(column[begin : begin + _BLOCK_ROWS].tolist() for column in table.columns), strict=True)
        yield "\n".join([*head, *(",".join(map(repr, row)) for row in rows), ""]).encode()
        head = []


def matlab_table(path: Path, columns: Sequence[str]) -> MatlabTable:
    """Return the table of a MATLAB file; of several, the one that has the named columns, else the one with a time.

    Raises DataError for a file that cannot be read or has no table, ConfigError where several fit or h5py is missing.
    """
    tree = _tree(path)
    own = variables_of(tree)
    units = {(one.series, clean(one.name)): one.unit for one in own}
    if own:
        tree = with_own_names(tree, [one._replace(name=clean(one.name)) for one in own])
    found = [
        replace(table, units={name: units.get((table.place, name), "") for name in table.names} if own else {})
        for table in _tables(tree, path.stem, place="")
        if len(table.columns[0]) > 1
    ]
    found = _with_time_above(found)
    every = found = [table for table in found if table.rows >= _FEWEST_ROWS] or found
    if not found:
        raise DataError(
            f"{path}: no arrays of numbers. Objects, such as tables and timeseries, cannot be read outside MATLAB: "
            "save their time and values as arrays."
        )
    chosen = [table for table in found if columns and set(columns) <= set(_full_names(table))]
    if len(chosen) == 1:
        full = dict(zip(chosen[0].names, _full_names(chosen[0]), strict=True))
        stated = {full[name]: unit for name, unit in chosen[0].units.items()}
        return replace(chosen[0], names=tuple(full.values()), units=stated)
    if columns:
        found = [table for table in found if set(columns) <= {*table.names, *_numbers(table)}] or found
    if len(found) > 1:
        found = [table for table in found if _has_time(table)] or found
    if len(found) > 1:
        found = [table for table in found if not _is_time_alone(table)] or found
    if len(found) > 1:
        there = "; ".join(f"{', '.join(_full_names(table)) or 'a matrix'} ({table.rows} rows)" for table in found)
        raise ConfigError(f"{path}: several tables: {there[:300]}. Name the columns of one with `columns`.")
    _refuse_time_alone(path, found[0], every)
    return found[0]


def _with_time_above(tables: Sequence[MatlabTable]) -> list[MatlabTable]:
    """Return tables; one without a time gets a time of its length that stands alone in a struct around it.

    Simulink's structure without time, next to its `tout`, is such a table.
    """
    return [_with_time(table, [one for one in tables if _is_time_around(one, table)]) for table in tables]


def _with_time(table: MatlabTable, times: Sequence[MatlabTable]) -> MatlabTable:
    if len(times) != 1 or not table.names or _has_time(table):
        return table
    names, columns = (*times[0].names, *table.names), (*times[0].columns, *table.columns)
    return replace(table, names=names, columns=columns, units={**times[0].units, **table.units})


def _is_time_around(one: MatlabTable, table: MatlabTable) -> bool:
    around = not one.place or f"{table.place}.".startswith(f"{one.place}.")
    return around and _is_time_alone(one) and one.rows == table.rows


def _has_time(table: MatlabTable) -> bool:
    return any(name.partition(" [")[0].lower() in _TIMES for name in table.names)


def _is_time_alone(table: MatlabTable) -> bool:
    return len(table.names) == 1 and _has_time(table)


def converted_series(path: Path) -> tuple[list[MatlabTable], dict[str, str]]:
    """Return the series of a MATLAB file that cfid wrote, the time first in each, and the texts of their origin.

    Both are empty for a file that cfid did not write. Raises DataError and ConfigError as `matlab_table`.
    """
    if not _has_origin(path):
        return [], {}
    tree = _tree(path)
    by_series: dict[str, list[Variable]] = {}
    for one in variables_of(tree):
        if one.variable in tree:
            by_series.setdefault(one.series, []).append(one)
    tables = []
    for series, variables in by_series.items():
        columns = tuple(np.ravel(np.asarray(tree[one.variable], dtype=np.float64)) for one in variables)
        if len({len(column) for column in columns}) > 1:
            return [], {}  # the file was changed since
        names = tuple(one.name for one in variables)
        tables.append(MatlabTable(series, names, columns, {one.name: one.unit for one in variables}))
    return tables, texts_of(tree)


def _has_origin(path: Path) -> bool:
    """Return whether a file has the variable in which cfid stores a recording's origin."""
    with path.open("rb") as file:
        begin = file.read(len(_BEGINS[0]))
    if begin != _BEGINS[0]:
        return False  # cfid writes version 5
    with _damage_named(path):
        check_elements(path)
        return any(name == ORIGIN for name, _, _ in _whosmat(path))


def _full_names(table: MatlabTable) -> tuple[str, ...]:
    """Return names with the struct's before them, which distinguishes equal names in different structs."""
    return tuple(f"{table.place}.{name}" if table.place else name for name in table.names)


def _refuse_time_alone(path: Path, table: MatlabTable, every: Sequence[MatlabTable]) -> None:
    """Raise DataError for a time without a column of its length where there are columns of other lengths."""
    others = [f"{name} {other.rows}" for other in every for name in other.names]
    if _is_time_alone(table) and len(others) > 1:
        rows = ", ".join(other for other in others if not other.startswith(f"{table.names[0]} "))
        raise DataError(
            f"{path}: {table.names[0]} has {table.rows} rows, and no other array has as many ({rows}): save them with "
            "equal length."
        )


def _numbers(table: MatlabTable) -> tuple[str, ...]:
    return tuple(str(1 + at) for at in range(len(table.columns)))


def _tree(path: Path) -> dict[str, Tree]:
    with _damage_named(path):
        return _read(path)


@contextmanager
def _damage_named(path: Path) -> Iterator[None]:
    """Turn what readers of a damaged file raise into one DataError."""
    try:
        yield
    except (ConfigError, DataError):
        raise
    except Exception as fault:  # a damaged file may make these libraries raise anything
        reason = (str(fault).splitlines() or [type(fault).__name__])[0].rstrip(".")
        raise DataError(f"{path}: not readable as a MATLAB file: it is damaged ({reason}). Save it again.") from None


def _read(path: Path) -> dict[str, Tree]:
    with path.open("rb") as file:
        begin = file.read(len(_BEGINS[0]))
    if begin == _BEGINS[0]:
        check_elements(path)
        return dict(_variables(path))
    h5py = optional_library("h5py", extra="mat", what="a MATLAB file of version 7.3")
    with h5py.File(path, "r") as file:
        return Hdf5Tree(path, file).content()


def _variables(path: Path) -> Iterator[tuple[str, Tree]]:
    """Yield the variables of a file of version 5 to 7.2; of a large file, only few are in memory at a time."""
    if path.stat().st_size < _LARGE_BYTES:
        yield from _loaded(path, None).items()
        return
    waiting: dict[str, npt.NDArray[Any]] = {}
    for name, _, _ in _whosmat(path):
        for each, value in _loaded(path, [name]).items():
            if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf":
                yield each, value
                continue
            waiting[each] = value
            if sum(one.nbytes for one in waiting.values()) >= _LARGE_BYTES:
                yield from zip(waiting, stored_together(list(waiting.values())), strict=True)
                waiting = {}
    yield from zip(waiting, stored_together(list(waiting.values())), strict=True)


def _loaded(path: Path, names: list[str] | None) -> dict[str, Tree]:
    content = _loadmat(path, simplify_cells=True, variable_names=names)
    return {name: value for name, value in content.items() if not name.startswith("__")}


def _tables(tree: Tree, name: str, *, place: str) -> Iterator[MatlabTable]:
    """Yield the tables in a struct at a place, "" for the file, and in the structs inside it."""
    if not isinstance(tree, Mapping):
        return
    if "signals" in tree:
        yield from of_simulink(tree, name, place=place)
        return
    if {"X", "Y"} <= tree.keys() and (measured := list(of_dspace(tree, place=place))):
        yield from measured
        return
    if ("TimeInfo" in tree or "DataInfo" in tree) and all(is_numeric(tree.get(key)) for key in ("Time", "Data")):
        yield of_timeseries(tree, name, place=place)
        return
    arrays = {key: columns_of(value) for key, value in tree.items() if is_numeric(value)}
    for rows in dict.fromkeys(len(columns[0]) for columns in arrays.values()):
        group = {key: columns for key, columns in arrays.items() if len(columns[0]) == rows}
        alone = len(group) == 1 and len(next(iter(group.values()))) > 1
        names = tuple(each for key, columns in group.items() for each in named(key, len(columns)))
        yield MatlabTable(place, () if alone else names, tuple(each for columns in group.values() for each in columns))
    for key, value in tree.items():
        yield from _tables(value, key, place=f"{place}.{key}" if place else key)
