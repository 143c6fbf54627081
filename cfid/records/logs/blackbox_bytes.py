"""Read the bytes of a blackbox file's logs from the disk: orangebox's own reader holds a whole file in memory."""

import mmap
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_FRAME = re.compile(rb"[IPSGHE]")  # the bytes that a frame begins with


class LogBytes:
    """One log of a blackbox file, to be read by orangebox's Parser: its headers and fields, and its frames' bytes."""

    log_index = 1

    def __init__(self, orangebox: Any, data: mmap.mmap, begin: int, end: int) -> None:
        """Read the headers of the log between two places in a file; the frames follow them."""
        self._data, self._end = data, end
        self._place = begin
        while self._place < end and data[self._place] == ord("H"):
            self._place = data.find(b"\n", self._place, end) + 1 or end
        with tempfile.TemporaryDirectory(prefix="cfid-") as folder:
            file = Path(folder) / "headers"
            file.write_bytes(data[begin : self._place])
            reader = orangebox.reader.Reader(str(file), 1)
        self.headers, self.field_defs = reader.headers, reader.field_defs
        self._first = self._place

    def set_log_index(self, index: int) -> None:
        """Accept any index, since there is only one log."""

    def value(self) -> int:
        """Return the next byte without advancing."""
        return self._data[self._place]

    def has_subsequent(self, expected: bytes) -> bool:
        """Return whether these bytes follow."""
        return self._data[self._place : self._place + len(expected)] == expected

    def tell(self) -> int:
        """Return the place of the next byte."""
        return self._place

    def seek(self, place: int) -> None:
        """Go to a byte, or to the frames' first where Parser names the file's first, as before it has found a frame."""
        self._place = max(place, self._first)

    def __iter__(self) -> Iterator[int | None]:
        """Yield the bytes at which Parser looks for a frame; after a byte that begins none, the next that does."""
        while True:
            byte = next(self)
            yield byte
            if byte is not None and not _FRAME.match(bytes([byte])):
                found = _FRAME.search(self._data, self._place, self._end)
                self._place = found.start() if found else self._end

    def __next__(self) -> int | None:
        """Return the next byte, None at the end."""
        if self._place >= self._end:
            return None  # as orangebox's reader does, whose Parser ends at an event
        self._place += 1
        return self._data[self._place - 1]


def logs_in(path: Path) -> Iterator[tuple[mmap.mmap, int, int]]:
    """Yield a file with the begin and end of each of its logs; every log begins with the file's first line."""
    with path.open("rb") as file:
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    first_line = data[: data.find(b"\n") + 1 or len(data)]
    begin = 0
    while begin >= 0:
        after = data.find(first_line, begin + len(first_line))
        yield data, begin, after if after >= 0 else len(data)
        begin = after
