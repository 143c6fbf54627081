"""Find another header among the rows of a table: below it, another table begins."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.records.tables.table import CsvTable
from cfid.records.tables.text import has_comma, is_number

_LOOKED_AT = 50  # rows without numbers


def heads_among(table: CsvTable, rows: npt.NDArray[np.intp], count: int) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Yield each of some `rows` whose fields are all words, and the words; `count` is how many rows the table has."""
    looked_at = rows[:_LOOKED_AT]
    if not len(looked_at):
        return
    few = table.without(np.setdiff1d(np.arange(count), looked_at))
    places = [str(place) for place, name in enumerate(table.names, start=1) if name]
    fields = zip(*(few.words(place) for place in places), strict=True)
    for row, words in zip(looked_at, fields, strict=True):
        if all(word and not is_number(word) and not has_comma(word) for word in words):
            yield int(row), words


def repeats_head(table: CsvTable, words: tuple[str, ...]) -> bool:
    """Return whether the words of a row are the table's own names."""
    return words == tuple(name for name in table.names if name)


def refuse_other_head(table: CsvTable, rows: npt.NDArray[np.intp], count: int) -> None:
    """Raise DataError where one of some rows, which lack numbers, is a header with other names."""
    found = next(heads_among(table, rows, count), None)
    if found is None or repeats_head(table, found[1]):
        return
    line = table.line_of_row(found[0])
    raise DataError(
        f"{table.path}:{line}: another header, with other columns or units: another table begins. Give each a file of "
        f"its own, or read the one below by `skip_lines` {line - 1}."
    )
