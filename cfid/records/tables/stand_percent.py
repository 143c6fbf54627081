"""Read cells with a percent sign, as motor vendors write throttle: the sign is a unit, as in a header."""

import re
from collections.abc import Sequence
from dataclasses import replace

from cfid.records.tables.stand_heads import heads_of
from cfid.records.tables.table import CsvTable

_SIGNED = re.compile(r"\d[ ]?%")
_SIGN = re.compile(rb'(?<=[\d.])[ ]?%(?=["\s,;|]|$)')


def with_percent(table: CsvTable) -> CsvTable:
    """Return a table without percent signs after numbers, which become the units of their columns instead.

    Tables of points are short; a long recording keeps its signs, and so does one whose known columns other than
    commands have them.
    """
    if table.following is not None:
        return table
    signed = [name for name in table.names if name and table.names.count(name) == 1 and _is_signed(table.words(name))]
    if not signed or any(heads_of([name]).keys() - {"command"} for name in signed):
        return table
    return replace(table.without_signs(_SIGN), units={**table.units, **dict.fromkeys(signed, "%")})


def with_unit(table: CsvTable, name: str) -> str:
    """Return a column's name, with the unit that its cells state."""
    return f"{name} (%)" if table.units.get(name) == "%" else name


def with_known_units(table: CsvTable) -> CsvTable:
    """Return a table whose columns of per cent have that unit in their name where this makes them commands."""
    own = [(name, with_unit(table, name)) for name in table.names]
    return replace(table, names=tuple(stated if heads_of([stated]) else name for name, stated in own))


def _is_signed(words: Sequence[str]) -> bool:
    """Return whether most cells of a column are numbers with a percent sign."""
    return sum(word.endswith("%") and _SIGNED.search(word) is not None for word in words) > len(words) / 2
