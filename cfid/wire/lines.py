"""Reads lines of text in which a microcontroller or an instrument sends numbers unprompted; sends no command.

A line ends in CR, LF or both. Without a pattern its values are separated by commas, semicolons, tabs or spaces, and may
be in quotation marks; a pattern (a regular expression over the whole line) has a group for each value. A comma is a
decimal comma within a group, and in lines that have semicolons or tabs. Where a comma could be either, between digits
of a line in which spaces separate numbers, the line does not match. A line that ends in `*` and two hexadecimal
digits, as in NMEA 0183, counts only if these are the exclusive or of the bytes before the `*`; after one such line,
every line needs this checksum.

A line that lost its beginning would read as another number. So everything up to the first end of line is dropped.
Without a checksum, a lost or flipped byte that leaves a valid number cannot be detected, nor can a lost end of line
that leaves the right number of values.
"""

import math
import re
from collections.abc import Sequence
from functools import reduce
from operator import xor
from typing import NamedTuple

LONGEST_LINE = 200  # bytes; a longer one is dropped

_COMMAS = re.compile(r"\s*,\s*|\s+", re.ASCII)
_SEMICOLONS = re.compile(r"\s*;\s*|\s+", re.ASCII)  # with these separators, a comma is a decimal comma
_QUOTED = re.compile(r'^"([^"]*)"$')
_EITHER = re.compile(r"(?=.*\d,\d).*\d\s+[+-]?\d", re.ASCII)
_NUMBER = re.compile(r"[+-]? *(?:\d{1,20}(?:[.,]\d{0,20})?|[.,]\d{1,20})(?:[eE][+-]?\d{1,3})?", re.ASCII)
_WHOLE = re.compile(r"[+-]?\d{1,15}", re.ASCII)
_CHECKED = re.compile(rb"(.*)\*([0-9A-Fa-f]{2})", re.DOTALL)


class Value(NamedTuple):
    """A value of a line; a `whole` one has no decimals, and one that is not `used` may be any text."""

    whole: bool = False
    used: bool = True


class Splitter:
    """Splits what a device sends, in pieces of any size, into lines; of one that is too long it keeps a byte more."""

    def __init__(self, *, longest: int, ends: bytes = b"\r\n") -> None:
        """Take the bytes of the longest line, and those of which each ends a line."""
        self._longest = longest
        self._ends = re.compile(b"[%b]" % ends)
        self._begun = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that `data` completes, without their ends; some are empty where lines end in CR and LF."""
        *lines, begun = self._ends.split(self._begun + data)
        self._begun = begun[: self._longest + 1]
        return [line[: self._longest + 1] for line in lines]

    def forget(self) -> bytes:
        """Drop an incomplete line, whose end will not come, and return it."""
        begun, self._begun = self._begun, b""
        return begun


class LineReader:
    """Reads the values of lines; `rejected` counts lines that do not match, `last_rejected` is the latest of them."""

    def __init__(self, values: Sequence[Value], *, pattern: str = "") -> None:
        """Take the kind of each value of a line, in order; a `pattern` has as many groups."""
        self.rejected = 0
        self.last_rejected = b""
        self._values = tuple(values)
        self._pattern = re.compile(pattern, re.ASCII) if pattern else None
        self._lines = Splitter(longest=LONGEST_LINE)
        self._aligned = self._checked = False

    def forget(self) -> None:
        """Expect the next bytes to begin anywhere in a line: the device was unplugged."""
        self._lines.forget()
        self._aligned = False

    def feed(self, data: bytes) -> list[tuple[float, ...]]:
        """Return the numbers in each line that `data` completes, without values that are not used."""
        lines = self._lines.feed(data)
        if not self._aligned:
            self._aligned = bool(lines)
            lines = lines[1:]
        readings = []
        for line in filter(None, lines):
            reading = self._read(line)
            if reading is None:
                self.rejected += 1
                self.last_rejected = line[:LONGEST_LINE]
            else:
                readings.append(reading)
        return readings

    def _read(self, line: bytes) -> tuple[float, ...] | None:
        text = self._verified(line) if len(line) <= LONGEST_LINE else None
        words = None if text is None else self._words(text.strip())
        if words is None or len(words) != len(self._values):
            return None
        pairs = [(word or "", value) for word, value in zip(words, self._values, strict=True) if value.used]
        if not all((_WHOLE if value.whole else _NUMBER).fullmatch(word) for word, value in pairs):
            return None
        numbers = tuple(float(word.replace(" ", "").replace(",", ".")) for word, _ in pairs)
        return numbers if all(map(math.isfinite, numbers)) else None

    def _verified(self, line: bytes) -> bytes | None:
        """Return a line without its checksum, or None where the checksum is wrong, or missing although required."""
        found = _CHECKED.fullmatch(line.strip())
        if found is None:
            return None if self._checked else line
        if checksum(found[1]) != int(found[2], 16):
            return None
        self._checked = True
        return found[1]

    def _words(self, text: bytes) -> Sequence[str | None] | None:
        """Return the values in a line, whose degree sign, for example, comes as UTF-8 or as a single byte."""
        try:
            line = text.decode("utf-8")
        except UnicodeDecodeError:
            line = text.decode("latin-1")
        if self._pattern is None:
            decimal_commas = ";" in line or "\t" in line
            if not decimal_commas and _EITHER.match(line):
                return None
            return [_QUOTED.sub(r"\1", word) for word in (_SEMICOLONS if decimal_commas else _COMMAS).split(line)]
        match = self._pattern.fullmatch(line)
        return None if match is None else match.groups()


def checksum(line: bytes) -> int:
    """Return the exclusive or of a line's bytes."""
    return reduce(xor, line, 0)


def printable(line: bytes) -> str:
    """Return a line as text for a message: 60 characters at most, a question mark for what cannot be printed."""
    return "".join(chr(byte) if 32 <= byte < 127 else "?" for byte in line[:60])
