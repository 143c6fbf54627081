"""Find which motor of a double stand was recorded, where a file has the columns of both."""

from collections.abc import Mapping, Sequence

import numpy as np

from cfid.errors import DataError
from cfid.records.tables.stand_heads import ColumnHead, side_of
from cfid.records.tables.table import Array, CsvTable

Called = dict[str, list[tuple[ColumnHead, str]]]


def of_one_side(table: CsvTable, called: Called, values: Mapping[str, Array]) -> list[str]:
    """Keep the columns of the only motor that was driven and those of the whole stand, and return a note.

    Raises DataError where two were driven.
    """
    commands = {side: name for _, name in called.get("command", []) if (side := side_of(name)) is not None}
    driven = [side for side, name in commands.items() if _changes(values[name])]
    if len(commands) < 2 or not driven:
        return []
    if len(driven) > 1:
        columns = [name for of_one in called.values() for _, name in of_one if side_of(name) == driven[0]]
        raise DataError(
            f"{table.path}: both sides of a double stand were driven, '{commands[driven[0]]}' and "
            f"'{commands[driven[1]]}'. Name the columns of one by `columns`, as in {_named(table, columns)}."
        )
    for quantity, of_both in called.items():
        called[quantity] = [one for one in of_both if side_of(one[1]) in (None, driven[0])]
    return [f"'{commands[driven[0]]}' alone changes: the columns of the other side are not used."]


def _changes(command: Array) -> bool:
    known = command[np.isfinite(command)]
    return len(known) > 0 and bool(np.ptp(known) > 0)


def _named(table: CsvTable, columns: Sequence[str]) -> str:
    return ",".join(f'"{name}={1 + table.names.index(name)}"' for name in columns)
