"""Cut a ULog file into parts that are logs by themselves, so that a library which reads whole logs holds one part."""

import io
import mmap
import struct
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import IO

PART_BYTES = 1 << 26

_MESSAGE = struct.Struct("<HB")  # how many bytes follow, and the type
_MESSAGES = frozenset(b"BFIMPQARDLCSO")
_SUBSCRIPTION = ord("A")
_BEGIN_DATA = frozenset(b"ALC")  # types of which the first ends the definitions
_BEGIN_BYTES = 16
_FLAGS_AT = _BEGIN_BYTES + 2  # the type of the first message
_APPENDED_AT = _BEGIN_BYTES + _MESSAGE.size + 8  # of these flags, the one that data were appended, as after a crash


def ulog_parts(path: Path) -> Iterator[IO[bytes]]:
    """Yield a log's parts in order: its definitions, the subscriptions before the part, and whole messages.

    A log of one part, or with appended data, comes as it is. From a damaged message on all is one part.
    """
    with path.open("rb") as file:
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    if len(data) <= PART_BYTES or (data[_FLAGS_AT] == ord("B") and data[_APPENDED_AT] & 1):
        yield path.open("rb")
        return
    definitions, subscribed, later = b"", b"", b""
    begin = 0
    for first, end, kind in _messages(data):
        if not definitions and kind in _BEGIN_DATA:
            definitions, begin = data[:first], first
        if definitions and end - begin > PART_BYTES:
            yield io.BytesIO(b"".join([definitions, subscribed, memoryview(data)[begin:first]]))
            subscribed, later, begin = subscribed + later, b"", first
        if kind == _SUBSCRIPTION:
            later += data[first:end]
    yield io.BytesIO(b"".join([definitions, subscribed, memoryview(data)[begin:]]))


def damaged_at(path: Path) -> float | None:
    """Return at which part of a file its messages break off, from 0 to 1, None where they reach its end."""
    with path.open("rb") as file:
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    if data[_FLAGS_AT] == ord("B") and data[_APPENDED_AT] & 1:  # what was appended need not begin at a message's end
        return None
    end = deque((end for _, end, _ in _messages(data)), maxlen=1)
    place = end[0] if end else _BEGIN_BYTES
    return None if place == len(data) else place / len(data)


def _messages(data: mmap.mmap) -> Iterator[tuple[int, int, int]]:
    """Yield where each message begins and ends, and its type, as long as these are whole and known."""
    place = _BEGIN_BYTES
    while place + _MESSAGE.size <= len(data):
        size, kind = _MESSAGE.unpack_from(data, place)
        end = place + _MESSAGE.size + size
        if end > len(data) or kind not in _MESSAGES:
            return
        yield place, end, kind
        place = end
