"""Read columns of numbers from any CSV file, with errors that name the line.

This module handles separators, headers and cut files; other modules interpret the columns.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.large import joined
from cfid.records.tables.fields import (
    Places,
    blanked,
    evenly_filled,
    fields_of_lines,
    rows_of,
    unquoted,
)
from cfid.records.tables.forms import Form
from cfid.records.tables.line_faults import fault_of
from cfid.records.tables.parsed import Spelling, columns_in, holds_truths, is_exact_in, known_columns_in, words_in
from cfid.records.tables.text import (
    TextLine,
    decimal_sign,
    fields_of,
    filled_lines,
    last_row,
    short,
    whole_lines,
)

Array = npt.NDArray[np.float64]

_LOOKED_AT = 10_000  # rows that are searched for what is not a number


@dataclass(frozen=True, kw_only=True)
class CsvTable:
    """A CSV file, opened but not yet parsed: column names ('1', '2', ... without a header) and its body.

    A column is selected by its name, or by its number counted from 1. `preamble` is how many lines were left out
    above the header, `above` the text above the rows, `prose` are lines of words among the rows, also left out. `units`
    are those that the file states in addition to the names, as cfid's own MATLAB files do; "" is an unknown one. For a
    large file, `following()` yields the blocks of lines after this one, whose columns are read one after another.
    """

    path: Path
    sha256: str
    names: tuple[str, ...]
    has_head: bool
    cut: bool  # the last line has no end, and is left out
    unended: bool  # it has none, and is a row
    preamble: int
    decimal: str
    above: str = ""
    prose: tuple[TextLine, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    following: "Following | None" = None
    form: Form = field(default_factory=Form)
    _body: bytes
    _even: bool  # whether every line is known to have as many fields as there are columns
    _first_line: int
    _separator: str | None  # None: any run of spaces and tabs
    _left_out: Places = field(default_factory=lambda: np.empty(0, np.intp))
    _typed: bool = False  # whether a last line without its end may be a row
    _rows_before: int = 0  # in the file, where the form of the rows counts them

    def numbers(self, columns: Sequence[str]) -> Array:
        """Return the named columns, shape (rows, columns).

        Raises DataError naming the line of the first row that has a wrong number of fields, or no finite number in one
        of these columns.
        """
        places = [self.place(name) for name in columns]
        return joined(block._numbers(places) for block in self._blocks_or_self())

    def _numbers(self, places: list[int]) -> Array:
        rows = self._rows()
        if rows is not None and holds_truths(rows):
            self._check_lines(places)
        values = None if rows is None else columns_in(rows, places, self._spelling)
        if values is None or not np.all(np.isfinite(values)):
            self._check_lines(places)
            raise DataError(f"{self.path}: not readable as a table of numbers.")
        return values

    def known_numbers(self, columns: Sequence[str]) -> Array:
        """Return the named columns, shape (rows, columns), nan where a field is not a finite number.

        Raises DataError naming the line of the first row that has a wrong number of fields.
        """
        places = [self.place(name) for name in columns]
        return joined(block._known_numbers(places) for block in self._blocks_or_self())

    def _known_numbers(self, places: list[int]) -> Array:
        rows = self._rows()
        if rows is None:
            self._check_lines(())
            raise DataError(f"{self.path}: not readable as a table.")
        values = None if holds_truths(rows) else columns_in(rows, places, self._spelling)
        if values is None:
            values = known_columns_in(rows, places, self._spelling)
        return np.where(np.isfinite(values), values, np.nan)

    def words(self, column: str) -> list[str]:
        """Return a column's fields as written, without spaces around them; `known_numbers` checks the lines first."""
        place = self.place(column)
        return [
            word for block in self._blocks_or_self() for word in words_in(block._rows() or b"", place, self._spelling)
        ]

    def fault_in(self, column: str) -> str | None:
        """Return a sentence on the first field of a column that is neither empty nor a number, None without one.

        In a long file, only the first rows are searched.
        """
        place = self.place(column)
        for line in islice(filled_lines(self._body), _LOOKED_AT):
            fields = fields_of(line.text, self._separator)
            if len(fields) == len(self.names) and fields[place]:
                fault = fault_of(line.text, self.names, [place], self._spelling)
                if fault is not None:
                    return f"{self.path}:{self._first_line + line.number - 1}: {fault}"
        return None

    @property
    def _spelling(self) -> Spelling:
        return Spelling(self._separator, self.decimal)

    def loses_digits(self, column: str) -> bool:
        """Return whether a whole number in a column, as it is written, is not exact as a 64-bit float."""
        rows = self._rows()
        return rows is not None and not is_exact_in(rows, self.place(column), self._spelling)

    def without(self, rows: Sequence[int] | Places) -> "CsvTable":
        """Return the table without some rows, counted from 0; the others keep their lines."""
        chosen = np.sort(np.asarray(rows, np.intp))
        before = np.searchsorted(self._left_out - np.arange(len(self._left_out)), chosen, side="right")
        return replace(self, _left_out=np.sort(np.append(self._left_out, chosen + before)))

    def blocks(self) -> "Iterator[CsvTable]":
        """Yield the blocks of the table that have a row, each a table of its own."""
        begin = 0
        first = replace(self, following=None, _left_out=self._left_out[:0])
        for block in chain([first], self.following() if self.following else ()):
            if not block.filled:
                continue
            if len(self._left_out):
                end = begin + block._count
                here = self._left_out[(self._left_out >= begin) & (self._left_out < end)]
                kept, begin = block._blanked(here - begin), end
                if kept.filled:
                    yield kept
            else:
                yield block

    def _blocks_or_self(self) -> "Iterator[CsvTable]":
        blocks = self.blocks()
        return chain([next(blocks, self)], blocks)

    def _blanked(self, rows: Places) -> "CsvTable":
        fields, _ = fields_of_lines(self._body, self._separator)
        return replace(self, _body=blanked(self._body, np.flatnonzero(fields)[rows].tolist()), _even=False)

    def place(self, column: str) -> int:
        """Return the position of a column, counted from 0.

        Raises DataError when there is no such column, or more than one.
        """
        there = [i for i, name in enumerate(self.names) if name == column]
        if len(there) > 1:
            numbers = ", ".join(str(i + 1) for i in there)
            raise DataError(f"{self.path}: the columns {numbers} are all named '{column}': give a number instead.")
        if there:
            return there[0]
        if column.isdecimal() and 0 < int(column) <= len(self.names):
            return int(column) - 1
        raise DataError(f"{self.path}: no column '{column}'; it has {self.listing}.")

    @property
    def listing(self) -> str:
        """The columns' names, for a message; a column without a name is listed by its number, which selects it."""
        return short(", ".join(name or f"column {at}" for at, name in enumerate(self.names, start=1)), 200)

    def continued(self, content: bytes) -> "CsvTable":
        """Return the table of the lines that follow this one's in the file; `content` is whole lines, except the last.

        Only the first block of a large file has a header.
        """
        text, rest = whole_lines(content)
        last = last_row(text, self.form.plain(rest), self._separator) if self._typed else b""
        first_line = self._first_line + self._body.count(b"\n")
        before = self._rows_before + self._count if self.form.step_s else 0
        rows = rows_of(self.form.plain(text) + last, self._separator, len(self.names), first_line)
        shown = self.decimal == "," or b"." in self._body  # whole numbers show no decimal sign
        decimal = self.decimal if shown else decimal_sign(rows.body, self._separator)
        return replace(
            self,
            cut=bool(rest) and not last,
            unended=bool(last),
            decimal=decimal,
            prose=rows.prose,
            following=None,
            _body=self.form.timed(rows.body, self._separator, decimal, row=before),
            _rows_before=before,
            _even=rows.even,
            _first_line=first_line,
        )

    def all_prose(self) -> list[TextLine]:
        """Return the lines of words of all blocks."""
        return [*self.prose, *(self.following.all_prose() if self.following else ())]

    @property
    def filled(self) -> bool:
        """Whether the table has any row."""
        return bool(self._body.strip())

    @property
    def layout(self) -> str:
        """What is unusual about the file's layout, for the line that states how it was read."""
        lines = "1 line that is" if self.preamble == 1 else f"{self.preamble} lines that are"
        above = f", below {lines} no header" if self.preamble else ""
        return above + (", with decimal commas" if self.decimal == "," else "")

    def line_of_row(self, row: int) -> int:
        """Return the line of the file, counted from 1, that holds a row, counted from 0."""
        if self._even and not len(self._left_out) and (self.following is None or self.following.even):
            return self._first_line + row
        for block in self.blocks():
            if row < block._count:
                return block._first_line + int(np.flatnonzero(fields_of_lines(block._body, block._separator)[0])[row])
            row -= block._count
        raise IndexError(row)

    @property
    def _count(self) -> int:
        return int(np.count_nonzero(fields_of_lines(self._body, self._separator)[0]))

    def _rows(self) -> bytes | None:
        """Return the body without quotes and blank lines; None when some row has too many or too few fields.

        pandas would silently drop surplus fields, and read on from an open quote to the next one; it gets only rows in
        which neither can happen.
        """
        if b"\0" in self._body:
            return None
        table = self._unquoted() if b'"' in self._body else self
        if table._even:
            return table._body
        fields, ends = fields_of_lines(table._body, table._separator)
        filled = fields > 0
        if np.any(fields[filled] != len(self.names)):
            return None
        if np.all(filled):
            return table._body
        kept = np.repeat(filled, np.diff(ends, prepend=-1))
        return np.frombuffer(table._body, np.uint8)[kept].tobytes()

    def _unquoted(self) -> "CsvTable":
        body = unquoted(self._body, self._separator)
        return replace(self, _body=body, _even=evenly_filled(body, self._separator, len(self.names)))

    def _check_lines(self, places: Sequence[int]) -> None:
        """Check every line by itself; slow."""
        for line in filled_lines(self._body):
            fault = fault_of(line.text, self.names, places, self._spelling)
            if fault:
                raise DataError(f"{self.path}:{self._first_line + line.number - 1}: {fault}")


@dataclass
class Following:
    """The blocks of lines after a large file's first, read anew at every call.

    Once all have been read, their prose is known, and `even` is whether every line of theirs is a row.
    """

    blocks: Callable[[], Iterator[CsvTable]]
    even: bool = False
    _prose: list[TextLine] | None = None

    def __call__(self) -> Iterator[CsvTable]:
        """Yield one block after another."""
        prose: list[TextLine] = []
        even = True
        for block in self.blocks():
            prose += block.prose
            even &= block._even
            yield block
        self.even, self._prose = even, prose

    def all_prose(self) -> list[TextLine]:
        """Return the blocks' lines of words."""
        if self._prose is None:
            deque(self(), maxlen=0)
        return self._prose or []
