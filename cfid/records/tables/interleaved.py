"""Refuse tables in which rows of several recordings take turns: times repeat, and a column names the recording."""

from collections.abc import Collection
from itertools import pairwise

from cfid.errors import DataError
from cfid.records.tables.table import CsvTable
from cfid.records.tables.text import short

_LOOKED_AT = 2000  # rows
_MANY, _NEARLY_ALL = 0.1, 0.95  # share of rows that repeat a time; share of these in which a column differs
_MOST = 16  # recordings


def refuse_interleaved(table: CsvTable, time: str, others: Collection[str]) -> None:
    """Raise DataError where rows repeat times and another column, of few values, shows which recording a row is of.

    Rows of the same time with numbers in different columns are of one recording with several rates.
    """
    first, place = next(table.blocks(), table), table.place(time)
    columns = [first.words(str(number))[:_LOOKED_AT] for number, _ in enumerate(table.names, start=1)]
    rows = list(zip(*columns, strict=True))
    pairs = [(one, two) for one, two in pairwise(rows) if one[place] == two[place]]
    alike = [(one, two) for one, two in pairs if [bool(field) for field in one] == [bool(field) for field in two]]
    if len(pairs) <= _MANY * len(rows) or len(alike) < _NEARLY_ALL * len(pairs):
        return
    for name in others:
        at = table.place(name)
        values = dict.fromkeys(row[at] for row in rows)
        apart = sum(one[at] != two[at] for one, two in alike)
        if len(values) <= min(_MOST, len(rows) // _MOST) and apart >= _NEARLY_ALL * len(alike):
            shown = short(", ".join(values))
            raise DataError(
                f"{table.path}: {len(pairs)} of the first {len(rows)} rows repeat the time of the one before, and "
                f"column '{name}' tells them apart ({shown}): recordings of several vehicles or devices take turns. "
                "Write the rows of each into a file of its own."
            )
