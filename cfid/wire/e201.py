"""Reads the serial protocol of RLS' E201-9S encoder interface: commands of one character, replies that end in CR.

Replies arrive in pieces of any size. A reply counts only if all of it is valid; the rest is counted as rejected.
USB has checksums of its own, so that bytes are lost or joined rather than changed; the word's own check, where it
has one (see `rls`), catches a changed digit.
"""

import re
from typing import NamedTuple

from cfid.wire.lines import Splitter

VERSION = b"v"
SERIAL_NUMBER = b"s"
SUPPLY = b"e"
POWER_ON = b"n"
POWER_OFF = b"f"
POSITION = b"?"
STAMPED_POSITION = b"!"
HEX_POSITION = b">"
HEX_STAMPED_POSITION = b"<"
WORD_WIDTH = b"b"
CONTINUOUS = b"1"
STOP_CONTINUOUS = b"0"

PRODUCT = "E201 USB Encoder Interface"

WIDEST_WORD = 32  # bits
STAMP_BITS = 32  # microseconds, so that a stamp wraps after 71.6 minutes (inferred; no manual states it)

_LONGEST = 64  # bytes of a reply; the longest known reply, the version, has less than half of that
_POSITION = re.compile(rb"(\d{1,10})(?:[: ](\d{1,10}))?")
_WIDTH = re.compile(rb"\D*(\d{1,2})\D*")


class EncoderReading(NamedTuple):
    """One position as the device sent it, with its stamp in microseconds if it has one."""

    position: int
    stamp_us: int | None


def set_word_width(bits: int) -> bytes:
    """Return the command that sets the SSI word's width, 1 to 32 bits."""
    if not 1 <= bits <= WIDEST_WORD:
        raise ValueError(f"an SSI word has 1 to {WIDEST_WORD} bits, not {bits}")
    return b"B%02d\r" % bits


def word_width(reply: bytes) -> int | None:
    """Return the width in bits that a reply to `b` states, or None when it states none."""
    match = _WIDTH.fullmatch(reply)
    return int(match[1]) if match else None


def names_e201(reply: bytes) -> bool:
    """Return whether a reply to `v` is an E201's."""
    return b"E201" in reply


class PositionReader:
    """Reads positions, and counts everything else.

    `rejected` counts replies without a position, `errors` those among them in which the device reports Error, and
    `names` the answers to `v`.

    Where it is unknown whether replies carry a stamp, the first two in a row of the same kind decide, and replies of
    the other kind are then rejected. A single reply cannot decide: a stamped reply that lost its beginning looks like
    one without a stamp.
    """

    def __init__(self, *, word_bits: int, stamped: bool | None = None) -> None:
        """Take the width of the word, which no position exceeds, and whether replies carry a stamp."""
        self.rejected = self.errors = self.names = 0
        self._replies = Splitter(longest=_LONGEST, ends=b"\r")
        self._limit = 1 << word_bits
        self._stamped = stamped
        self._decided = stamped is not None

    def feed(self, data: bytes) -> list[EncoderReading]:
        """Return the positions that `data` completes."""
        readings = map(self._read, self._replies.feed(data))
        return [reading for reading in readings if reading is not None]

    def forget(self) -> None:
        """Drop an incomplete reply whose end will not come, and count it as rejected."""
        self.rejected += self._replies.forget() not in (b"", b"\n")

    def _read(self, reply: bytes) -> EncoderReading | None:
        if names_e201(reply):
            self.names += 1
            return None
        match = _POSITION.fullmatch(reply.removeprefix(b"\n"))
        reading = self._accepted(match) if match else None
        self.rejected += reading is None
        self.errors += b"error" in reply.lower()
        return reading

    def _accepted(self, match: re.Match[bytes]) -> EncoderReading | None:
        position, stamp_us = int(match[1]), None if match[2] is None else int(match[2])
        stamped = stamp_us is not None
        alike = stamped == self._stamped
        if position >= self._limit or (stamp_us or 0) >> STAMP_BITS or (self._decided and not alike):
            return None
        self._stamped, self._decided = stamped, alike
        return EncoderReading(position, stamp_us)
