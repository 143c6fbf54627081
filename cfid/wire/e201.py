"""Reads the serial protocol of RLS' E201-9S encoder interface: commands of one character, replies that end in CR.

Replies arrive in pieces of any size. A reply counts only if all of it is valid; the rest is counted as rejected.
USB has checksums of its own, so that bytes are lost or joined rather than changed; the word's own check, where it
has one (see `rls`), catches a changed digit.
"""

import re
from typing import NamedTuple

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
USB_VENDOR = 0x0483  # of the chip's maker: a Crazyflie on USB has it too

WIDEST_WORD = 32  # bits
STAMP_BITS = 32  # microseconds, so that a stamp wraps after 71.6 minutes (inferred; no manual states it)

_END = b"\r"
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


class ReplyReader:
    """Splits what a device sends into replies; `rejected` counts those that are too long."""

    def __init__(self) -> None:
        """Start between two replies."""
        self.rejected = 0
        self._begun = b""
        self._skipping = False

    def feed(self, data: bytes) -> list[bytes]:
        """Return the replies that `data` completes, without their ends and without line feeds before them."""
        *complete, self._begun = (self._begun + data).split(_END)
        replies = []
        for reply in complete:
            if self._skipping or len(reply) > _LONGEST:
                self.rejected += 1
                self._skipping = False
            else:
                replies.append(reply.removeprefix(b"\n"))
        if len(self._begun) > _LONGEST:  # it will be rejected: nothing else need be remembered
            self._begun, self._skipping = b"", True
        return replies

    def forget(self) -> None:
        """Drop an incomplete reply whose end will not come, and count it as rejected."""
        self.rejected += bool(self._begun.removeprefix(b"\n")) or self._skipping
        self._begun, self._skipping = b"", False


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
        self.errors = self.names = 0
        self._unread = 0
        self._replies = ReplyReader()
        self._limit = 1 << word_bits
        self._stamped = stamped
        self._decided = stamped is not None

    @property
    def rejected(self) -> int:
        """The number of replies without a position."""
        return self._unread + self._replies.rejected

    def feed(self, data: bytes) -> list[EncoderReading]:
        """Return the positions that `data` completes."""
        found = (self._read(reply) for reply in self._replies.feed(data))
        return [reading for reading in found if reading is not None]

    def forget(self) -> None:
        """Drop an incomplete reply whose end will not come, and count it as rejected."""
        self._replies.forget()

    def _read(self, reply: bytes) -> EncoderReading | None:
        match = _POSITION.fullmatch(reply)
        if match is None and names_e201(reply):
            self.names += 1
            return None
        if match is None:
            self.errors += b"error" in reply.lower()
            self._unread += 1
            return None
        position, stamp_us = int(match[1]), None if match[2] is None else int(match[2])
        stamped = stamp_us is not None
        alike = stamped == self._stamped
        if position >= self._limit or (stamp_us or 0) >> STAMP_BITS or (self._decided and not alike):
            self._unread += 1
            return None
        self._stamped, self._decided = stamped, alike
        return EncoderReading(position, stamp_us)
