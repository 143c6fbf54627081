"""Cut a ULog file into parts that are complete logs, so that a library that reads whole logs holds one part only.

Parts have only whole messages: damaged bytes are left out, up to where whole messages follow one another again.
"""

import io
import mmap
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.records.logs.ulog_formats import FieldCount

PART_BYTES = 1 << 26

_MESSAGE = struct.Struct("<HB")  # how many bytes follow, and the type
_MESSAGES = np.isin(np.arange(256), list(b"BFIMPQARDLCSO"))
_FORMAT, _SUBSCRIPTION = b"FA"
_BEGIN_DATA = frozenset(b"ALC")  # the first message of one of these types ends the definitions
_DATA = frozenset(b"DORS")  # types that cannot precede those; among definitions, pyulog may never stop reading them
_BEGIN_BYTES = 16
_FLAGS_AT = _BEGIN_BYTES + 2  # the type of the first message
_APPENDED_AT = _BEGIN_BYTES + _MESSAGE.size + 8  # in these flags: data were appended, as after a crash
_APPENDED = struct.Struct("<3Q")  # after the flags: where appended data begin, 0 for none
_LONGEST_DEFINITIONS = 1 << 24
_IN_A_ROW = 8  # whole messages that have to follow damaged bytes
_FIRST_LOOK, _LOOK = 1 << 12, 1 << 20  # bytes that are searched together
_MOST_DAMAGES = 1000


class UlogParts:
    """A log's parts in order: its definitions, the subscriptions before the part, and whole messages.

    Once the parts are read, `damages` has the begin and end of each segment of damaged bytes.
    """

    def __init__(self, path: Path) -> None:
        """Map a file into memory."""
        self._path = path
        with path.open("rb") as file:
            self._data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self.damages: list[tuple[int, int]] = []

    def __len__(self) -> int:
        """Return the length of the file in bytes."""
        return len(self._data)

    def __iter__(self) -> Iterator[IO[bytes]]:
        """Yield each part. Raises DataError for definitions of a size that no log has."""
        definitions, subscribed, later = b"", b"", b""
        fields = FieldCount(self._path)
        pieces: list[memoryview] = []
        size, whole = 0, memoryview(self._data)
        begin = place = _BEGIN_BYTES
        for first, end, kind in self._messages():
            if not definitions and kind in _DATA:
                self.damages.append((first, end))
                continue
            if first != place:  # after damage, or what was appended
                pieces.append(whole[begin:place])
                begin = first
            if kind == _FORMAT:
                fields.define(bytes(whole[first + _MESSAGE.size : end]))
            if not definitions and kind in _BEGIN_DATA:
                definitions = self._definitions([*pieces, whole[begin:first]])
                pieces, size, begin = [], 0, first
            if definitions and size > PART_BYTES:
                yield io.BytesIO(b"".join([definitions, subscribed, *pieces, whole[begin:first]]))
                subscribed, later, pieces, size, begin = subscribed + later, b"", [], 0, first
            if kind == _SUBSCRIPTION:
                later += whole[first:end]
                fields.subscribe(bytes(whole[first + _MESSAGE.size : end]))
            place, size = end, size + end - first
        pieces.append(whole[begin:place])
        yield io.BytesIO(b"".join([definitions or self._definitions([]), subscribed, *pieces]))

    def _definitions(self, pieces: list[memoryview]) -> bytes:
        """Return the file's header and definitions, without the flag of appended data, which parts have in place."""
        joined = bytearray(b"".join([self._data[:_BEGIN_BYTES], *pieces]))
        if len(joined) > _LONGEST_DEFINITIONS:
            raise DataError(f"{self._path}: not readable as a ULog file: its definitions have no end.")
        if len(joined) > _APPENDED_AT and joined[_FLAGS_AT] == ord("B"):
            joined[_APPENDED_AT] &= ~1 & 0xFF
        return bytes(joined)

    def _messages(self) -> Iterator[tuple[int, int, int]]:
        """Yield where each whole message begins and ends, and its type."""
        begin = _BEGIN_BYTES
        for end in (*self._appended(), len(self._data)):
            place = begin
            while place < end:
                message = self._message(place, end)
                if message is not None:
                    yield message
                    place = message[1]
                    continue
                after = self._whole_from(place + 1, end) if len(self.damages) < _MOST_DAMAGES else end
                self.damages.append((place, after))
                place = after
            begin = end

    def _message(self, place: int, end: int) -> tuple[int, int, int] | None:
        if place + _MESSAGE.size > end:
            return None
        size, kind = _MESSAGE.unpack_from(self._data, place)
        after = place + _MESSAGE.size + size
        return (place, after, kind) if after <= end and _MESSAGES[kind] else None

    def _appended(self) -> list[int]:
        """Return where appended data begin: the message before such a place may be cut."""
        data, offsets = self._data, _APPENDED_AT + 8
        if len(data) < offsets + _APPENDED.size or data[_FLAGS_AT] != ord("B") or not data[_APPENDED_AT] & 1:
            return []
        return sorted({at for at in _APPENDED.unpack_from(data, offsets) if _BEGIN_BYTES < at < len(data)})

    def _whole_from(self, place: int, end: int) -> int:
        """Return the place from which several whole messages follow one another, or all up to `end`; `end` for none."""
        view = np.frombuffer(self._data, np.uint8)
        look = _FIRST_LOOK
        while place < end:
            looked_at = view[place + 2 : min(place + look, end) + 2]
            reached = first = place + np.flatnonzero(_MESSAGES[looked_at])
            for _ in range(_IN_A_ROW):
                first, reached = _followed(view, first, reached, end)
            if len(first):
                return int(first[0])
            place, look = place + look, min(2 * look, _LOOK)
        return end


def _followed(
    view: npt.NDArray[np.uint8], first: npt.NDArray[np.int64], reached: npt.NDArray[np.int64], end: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Advance by one message from each reached place; keep places where a message is whole, and those at the end."""
    there = reached == end
    inside = np.minimum(reached, max(end - _MESSAGE.size, 0))
    after = reached + _MESSAGE.size + view[inside] + 256 * view[inside + 1].astype(np.int64)
    whole = (reached + _MESSAGE.size <= end) & _MESSAGES[view[inside + 2]] & (after <= end)
    return first[there | whole], np.where(there, end, after)[there | whole]
