"""Find the units of a load cell's columns, which its header, an option or nothing states, and factors to N and N m."""

import functools
import re
from collections.abc import Mapping, Sequence

import numpy as np

from cfid.errors import ConfigError, DataError
from cfid.records.tables.column_units import column_name, unit_word
from cfid.records.tables.force_units import FORCE_UNITS, FORCES_N, TORQUE_UNITS, TORQUES_NM, pattern_of, si_factor
from cfid.records.tables.table import CsvTable
from cfid.records.tables.wrench_range import Unit, Units

_COUNTS = "counts"
_IN_BRACKETS = re.compile(r"[(\[]([^()\[\]]+)[)\]]\s*$")
_UNITS = {"F": FORCES_N, "T": TORQUES_NM}


@functools.cache
def axis_name(axis: str) -> re.Pattern[str]:
    """Return the pattern of the names of an axis's column, without a unit or with one that is read."""
    return column_name(axis, (_COUNTS,), others=pattern_of(_UNITS[axis[0]]))


def units_of(table: CsvTable, columns: Mapping[str, str], given: Units | None) -> Unit:
    """Return the unit of axes, each in a column: the given one, the header's, else counts.

    Raises DataError for a header with a unit that is not read, or with counts and other units; ConfigError where
    `given` contradicts it.
    """
    found: set[Units] = set()
    stated, factors = False, np.ones(len(columns))
    for place, (axis, column) in enumerate(columns.items()):
        name, own = table.names[table.place(column)], "n" if axis[0] == "F" else "nm"
        _check_unit(table, axis, name)
        word = _stated(table, axis, name)
        factors[place] = 1.0 if word is None else si_factor(word, _UNITS[axis[0]]) or 1.0
        named = None if word is None else unit_word(word) or (own if factors[place] == 1.0 else word)
        wanted = own if given == "n,nm" else given
        if wanted and named and wanted != named:
            raise ConfigError(f"{table.path}: column '{name}' is in {named}, but `units` is {wanted}.")
        found.add("counts" if (named or wanted or _COUNTS) == _COUNTS else "n,nm")
        stated |= named is not None
    if len(found) > 1:
        raise DataError(f"{table.path}: its header has some axes in counts and some not: give `units`.")
    return Unit(found.pop(), "option" if given else "header" if stated else None, factors)


def converted_note(table: CsvTable, columns: Mapping[str, str], units: Unit) -> tuple[str, ...]:
    """Return a note on the axes that are converted to N and N m, each unit once."""
    others: dict[str, list[str]] = {}
    for (axis, column), factor in zip(columns.items(), units.factors, strict=True):
        word = _stated(table, axis, table.names[table.place(column)])
        if factor != 1.0 and word is not None:
            others.setdefault(word, []).append(axis)
    which = " and ".join(f"{', '.join(axes)} in {word}" for word, axes in others.items())
    return (f"{which}: converted to N and N m.",) if others else ()


def refuse_other_units(table: CsvTable, axes: Sequence[str]) -> None:
    """Raise DataError for an axis that the header has only in a unit that is not read."""
    for axis in axes:
        if any(map(axis_name(axis).fullmatch, table.names)):
            continue
        named = (name for name in table.names if re.fullmatch(rf"{axis}[\s_]*", _IN_BRACKETS.sub("", name), re.I))
        for name in named:
            _check_unit(table, axis, name)


def _stated(table: CsvTable, axis: str, name: str) -> str | None:
    """Return the unit that a column's name states, or that the file states in addition to it."""
    known, bracketed = axis_name(axis).fullmatch(name), _IN_BRACKETS.search(name)
    return (known[1] if known else bracketed[1] if bracketed else None) or table.units.get(name)


def _check_unit(table: CsvTable, axis: str, name: str) -> None:
    """Raise DataError for a column whose header states a unit in brackets that is not read."""
    stated = _IN_BRACKETS.search(name)
    if stated is not None and not axis_name(axis).fullmatch(f"{axis} [{stated[1].strip()}]"):
        raise DataError(
            f"{table.path}: column '{name}' is in {stated[1].strip()}: forces are read in {FORCE_UNITS}, torques in "
            f"{TORQUE_UNITS}, or both in counts. Convert it."
        )
