"""Refuse thousands separators in a table of motors, as numbers would be missing or a thousandth of their value."""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from cfid.errors import DataError
from cfid.records.tables.line_faults import NO_THOUSANDS
from cfid.records.tables.stand_heads import heads_of
from cfid.records.tables.table import Array, CsvTable
from cfid.records.tables.text import has_decimal_comma, short

_POINT = re.compile(r"[1-9]\d{0,2}\.\d{3}", re.ASCII)
_NO_ROTOR_RAD_S = 0.4, 10.0  # 4 to 100 turns per minute: no rotor is driven so slowly; noise at rest is less


def check_thousands(table: CsvTable, values: Mapping[str, Array]) -> None:
    """Refuse known columns (n,), by their names, that have thousands separators. Raises DataError.

    Columns without their large values would look complete. A point separates thousands where every number has three
    digits after it, and where other columns have decimal commas or the speed would be one at which no rotor turns.
    """
    for name, value in values.items():
        if not np.isfinite(value).all() and (fault := table.fault_in(name)) and fault.endswith(NO_THOUSANDS):
            raise DataError(fault)
    if table.following is None:
        _check_points(table, values)


def _check_points(table: CsvTable, values: Mapping[str, Array]) -> None:
    comma = _decimal_comma(table, [name for name in values if not np.isfinite(values[name]).all()])
    beside = f" beside {comma}" if comma else ""
    for name in values if comma else [name for name in values if _is_no_rotor(name, values[name])]:
        words = table.words(name)
        if _are_pointed(words):
            row, word = next((row, word) for row, word in enumerate(words) if _POINT.fullmatch(word))
            raise DataError(
                f"{table.path}:{table.line_of_row(row)}: '{word}' in column '{name}'{beside}: is its point one of "
                f"thousands? {NO_THOUSANDS}"
            )


def _are_pointed(words: Sequence[str]) -> bool:
    """Return whether all numbers have three digits after a point, apart from zeros and empty fields."""
    rest = [word for word in words if word not in ("", "0")]
    return bool(rest) and all(map(_POINT.fullmatch, rest))


def _decimal_comma(table: CsvTable, names: Sequence[str]) -> str:
    """Return the first number with a decimal comma among columns, and its column; "" where there is none."""
    found = ((word, name) for name in names for word in table.words(name) if has_decimal_comma(word))
    return next((f"'{short(word)}' in column '{name}'" for word, name in found), "")


def _is_no_rotor(name: str, value: Array) -> bool:
    """Return whether a column (n,) is a speed below that of any rotor that is driven."""
    heads = heads_of([name]).get("speeds_rad_s", ())
    low, high = _NO_ROTOR_RAD_S
    return any(low < head.factor * np.nanmax(value, initial=0.0) < high for head, _ in heads)
