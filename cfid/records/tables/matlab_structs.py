"""Read tables from structs that programs write into MATLAB files: Simulink's, timeseries and dSPACE's."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeGuard

import numpy as np
import numpy.typing as npt

from cfid.records.tables.text import is_number

Tree = Any  # a dict of trees by field, a list of trees, an array, or a text

_IN_NAMES = str.maketrans(dict.fromkeys(',;\t\r\n"', " "))
_PORT = re.compile(r"(?:Out|In)\d+|Value", re.IGNORECASE)  # ports: the name of the block with the port is better


@dataclass(frozen=True, eq=False)
class MatlabTable:
    """Columns (n,) of equal length, by name; a matrix alone has no names. `place` is the struct they are in.

    `units` has, by name, the units that the file states, "" for an unknown one.
    """

    place: str
    names: tuple[str, ...]
    columns: tuple[npt.NDArray[Any], ...]
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """The number of rows."""
        return len(self.columns[0])


def of_timeseries(tree: Mapping[str, Tree], name: str, *, place: str) -> MatlabTable:
    """Return the table of a timeseries that was made a struct, with its own name and the units that it states."""
    own = tree.get("Name")
    called = clean(own if isinstance(own, str) and own else name)
    data = columns_of(tree["Data"])
    names = (_with_unit("Time", tree.get("TimeInfo")), *named(_with_unit(called, tree.get("DataInfo")), len(data)))
    return MatlabTable(place, names, (*columns_of(tree["Time"]), *data))


def _with_unit(name: str, about: Tree) -> str:
    unit = about.get("Units") if isinstance(about, Mapping) else None
    return f"{name} [{clean(unit)}]" if isinstance(unit, str) and unit else name


def of_simulink(tree: Mapping[str, Tree], name: str, *, place: str) -> Iterator[MatlabTable]:
    """Yield the table of a struct with `time` and `signals`, of which each has `values` and perhaps a `label`."""
    each = _entries(tree["signals"])
    names: list[str] = []
    columns: list[npt.NDArray[Any]] = []
    time = tree.get("time")
    if is_numeric(time):
        names.append("time")
        columns += columns_of(time)
    for number, signal in enumerate(each, start=1):
        values = signal.get("values")
        if is_numeric(values):
            label = signal.get("label")
            own = label if isinstance(label, str) and label else name if len(each) == 1 else f"{name}_{number}"
            names += named(clean(own), len(columns_of(values)))
            columns += columns_of(values)
    if columns and len({len(column) for column in columns}) == 1:
        yield MatlabTable(place, tuple(names), tuple(columns))


def of_dspace(tree: Mapping[str, Tree], *, place: str) -> Iterator[MatlabTable]:
    """Yield the tables of a recording of dSPACE's ControlDesk: `X` are times, `Y` signals, each with Data and Name.

    `XIndex` of a signal is the number of its time; without it, a time with as many values is used.
    """
    signals = [one for one in _entries(tree["Y"]) if is_numeric(one.get("Data"))]
    for number, time in enumerate(_entries(tree["X"]), start=1):
        if not is_numeric(time.get("Data")):
            continue
        clock = columns_of(time["Data"])[0]
        of_it = [one for one in signals if _index_of(one) in (None, number) and np.size(one["Data"]) == len(clock)]
        if of_it:
            names = [_dspace_name(time, "time"), *_different([_dspace_name(one, "signal") for one in of_it], of_it)]
            yield MatlabTable(place, tuple(names), (clock, *(columns_of(one["Data"])[0] for one in of_it)))


def _index_of(signal: Mapping[str, Tree]) -> int | None:
    index = signal.get("XIndex")
    return int(index) if isinstance(index, int | float | np.number) and np.isfinite(index) else None


def _dspace_name(entry: Mapping[str, Tree], without: str) -> str:
    """Return the last part of a variable's path in the model, with its unit."""
    own = entry.get("Name")
    parts = [part.strip(' "{}') for part in own.split("/")] if isinstance(own, str) else []
    parts = [part for part in parts if part] or [without]
    last = parts[-2] if len(parts) > 1 and _PORT.fullmatch(parts[-1]) else parts[-1]
    return _with_unit(clean(last), {"Units": entry.get("Unit")})


def _different(names: list[str], entries: Sequence[Mapping[str, Tree]]) -> list[str]:
    """Return names, with the whole path for each name that occurs twice."""
    return [
        name if names.count(name) == 1 else clean(str(entry.get("Name", name)).replace('"', ""))
        for name, entry in zip(names, entries, strict=True)
    ]


def _entries(value: Tree) -> list[Mapping[str, Tree]]:
    """Return the structs of an array of structs, which HDF5 has as one struct of lists."""
    main = (
        next((value[key] for key in ("values", "Data") if key in value), None) if isinstance(value, Mapping) else None
    )
    if isinstance(main, list):
        lists = {key: one for key, one in value.items() if isinstance(one, list) and len(one) == len(main)}
        return [{key: one[at] for key, one in lists.items()} for at in range(len(main))]
    each = [value] if isinstance(value, Mapping) else list(np.ravel(np.asarray(value, dtype=object)))
    return [one for one in each if isinstance(one, Mapping)]


def is_numeric(value: Tree) -> TypeGuard[npt.NDArray[Any]]:
    """Return whether a value is an array of numbers, with one column or more, and more than one row."""
    return (
        isinstance(value, np.ndarray) and value.dtype.kind in "biufc" and value.size > 1 and np.squeeze(value).ndim < 3
    )


def columns_of(value: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
    """Return the columns of an array; its longer side is time, whether rows or columns.

    Complex numbers without imaginary parts are real; others stay as they are, and later do not count as numbers.
    """
    array = np.squeeze(value)
    if array.dtype.kind == "c" and not array.imag.any():
        array = array.real
    if array.dtype.kind == "b":
        array = array.astype(np.int64)
    if array.ndim == 1:
        return [array]
    return list(array if array.shape[0] < array.shape[1] else array.T)


def named(name: str, columns: int) -> list[str]:
    """Return the names of an array's columns."""
    return [name] if columns == 1 else [f"{name}_{1 + at}" for at in range(columns)]


def clean(label: str) -> str:
    """Return a label as the name of a column in a line of CSV text."""
    text = "".join(letter if letter.isprintable() else " " for letter in label.translate(_IN_NAMES)).strip()
    return f"signal_{text}" if not text or is_number(text) else text
