"""Find the lines and fields of a table's text in its bytes, which is much faster than line by line."""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.records.tables.head import COMMENT
from cfid.records.tables.text import TextLine, decoded, fields_of, has_comma, has_decimal_comma, is_prose

Places = npt.NDArray[np.intp]

_SPACE = 32
_CUT_SHARE = 0.002  # of lines; more are not single faults
_ALL_BUT = {separator: bytes({*range(256)} - {ord(separator), ord("\n")}) for separator in (",", ";")}


def evenly_filled(body: bytes, separator: str | None, columns: int) -> bool:
    """Return whether every line has the right number of separators and none is blank; fast."""
    if separator not in _ALL_BUT or columns < 2:
        return False
    signs = body.translate(None, _ALL_BUT[separator])
    return signs == (separator.encode() * (columns - 1) + b"\n") * (len(signs) // columns)


def fields_of_lines(body: bytes, separator: str | None) -> tuple[Places, Places]:
    """Return for every line of the body its number of fields, 0 where it is blank, and where it ends."""
    signs = np.frombuffer(body, np.uint8)
    ends = np.flatnonzero(signs == ord("\n"))
    if separator is None:
        begins = signs > _SPACE
        begins[1:] &= signs[:-1] <= _SPACE
        return np.diff(np.searchsorted(np.flatnonzero(begins), ends), prepend=0), ends
    separators = np.flatnonzero(signs == ord(separator))
    fields = np.diff(np.searchsorted(separators, ends), prepend=0) + 1
    starts = np.concatenate([[0], ends[:-1] + 1])
    if np.any(signs[starts] <= _SPACE):
        fields[~np.logical_or.reduceat(signs > _SPACE, starts)] = 0
    return fields, ends


def without_comments(body: bytes) -> bytes:
    """Return the body with its comments blanked out, so that lines keep their numbers."""
    if not any(sign in body for sign in (b"#", b"%", b"/")):  # one letter is searched for much faster than `//`
        return body
    return re.sub(rf"(?m)^{COMMENT}[^\n]*".encode(), lambda found: b" " * len(found.group()), body)


def without_prose(body: bytes, separator: str | None, columns: int) -> tuple[bytes, tuple[TextLine, ...]]:
    """Return the body with its lines of prose blanked out, and these lines.

    Where few lines have another number of fields than the table has columns, these are prose too: they were cut.
    """
    if b'"' in body:
        return body, ()
    fields, ends = fields_of_lines(body, separator)
    starts = np.concatenate([[0], ends[:-1] + 1])
    odd = np.flatnonzero((fields > 0) & (fields != columns)).tolist()
    lines = (TextLine(at, int(starts[at]), decoded(body[starts[at] : ends[at]])) for at in odd)
    few = len(odd) <= _CUT_SHARE * np.count_nonzero(fields)
    found = tuple(line for line in lines if few or is_prose(line.text, separator))
    return blanked(body, [line.number for line in found]), found


def blanked(body: bytes, lines: Sequence[int]) -> bytes:
    """Return the body with some of its lines, counted from 0, blanked out, so that lines keep their numbers."""
    if not len(lines):
        return body
    ends = np.flatnonzero(np.frombuffer(body, np.uint8) == ord("\n"))
    content = bytearray(body)
    for at in lines:
        begin, end = (int(ends[at - 1]) + 1 if at else 0), int(ends[at])
        content[begin:end] = b" " * (end - begin)
    return bytes(content)


class Rows(NamedTuple):
    """Lines of a table, the lines of words among them, and whether every line is known to be a row."""

    body: bytes
    prose: tuple[TextLine, ...]
    even: bool


def rows_of(text: bytes, separator: str | None, columns: int, first_line: int) -> Rows:
    """Return lines in which comments and lines of words are blanked out, and the lines of words."""
    body = without_comments(text)
    if evenly_filled(body, separator, columns):
        return Rows(body, (), True)
    body, prose = without_prose(body, separator, columns)
    return Rows(body, tuple(line._replace(number=first_line + line.number) for line in prose), False)


def unquoted(body: bytes, separator: str | None) -> bytes:
    """Return lines without quotes; between commas, quoted decimal commas become points."""
    lines = body.decode("latin-1").split("\n")
    between = separator or " "
    quoted = {i: fields_of(line, separator) for i, line in enumerate(lines) if '"' in line}
    decimal = between == "," and any(has_decimal_comma(field) for fields in quoted.values() for field in fields)
    for i, fields in quoted.items():
        points = (one.replace(",", ".") if decimal and has_comma(one) else one for one in fields)
        lines[i] = between.join(field.replace(between, "?") for field in points)
    return "\n".join(lines).encode("latin-1")
