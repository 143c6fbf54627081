"""Read a text table of numbers from any program, in one pass, with faults that name the line.

Nothing is guessed but the separator. A head is the last line above the first row with as many fields as the rows; an
`#` or `%` before it does not count. Lines without a number, lines with too many fields and a cut last line are left
out, with a finding; a field that is not a number is nan.
"""

import csv
import hashlib
import io
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import numpy as np
import pandas as pd
from pandas.api.types import is_bool_dtype, is_numeric_dtype
from pandas.errors import ParserError

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, finding
from cfid.large import as_columns
from cfid.recordings.recording import ANGLE, TIME, Array, Column, How, is_angle, is_time
from cfid.records.files import check_regular
from cfid.records.parameters import Source
from cfid.units import split_unit

BLOCK_BYTES = 1 << 22
_HEAD_BYTES = 1 << 16  # within which the rows begin
_LONGEST_LINE = 1 << 20
_LEFT_OUT_SHARE = 0.01  # of a table's lines that may be damaged
_BOM = b"\xef\xbb\xbf"
_OF_NUMBERS = b"0123456789+-.eE \r\nnaNiIfF"  # with those of nan and inf
_CALLED = {TIME: is_time, ANGLE: is_angle}
_COMMENT = ("#", "%", "//")
_OTHER_FILES = {
    b"PK\x03\x04": "a spreadsheet (.xlsx) or packed files: save the table as CSV, or unpack it.",
    b"\xd0\xcf\x11\xe0": "a spreadsheet (.xls): save the table as CSV.",
    b"\x1f\x8b": "a packed file (.gz): unpack it.",
    b"\xff\xfe": "text in UTF-16: save it as UTF-8.",
    b"\xfe\xff": "text in UTF-16: save it as UTF-8.",
    b"PAR1": "a Parquet file: save the table as CSV.",
    b"\x89MCAP": "an MCAP file: import the recording that it was made of.",
    b"{": "JSON: write a CSV table of it, with a column for the time and one for each signal.",
    b"[": "JSON: write a CSV table of it, with a column for the time and one for each signal.",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """How the lines of a file are laid out: the separator (None for spaces), heads, and the line of the first row.

    `above` is the text above the head. `lines_above` are the lines up to the first row, without it.
    """

    separator: str | None
    decimal: str
    heads: tuple[str, ...]
    has_head: bool
    above: str
    lines_above: int

    def fields(self, line: str) -> list[str]:
        """Return the fields of a line, without quotes and spaces around them."""
        if self.separator is None:
            return line.replace('"', "").split()
        if '"' not in line:
            return [part.strip() for part in line.split(self.separator)]
        try:
            parts = next(csv.reader([line], delimiter=self.separator, skipinitialspace=True), [])
        except csv.Error:  # a carriage return of its own, or a field that is longer than csv allows
            parts = line.replace('"', "").split(self.separator)
        return [part.strip() for part in parts]

    def is_number(self, text: str) -> bool:
        """Return whether a field is written as a number, nan and inf included."""
        try:
            float(text.replace(self.decimal, "."))
        except ValueError:
            return False
        return True

    def is_row(self, line: str) -> bool:
        """Return whether a line is a row of the table: no words alone, and no more fields than there are columns."""
        if not line.strip() or line.lstrip().startswith(_COMMENT) or line.count('"') % 2:
            return False
        fields = self.fields(line)
        surplus = fields[len(self.heads) :]
        return not any(surplus) and (any(map(self.is_number, fields)) or not any(fields))


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """The columns of a file by its own heads, '1', '2', ... without any, and what was found on the way.

    Values are nan where a field is no number.
    """

    path: Path
    source: Source
    layout: Layout
    columns: tuple[Column, ...]
    rows: int
    findings: tuple[Finding, ...]
    selected: tuple[tuple[int, str], ...] = ()

    @property
    def heads(self) -> tuple[str, ...]:
        """The names of the columns, with their units, as the file has them."""
        return self.layout.heads

    def line_of_row(self, row: int) -> int:
        """Return the line of the file, counted from 1, of a row, counted from 0. The file is read again for it."""
        at = -1
        with self.path.open(encoding="utf-8-sig", errors="replace", newline=None) as file:
            for number, line in enumerate(file, start=1):
                if number > self.layout.lines_above and self.layout.is_row(line):
                    fields = self.layout.fields(line)
                    at += all(fields[place : place + 1] == [word] for place, word in self.selected)
                    if at == row:
                        return number
        return self.layout.lines_above + 1 + row  # the file was changed


def read_table(path: Path, how: How | None = None, *, of_run: bool = False) -> Table:
    """Read a table between commas, semicolons, tabs or spaces.

    In a file `of_run`, which cfid writes in whole lines, a last line without an end was cut.

    Raises DataError for a file that is no table, or in which more than one line in a hundred is damaged; ConfigError
    for options that contradict it.
    """
    how = how or How()
    try:
        check_regular(path)
        with path.open("rb") as file:
            return _read(path, file, how, of_run=of_run)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file.", code="no-file") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.", code="unreadable") from None


def _read(path: Path, file: IO[bytes], how: How, *, of_run: bool) -> Table:
    start = file.read(_HEAD_BYTES)
    kind = next((what for begin, what in _OTHER_FILES.items() if start.removeprefix(_BOM).startswith(begin)), None)
    if kind is None and start.count(b"\r") > 1 + 2 * start.count(b"\n"):
        kind = "text with the line ends of an old Mac: save the table as CSV in UTF-8."
    if kind is not None or b"\0" in start:
        raise DataError(f"{path}: this is {kind or 'no text: name a table, or a log that `cfid import` reads.'}")
    layout = layout_of(path, start, how)
    selected = tuple((_place(path, layout.heads, name), word) for name, word in how.rows)
    file.seek(0)
    lines = _Lines(file, layout, selected, of_run=of_run)
    count = len(layout.heads)
    values = as_columns(lines.blocks(), count, most_rows=1 + lines.size // count)
    rows = len(values[0])
    table = Table(
        path=path,
        source=Source(str(path), lines.sha256.hexdigest()),
        layout=layout,
        columns=(),
        rows=rows,
        findings=tuple(one.at(path.name) for one in lines.findings(rows)),
        selected=selected,
    )
    if not rows:
        rest = " with these `rows`" if selected else ": it ends after its header"
        raise DataError(f"{path}: has no row{rest}.", code="no-rows")
    if lines.left_out > _LEFT_OUT_SHARE * (rows + lines.left_out) + 1:
        raise DataError(
            f"{path}:{lines.first_left_out}: {lines.fault}, as in {lines.left_out} lines. Correct them, or is this not "
            "the table? See `skip_lines` and `decimal`.",
            code="damaged-lines",
        )
    return replace(table, columns=_columns(table, values, how))


class _Lines:
    """The numbers of a file, block by block, its checksum, and how many lines were left out, and why."""

    def __init__(self, file: IO[bytes], layout: Layout, selected: Sequence[tuple[int, str]], *, of_run: bool) -> None:
        self.file, self.layout, self.selected, self.of_run = file, layout, selected, of_run
        self.size = os.fstat(file.fileno()).st_size  # what a growing file has after it is not read
        self.sha256 = hashlib.sha256()
        self.left_out, self.first_left_out, self.fault = 0, 0, ""
        self.cut = self.unended = False

    def blocks(self) -> Iterator[Array]:
        """Yield the numbers (rows, columns) of one block of whole lines after another."""
        begin, rest, above = 0, b"", self.layout.lines_above  # where a block begins in the file
        left = self.size
        while content := self.file.read(min(BLOCK_BYTES, left)):
            left -= len(content)
            self.sha256.update(content)
            content = rest + content
            end = content.rfind(b"\n") + 1
            block, rest = content[:end], content[end:]
            if len(rest) > _LONGEST_LINE:
                raise DataError(f"{self.file.name}: a line of more than {_LONGEST_LINE} bytes: this is no table.")
            while above and block:
                line = block.find(b"\n") + 1
                block, begin, above = block[line:], begin + line, above - 1
            if block:
                yield self._numbers(block, begin)
            begin += len(block)
        if rest.strip() and not above:
            text = _decoded(rest)
            is_whole = len(self.layout.fields(text)) == len(self.layout.heads) and self.layout.is_row(text)
            self.unended = is_whole and not self.of_run
            self.cut = not self.unended
            if self.unended:
                yield self._parsed(rest)[0]

    def _numbers(self, block: bytes, begin: int) -> Array:
        """Return the numbers of a block of lines that begins at a byte of the file."""
        if not block.translate(None, _OF_NUMBERS + (self.layout.separator or " ").encode()):
            try:
                values, surplus = self._parsed(block, spaces=self.layout.separator is None)
            except ParserError:  # several fields too many
                surplus = True
            if not surplus:
                return values
        return self._parsed(self._rows(block, begin))[0]

    def _rows(self, block: bytes, begin: int) -> bytes:
        """Return a block without its lines that are no rows; these are counted, but for blank lines and comments."""
        rows = []
        for number, content in enumerate(block.split(b"\n")[:-1], start=1):
            text = _decoded(content)
            if self.layout.is_row(text):
                rows.append(content.rstrip(b" \r" + (self.layout.separator or " ").encode()))
            elif text.strip() and not text.lstrip().startswith(_COMMENT):
                if not self.left_out:
                    self.first_left_out, self.fault = self._lines_before(begin) + number, self._fault(text)
                self.left_out += 1
        return b"".join(row + b"\n" for row in rows)

    def _lines_before(self, begin: int) -> int:
        with Path(self.file.name).open("rb") as file:
            return file.read(begin).count(b"\n")

    def _fault(self, text: str) -> str:
        count, columns = len(self.layout.fields(text)), len(self.layout.heads)
        if count > columns:
            return f"{count} fields where the table has {columns}"
        return f"'{_short(text.strip())}' has no number"

    def _parsed(self, rows: bytes, *, spaces: bool = True) -> tuple[Array, bool]:
        """Return the numbers of some rows, of the selected ones alone, and whether one has a field too many.

        `spaces` is whether there may be some before a field's quotes.
        """
        layout, columns = self.layout, len(self.layout.heads)
        if not rows.strip():
            return np.empty((0, columns)), False
        frame = pd.read_csv(
            io.BytesIO(rows),
            sep=r"\s+" if layout.separator is None else layout.separator,
            decimal=layout.decimal,
            header=None,
            names=range(columns + 1),
            index_col=False,
            skipinitialspace=spaces,
            encoding="latin-1",
            low_memory=False,
        )
        surplus = bool(frame.pop(columns).notna().any())
        for place, word in self.selected:
            frame = frame[frame[place].astype(str).str.strip() == word]
        for name in [name for name, kind in frame.dtypes.items() if not is_numeric_dtype(kind) or is_bool_dtype(kind)]:
            words = frame[name].astype(str).str.strip().str.replace(layout.decimal, ".")
            frame[name] = pd.to_numeric(words, errors="coerce")
        values = frame.to_numpy(np.float64, copy=True)
        values[np.isinf(values)] = np.nan
        return values, surplus

    def findings(self, rows: int) -> Iterator[Finding]:
        """Yield what was found in the lines of a table with some rows."""
        if self.layout.decimal == ",":
            yield finding("decimal-comma")
        if self.left_out:
            yield finding("lines-left-out", count=self.left_out, rows=rows + self.left_out, line=self.first_left_out)
        if self.cut:
            yield finding("last-line-cut")
        if self.unended:
            yield finding("last-line-unended")


def _columns(table: Table, values: Sequence[Array], how: How) -> tuple[Column, ...]:
    """Return the columns of a table with the names and units that the heads and the options state."""
    named = dict(word.partition("=")[::2] for word in how.columns if "=" in word)
    names = {_place(table.path, table.heads, column): name for name, column in named.items()}
    columns = []
    for place, head in enumerate(table.heads):
        name, unit = split_unit(head)
        if place in names:
            name = names[place]
        elif name in named:
            name = f"{name} ({place + 1})"
        columns.append(Column(name=name, unit=unit, values=values[place], head=head))
    return with_units(table.path, columns, how)


def with_units(path: Path, columns: Sequence[Column], how: How) -> tuple[Column, ...]:
    """Return columns with the units that options state; `t` is the time and `phi` the angle, whatever it is called.

    Raises ConfigError where there is no such column.
    """
    known = list(columns)
    for name, unit in how.units.items():
        places = [at for at, one in enumerate(known) if name in (one.name, one.head, str(at + 1))]
        if not places and name in _CALLED:
            places = [at for at, one in enumerate(known) if _CALLED[name](one.name)]
            places = places or ([0] if name == ANGLE and len(known) == 1 else [])
        if not places:
            listing = ", ".join(one.head or one.name for one in known)
            raise ConfigError(f"{path}: `unit` {name}={unit}: no such column among {listing}.", code="no-column")
        known[places[0]] = replace(known[places[0]], unit=unit)
    return tuple(known)


def _place(path: Path, heads: Sequence[str], column: str) -> int:
    """Return the place of a column by its head, its name without the unit, or its number counted from 1."""
    for names in (list(heads), [split_unit(head)[0] for head in heads]):
        if names.count(column) == 1:
            return names.index(column)
    if column.isdecimal() and 0 < int(column) <= len(heads):
        return int(column) - 1
    raise ConfigError(f"{path}: no column '{column}'; it has {_short(', '.join(heads), 200)}.", code="no-column")


def layout_of(path: Path, start: bytes, how: How) -> Layout:
    """Return the layout of a table that begins with some bytes. Raises DataError where no row begins in them."""
    lines = _decoded(start.removeprefix(_BOM)).split("\n")
    if len(start) >= _HEAD_BYTES:
        lines = lines[:-1]  # of unknown length
    for at, line in enumerate(lines[how.skip_lines :], start=how.skip_lines):
        if not line.strip() or line.lstrip().startswith(_COMMENT):
            continue
        layout = Layout(
            separator=_separator(line, how.decimal),
            decimal=how.decimal,
            heads=(),
            has_head=False,
            above="",
            lines_above=at,
        )
        fields = layout.fields(line)
        if _holds_numbers(layout, fields):
            return _with_heads(path, layout, fields, lines[how.skip_lines : at])
    what = "no row of numbers" if any(line.strip() for line in lines[how.skip_lines :]) else "no row"
    where = f"below its first {how.skip_lines} lines" if how.skip_lines else f"in its first {len(lines)} lines"
    raise DataError(
        f"{path}: {what} {where}. Decimal commas are read by `cfid import` alone, with `decimal`: "
        "write points elsewhere.",
        code="no-rows",
    )


def _holds_numbers(layout: Layout, fields: Sequence[str]) -> bool:
    """Return whether at least half of the fields that hold anything are numbers."""
    filled = [text for text in fields if text]
    return bool(filled) and 2 * sum(map(layout.is_number, filled)) >= len(filled)


def _with_heads(path: Path, layout: Layout, row: Sequence[str], above: Sequence[str]) -> Layout:
    """Return the layout with the heads of its columns, of the last line above the first row that may be a head."""
    count = 1 + max(place for place, text in enumerate(row) if text)
    for at in range(len(above) - 1, -1, -1):
        line = above[at].strip()
        if not line:
            continue
        heads = layout.fields(line.lstrip("#%/ "))
        while heads and not heads[-1]:
            heads.pop()
        is_head = len(heads) >= count and not any(map(layout.is_number, heads)) and any(heads)
        if is_head and (len(heads) == count or not line.startswith(_COMMENT)):
            return replace(layout, heads=tuple(heads), has_head=True, above="\n".join(above[:at]))
        if not line.startswith(_COMMENT):
            break
    numbers = tuple(str(place) for place in range(1, count + 1))
    return replace(layout, heads=numbers, above="\n".join(above))


def _separator(line: str, decimal: str) -> str | None:
    is_quoted = '",' in line or ',"' in line  # so that commas also divide numbers with decimal commas
    signs = (";", "\t", ",") if decimal == "." or is_quoted else (";", "\t")
    return next((sign for sign in signs if sign in line), None)


def _decoded(content: bytes) -> str:
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def _short(text: str, length: int = 40) -> str:
    return text if len(text) <= length else f"{text[:length]}..."
