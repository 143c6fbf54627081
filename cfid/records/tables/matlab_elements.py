"""Check the elements of a MATLAB file of version 5 to 7.2 before SciPy reads it.

SciPy's reader trusts their tags: the number of an unknown type ends the process, and no error can be caught.
"""

import struct
import zlib
from pathlib import Path
from typing import IO, Protocol

from cfid.errors import DataError

_HEAD_BYTES, _ORDER_AT = 128, 126
_MATRIX, _COMPRESSED = 14, 15
_TYPES = frozenset((1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18))  # int8 to uint64, single, double, UTF-8 to UTF-32
_DEEPEST = 64  # structs in structs
_BLOCK_BYTES = 1 << 16
_USUAL_BYTES = 1 << 27
_MOST_TIMES = 30  # the file's size: recordings of noise are 1 to 3 times as large as packed, constants 1000 times


def check_size(path: Path, content_bytes: int) -> None:
    """Raise DataError where a file states far more content than its size allows."""
    if content_bytes > max(_USUAL_BYTES, _MOST_TIMES * path.stat().st_size):
        raise DataError(
            f"{path}: {path.stat().st_size} bytes that state to be {content_bytes / 1e6:.0f} MB or more: no recording "
            "is packed so small."
        )


class _Source(Protocol):
    def take(self, count: int) -> bytes:
        """Return the next bytes, fewer at the end."""

    def skip(self, count: int) -> bool:
        """Skip bytes, and return whether there were so many."""


def check_elements(path: Path) -> None:
    """Check the types and sizes of all elements. Raises DataError where one is unknown, cut, or too large."""
    content_bytes = 0
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
        order = ">" if head[_ORDER_AT:] == b"MI" else "<"
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            begin = file.tell()
            if kind == _COMPRESSED:
                inflated = _Inflated(file, size)
                kind, inner = struct.unpack(f"{order}II", _whole(inflated.take(8), 8, path))
                content_bytes += inner
                check_size(path, content_bytes)
                _check_element(inflated, kind, inner, order=order, path=path)
            else:
                _check_element(_Plain(file), kind, size, order=order, path=path)
            file.seek(begin + size)


def _check_element(source: _Source, kind: int, size: int, *, order: str, path: Path, depth: int = 0) -> None:
    """Check an element's content of `size` bytes."""
    if kind != _MATRIX:
        if kind not in _TYPES:
            raise DataError(f"{path}: not readable as a MATLAB file: an element has the unknown type {kind}.")
        if not source.skip(size):
            raise _cut(path)
        return
    if depth > _DEEPEST:
        raise DataError(f"{path}: its structs are nested more than {_DEEPEST} deep.")
    while size > 0:
        (word,) = struct.unpack(f"{order}I", _whole(source.take(4), 4, path))
        if word >> 16:  # a small element: its size, its type, and its data in four bytes
            kind, inner, tag = word & 0xFFFF, 4, 4
        else:
            (inner,) = struct.unpack(f"{order}I", _whole(source.take(4), 4, path))
            kind, tag = word, 8
        if tag + inner > size:
            raise _cut(path)
        _check_element(source, kind, inner, order=order, path=path, depth=depth + 1)
        size -= tag + inner
        gap = 0 if tag == 4 else min(-inner % 8, size)  # to the next multiple of 8
        if not source.skip(gap):
            raise _cut(path)
        size -= gap


def _cut(path: Path) -> DataError:
    return DataError(f"{path}: not readable as a MATLAB file: an element is longer than what is left of it.")


def _whole(content: bytes, count: int, path: Path) -> bytes:
    if len(content) < count:
        raise _cut(path)
    return content


class _Plain:
    """The content of a file from its current position on."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        place = file.tell()
        self._end = file.seek(0, 2)
        file.seek(place)

    def take(self, count: int) -> bytes:
        return self._file.read(count)

    def skip(self, count: int) -> bool:
        return self._file.seek(count, 1) <= self._end


class _Inflated:
    """The inflated content of a part of a file, block by block."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self._file, self._left = file, size
        self._inflate, self._ready = zlib.decompressobj(), b""

    def take(self, count: int) -> bytes:
        while len(self._ready) < count and self._more():
            pass
        taken, self._ready = self._ready[:count], self._ready[count:]
        return taken

    def skip(self, count: int) -> bool:
        while count > 0:
            if not self._ready and not self._more():
                return False
            left_out = min(count, len(self._ready))
            self._ready, count = self._ready[left_out:], count - left_out
        return True

    def _more(self) -> bool:
        """Inflate another block of at most a fixed size; return whether there was any."""
        packed = self._inflate.unconsumed_tail
        if not packed:
            packed = self._file.read(min(_BLOCK_BYTES, self._left))
            self._left -= len(packed)
        inflated = self._inflate.decompress(packed, _BLOCK_BYTES)
        self._ready += inflated
        return bool(inflated or packed)
