"""Simulates a vehicle's table of contents, of log variables or of parameters, sent entry by entry."""

import struct
import zlib
from collections.abc import Sequence
from typing import NamedTuple

TOC_CHANNEL = 0

_ITEM, _INFO = 2, 3  # those with 16-bit numbers, since protocol version 4
_NUMBER = struct.Struct("<H")


class Entry(NamedTuple):
    """A name of the form `group.name`, and its type byte."""

    name: str
    code: int


class Toc:
    """Answers about entries, numbered in order; `tail` ends the answer about the whole table."""

    def __init__(self, entries: Sequence[Entry], *, tail: bytes = b"") -> None:
        """Compute the checksum by which a client recognizes a table that it has read before."""
        encoded = [bytes([entry.code]) + entry.name.replace(".", "\0").encode() + b"\0" for entry in entries]
        self._entries = encoded
        self._info = bytes([_INFO]) + struct.pack("<HI", len(encoded), zlib.crc32(b"".join(encoded))) + tail

    def answer(self, request: bytes) -> bytes | None:
        """Return the answer to a payload on channel 0; an answer about an entry that does not exist contains none."""
        if request[:1] == bytes([_INFO]):
            return self._info
        if request[:1] == bytes([_ITEM]):
            number = number_in(request[1:])
            known = number is not None and number < len(self._entries)
            return request[:3] + self._entries[number] if known and number is not None else request[:1]
        return None


def number_in(payload: bytes) -> int | None:
    """Return the number that a payload begins with, None when it is too short for one."""
    return int(_NUMBER.unpack_from(payload)[0]) if len(payload) >= _NUMBER.size else None
