"""Split a text file into complete lines, and a line into fields."""

import csv
import itertools
import math
import re
import string
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from cfid.errors import DataError
from cfid.records.files import read_small

_BOM = b"\xef\xbb\xbf"
_NO_BREAK_SPACE = re.compile(rb"\xc2\xa0|(?<=[\x00-\x7f])\xa0")  # in UTF-8, and as one byte after an ASCII character
_MINUS = "\u2212".encode()  # in typeset numbers
_OTHER_BOMS = (b"\xff\xfe", b"\xfe\xff", b"\0\0\xfe\xff")  # UTF-16 and UTF-32
_OTHER_FILES = {
    b"PK\x03\x04": "a spreadsheet (.xlsx) or packed files (.zip, .npz): save the table as CSV, or unpack it.",
    b"\xd0\xcf\x11\xe0": "a spreadsheet (.xls): save the table as CSV.",
    b"\x1f\x8b": "a packed file (.gz): unpack it.",
    b"ARROW1": "a Feather file: save the table as CSV.",
    b"\x93NUMPY": "an array of NumPy: save it as CSV, with a header, or as .mat.",
}
_WRITTEN_ONLY = {b"\x89MCAP0\r\n": "an MCAP", b"PAR1": "a Parquet"}
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")
_LOOKED_AT = 4096  # bytes at the start of a file, where text has no control characters
_DARK = re.compile(r"[^\x00-\x20]+")
NUMBER = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_ONE_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
_COMMA_NUMBER = re.compile(r"[+-]?(?=[\d.,']*\d,\d)[\d.,']+(?:e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
_FIELD = rb"(?m)(?:^|(?<=[;\t ]))[+-]?(%s)(?:[eE][+-]?\d+)?[ \r]*(?=[;\t ]|$)"
_DECIMAL_COMMA = re.compile(_FIELD % rb"\d+,\d+")
_DECIMAL_POINT = re.compile(_FIELD % rb"\d*\.\d+")
_THOUSANDS = re.compile(rb"[1-9]\d{0,2},\d{3}")


class TextLine(NamedTuple):
    """A line: its number from 1, its offset, and its text without the newline."""

    number: int
    begin: int
    text: str


def read_text(path: Path) -> bytes:
    """Return a text file's content as it is.

    Raises DataError when it cannot be read, is empty, or is not text in UTF-8 or a one-byte encoding.
    """
    try:
        content = read_small(path)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file.") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.") from None
    check_text(path, content)
    return content


def check_text(path: Path, content: bytes) -> None:
    """Check that a file's content, or its beginning, is text. Raises DataError as `read_text`."""
    if content.startswith(_OTHER_BOMS):
        raise DataError(f"{path}: not a CSV file in UTF-8, but text in UTF-16 or UTF-32: save it as UTF-8.")
    text = content.removeprefix(_BOM).rstrip(b"\0")
    if not text or text.isspace():  # stripping would copy the whole file
        raise DataError(f"{path}: empty; nothing was recorded.")
    for begin, kind in _WRITTEN_ONLY.items():
        if content.startswith(begin):
            raise DataError(f"{path}: {kind} file, which cfid writes and does not read: give what it was made of.")
    for begin, kind in _OTHER_FILES.items():
        if content.startswith(begin):
            raise DataError(f"{path}: {kind}")
    if _CONTROL.search(text[:_LOOKED_AT]):
        if path.suffix.lower() == ".mat":
            raise DataError(
                f"{path}: no MATLAB file of version 5 to 7.3, but damaged, or of version 4: save it again, with -v7."
            )
        raise DataError(
            f"{path}: not a CSV file: it holds binary data (or text in UTF-16: save that as UTF-8). "
            "`cfid fit dynamics` fits logs of vehicles; `cfid show`, `cfid convert` and `cfid import` read them; "
            "with its `axis`, `cfid import` makes of a swing by gyro a run that `cfid fit swing` takes."
        )


def whole_lines(content: bytes) -> tuple[bytes, bytes]:
    r"""Return the complete lines, and what follows them: a last line without its end, or b"".

    Each line is ended by \n and has plain spaces and minus signs. Zero bytes at the end, which a power failure may
    leave, stand for a last line.
    """
    text = content.removeprefix(_BOM).rstrip(b"\0")
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if not text.isascii():
        text = _NO_BREAK_SPACE.sub(b" ", text).replace(_MINUS, b"-")
    end = text.rfind(b"\n") + 1
    return text[:end], b"\0" if content.endswith(b"\0") else text[end:].strip(b" \t")


def last_row(lines: bytes, rest: bytes, separator: str | None) -> bytes:
    """Return a last line with the end that an editor left out, if it has the form of the line before; else b""."""
    before, last = (fields_of(decoded(line), separator) for line in (lines[lines.rfind(b"\n", 0, -1) + 1 : -1], rest))
    alike = len(last) == len(before) and all(
        is_number(field) or has_comma(field) or not (is_number(number) or has_comma(number))
        for field, number in zip(last, before, strict=True)
    )
    return rest + b"\n" if alike else b""


def filled_lines(text: bytes, *, skip: int = 0) -> Iterator[TextLine]:
    """Yield the lines that are not blank, after the first `skip` lines."""
    begin = 0
    for number in itertools.count(1):
        end = text.find(b"\n", begin)
        if end < 0:
            return
        line = text[begin:end]
        if number > skip and line.strip():
            yield TextLine(number, begin, decoded(line))
        begin = end + 1


def separator_of(line: str) -> str | None:
    """Return the separator of a line's fields; None for spaces.

    A comma between semicolons or tabs is part of a name, or a decimal comma to report; a bar may be in a name, too.
    """
    return next((separator for separator in (";", "\t", ",", "|") if separator in line), None)


def fields_of(line: str, separator: str | None) -> list[str]:
    """Return the fields of a line, without quotes and without spaces around them."""
    if separator is None:
        return _DARK.findall(line.replace('"', ""))
    fields = line.split(separator)
    if '"' in line:
        try:
            fields = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
        except csv.Error:
            fields = [line]
    return [field.strip(string.whitespace) for field in fields]  # only ASCII spaces, as where numbers are parsed


def is_number(field: str) -> bool:
    """Return whether a field is written as a number; nan and inf count."""
    return bool(NUMBER.fullmatch(field) or _NOT_FINITE.fullmatch(field))


def is_finite(field: str) -> bool:
    """Return whether a field is a finite number, with a decimal point or without."""
    return bool(NUMBER.fullmatch(field)) and math.isfinite(float(field))


def has_comma(field: str) -> bool:
    """Return whether a field is a number with a comma inside, decimal or of thousands."""
    return bool(_COMMA_NUMBER.fullmatch(field))


def has_decimal_comma(field: str) -> bool:
    """Return whether a field is a number with a decimal comma, which a comma of thousands is not."""
    return bool(_ONE_DECIMAL_COMMA.fullmatch(field)) and not _THOUSANDS.fullmatch(field.encode())


def decimal_sign(body: bytes, separator: str | None) -> str:
    """Return the decimal sign of the numbers in a table's body, comma or point; thousands separators do not count."""
    if separator == "," or b"," not in body:
        return "."
    decimal = any(not _THOUSANDS.fullmatch(match.group(1)) for match in _DECIMAL_COMMA.finditer(body))
    return "," if decimal and not _DECIMAL_POINT.search(body) else "."


def is_prose(line: str, separator: str | None) -> bool:
    """Return whether a line is only words, as programs write at the end of a file: no field is a number."""
    fields = fields_of(line, separator)
    words = all(field.isprintable() and not is_number(field) and not has_comma(field) for field in fields)
    return words and any(field[:1].isalpha() for field in fields)


def short(text: str, length: int = 40) -> str:
    """Return the start of a text, for a message."""
    return text if len(text) <= length else f"{text[:length]}..."


def decoded(line: bytes) -> str:
    """Return a line's text in UTF-8, or in Latin-1 where it is not that."""
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        return line.decode("latin-1")
