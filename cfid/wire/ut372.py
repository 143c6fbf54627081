"""Reads packets of UNI-T's UT372 tachometer and reports of its USB bridge; no port and no clock.

The tachometer sends what its display shows, unprompted: 27 bytes that end in CR LF. After a first character, whose
meaning is unknown, every two characters make a byte, four bits each as '0' (0x30) to '?' (0x3F): five cells of the
number, five of the time, the lowest digit first, then two bytes of signs. A cell's bits are the lit segments.
Source: the pages UNI-T UT372 and WCH CH9325 of the sigrok project's wiki, and a packet of a real one in its blog.

There is no checksum. A packet counts only if its length and end are right, every character is one of the sixteen,
every cell is a digit or blank, blanks precede digits only, there is at most one decimal point, and either RPM or COUNT
is lit. That finds lost or added bytes, unless they make up a whole packet, and flipped bits, with these exceptions:
0 and 8, 1 and 7, 3 and 9, 5 and 6, 5 and 9, 6 and 8, 8 and 9 differ by one segment, as do a decimal point and none,
and a flip can also set or clear the signs that qualify a reading. The time is checked with the number, so that garbage
has ten cells to get right. USB has a checksum of its own.
"""

import re
from typing import NamedTuple

from cfid.wire.lines import Splitter

BAUD = 2400
USB_VENDOR, USB_PRODUCT = 0x1A86, 0xE008  # of the bridge, a WCH CH9325: UNI-T's cables for multimeters have it too
REPORT_BYTES = 8
SET_BAUD = b"\0" + BAUD.to_bytes(2, "little") + b"\0\0\x03"  # feature report 0: speed, two unknown, 3 for eight bits

_LINE_BYTES = 26  # without the LF
_CHARACTERS = re.compile(rb"[0-?]{24}\r")  # after the first
_CELLS = 5

_POINT = 0x80
_SHOWN = {
    0x00: " ",
    0x7B: "0",
    0x60: "1",
    0x5E: "2",
    0x7C: "3",
    0x65: "4",
    0x3D: "5",
    0x3F: "6",
    0x70: "7",
    0x7F: "8",
    0x7D: "9",
}
_NUMBER = re.compile(r" *\d+\.?\d*")
_TIME = re.compile(r"[ \d.]+")

_HOLD = 0x04  # of the first byte of signs
_RPM, _COUNT = 0x01, 0x02  # of the second byte, as are all below
_STATISTIC = 0x10 | 0x20 | 0x40  # MAX, MIN, AVE


class TachometerReading(NamedTuple):
    """What the display shows: revolutions per minute, or how many revolutions it `counted`.

    It may be `held`, or a `statistic` (the maximum, minimum or mean of what was measured): then it is not the present
    speed.
    """

    number: float
    counted: bool
    held: bool
    statistic: bool


def unpack_report(report: bytes) -> bytes | None:
    """Return the serial bytes in one input report of the bridge, 0 to 7, or None when it is not such a report.

    A report's first byte is 0xF0 plus the number of serial bytes. The bridge sends a report every few milliseconds,
    mostly without any serial bytes.
    """
    if len(report) != REPORT_BYTES or not 0xF0 <= report[0] < 0xF0 + REPORT_BYTES:
        return None
    return report[1 : 1 + (report[0] & 0x0F)]


class Ut372Reader:
    """Reads packets; `rejected` counts lines that are no packet, and packets without a readable number.

    The latter include all packets sent while the tachometer's set-up menu is open.
    """

    def __init__(self) -> None:
        """Start between two packets."""
        self.rejected = 0
        self._lines = Splitter(longest=_LINE_BYTES, ends=b"\n")

    def feed(self, data: bytes) -> list[TachometerReading]:
        """Return the readings that `data` completes."""
        readings = [_read(line) for line in self._lines.feed(data)]
        self.rejected += readings.count(None)
        return [reading for reading in readings if reading is not None]


def _read(line: bytes) -> TachometerReading | None:
    if len(line) != _LINE_BYTES or not _CHARACTERS.fullmatch(line, 1):
        return None
    halves = [character & 0x0F for character in line[1:-1]]
    cells = [high << 4 | low for high, low in zip(halves[::2], halves[1::2], strict=True)]
    number, time = _shown(cells[:_CELLS]), _shown(cells[_CELLS:-2])
    state, unit = cells[-2:]
    if not _NUMBER.fullmatch(number) or not _TIME.fullmatch(time) or unit & (_RPM | _COUNT) not in (_RPM, _COUNT):
        return None
    return TachometerReading(float(number), bool(unit & _COUNT), bool(state & _HOLD), bool(unit & _STATISTIC))


def _shown(cells: list[int]) -> str:
    """Return what cells show from left to right, '?' for segments that form no digit."""
    return "".join(_SHOWN.get(cell & ~_POINT, "?") + "." * bool(cell & _POINT) for cell in reversed(cells))
