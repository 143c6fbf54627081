"""Open a table of any size: a large one is read in blocks of whole lines, one after another."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import BinaryIO

from cfid.errors import ConfigError, DataError
from cfid.records.files import check_regular, sha256_of
from cfid.records.tables.fields import rows_of
from cfid.records.tables.forms import form_of
from cfid.records.tables.head import head_of
from cfid.records.tables.matlab import csv_blocks, is_matlab, matlab_table
from cfid.records.tables.matlab_structs import MatlabTable
from cfid.records.tables.table import CsvTable, Following
from cfid.records.tables.text import check_text, decimal_sign, decoded, last_row, whole_lines

BLOCK_BYTES = 1 << 20
_FEWEST_LINES = 4  # of a large table's first block: a header, its units, two rows


def open_table(
    path: Path,
    *,
    skip_lines: int = 0,
    columns: Sequence[str] = (),
    sha256: str | None = None,
    typed: bool = False,
) -> CsvTable:
    """Open a CSV file, separated by commas, semicolons, tabs or spaces, with or without a header.

    A MATLAB file is read like a CSV file of its arrays; where it has several tables, `columns` chooses one.
    Lines above the header and lines of comments are left out; between semicolons, tabs and spaces, numbers may have
    decimal commas. A last line without its newline is left out (`cut`), since a cut number may look plausible; of a
    table of points, which may be `typed`, it is a row if it has the form of the line before (`unended`).
    `sha256` is the file's, where it is known.

    Raises DataError when the file is missing, empty or not a table of numbers.
    """
    if skip_lines < 0:
        raise ConfigError(f"`skip_lines` {skip_lines}: has to be zero or more.")
    if is_matlab(path):
        return _of_matlab(matlab_table(path, columns), path, sha256_of(path) if sha256 is None else sha256)
    try:
        check_regular(path)
        with path.open("rb") as file:
            content = _block(file, path)
            size = file.seek(0, 2)
            file.seek(max(size - BLOCK_BYTES, 0))
            end = file.read()
    except FileNotFoundError:
        raise DataError(f"{path}: no such file.") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.") from None
    if size > len(content) and content.count(b"\n") < _FEWEST_LINES:
        raise DataError(f"{path}: lines of {len(content) // _FEWEST_LINES >> 10} kB or more: not a table of numbers.")
    check_text(path, content)
    sha256 = sha256_of(path) if sha256 is None else sha256
    table = _table_in(path, content, sha256=sha256, skip_lines=skip_lines, typed=typed)
    if size == len(content):
        return table
    last = table.continued(end)  # as far as its last line is concerned
    following = Following(partial(_following, table, len(content)))
    return replace(table, cut=last.cut, unended=last.unended, following=following)


def _table_in(path: Path, content: bytes, *, sha256: str, skip_lines: int = 0, typed: bool = False) -> CsvTable:
    """Return the table in a file's content, or in its beginning. Raises DataError as `open_table`."""
    text, rest = whole_lines(content)
    if not text or text.isspace():
        raise DataError(f"{path}: its only line has no end: the recording was cut before its first row.")
    form = form_of(text)
    text = form.plain(text)
    head = head_of(path, text, skip_lines=skip_lines)
    last = last_row(text, form.plain(rest), head.separator) if typed else b""
    rows = rows_of(text[head.row.begin :] + last, head.separator, len(head.names), head.row.number)
    decimal = decimal_sign(rows.body, head.separator)
    above = text[: head.row.begin]
    form = form.completed(above, head)
    return CsvTable(
        path=path,
        sha256=sha256,
        names=head.names,
        has_head=head.has_head,
        cut=bool(rest) and not last,
        unended=bool(last),
        preamble=head.preamble,
        decimal=decimal,
        above=decoded(above),
        prose=rows.prose,
        form=form,
        _body=form.timed(rows.body, head.separator, decimal, row=0),
        _even=rows.even,
        _first_line=head.row.number,
        _separator=head.separator,
        _typed=typed,
    )


def _of_matlab(content: MatlabTable, path: Path, sha256: str) -> CsvTable:
    first, *others = islice(csv_blocks(content), 2)
    table = replace(_table_in(path, first, sha256=sha256), units=content.units)
    return replace(table, following=Following(partial(_continued, table, content))) if others else table


def _continued(first: CsvTable, content: MatlabTable) -> Iterator[CsvTable]:
    table = first
    for lines in islice(csv_blocks(content), 1, None):
        table = table.continued(lines)
        yield table


def _block(file: BinaryIO, path: Path) -> bytes:
    """Return the next whole lines. Raises DataError for a line longer than any table's, as it may fill the memory."""
    content, rest = file.read(BLOCK_BYTES), file.readline(BLOCK_BYTES)
    if len(rest) == BLOCK_BYTES and not rest.endswith(b"\n"):
        raise DataError(f"{path}: a line of more than {BLOCK_BYTES >> 20} MB: not a table of numbers.")
    return content + rest


def _following(first: CsvTable, begin: int) -> Iterator[CsvTable]:
    """Yield the blocks of a file that follow its first one, from a byte on."""
    table = first
    try:
        with first.path.open("rb") as file:
            file.seek(begin)
            while content := _block(file, first.path):
                table = table.continued(content)
                yield table
    except OSError as error:
        raise DataError(f"{first.path}: cannot be read: {error.strerror}.") from None
