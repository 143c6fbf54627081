"""Simulates an E201-9S encoder interface: commands to replies. No port, no clock, no faults.

The replies to `s` and `e` are not documented for sensors of this kind: those two are made up.
"""

import math
from collections.abc import Callable

from cfid.wire import e201
from cfid.wire.rls import POSITION_BITS, STEPS_PER_TURN, WORD_BITS

AngleAt = Callable[[float], float]
Reply = tuple[float, bytes]

CONTINUOUS_HZ = 1000

_END = b"\r"
_SET_WIDTH = b"B"
_LONGEST_CATCH_UP_S = 0.5


def ssi_word(position: int, *, bits: int) -> int:
    """Return the word of `bits` 1 to 32 that a 13-bit encoder shifts out: the position and a zero, repeated.

    13 bits are the plain position, fewer bits its top, and 22 the word of `cfid.wire.rls`.
    """
    once = position << 1
    width = POSITION_BITS + 1
    return ((once << 2 * width) | (once << width) | once) >> (3 * width - bits)


class E201Device:
    """An interface from power-on; positions come from `angle_at`, which returns the angle in rad at a time in s.

    Each reply has the delay in seconds after which it leaves: `reply_s`, which on real USB lasts until the next
    frame of 1 ms. The stamp of `!` counts microseconds from `first_stamp_us` at `powered_s` and wraps at 32 bits.
    """

    def __init__(
        self,
        angle_at: AngleAt,
        *,
        word_bits: int = WORD_BITS,
        reply_s: float = 0.0,
        powered_s: float = 0.0,
        first_stamp_us: int = 0,
    ) -> None:
        """Start with the encoder supplied and continuous output off."""
        self.word_bits = word_bits
        self.stuck_at_bits: int | None = None  # reads words of this width, whatever is set
        self.stamps = True  # older interfaces may have none
        self._angle_at = angle_at
        self._reply_s = reply_s
        self._powered_s = powered_s
        self._first_stamp_us = first_stamp_us
        self._supplied = True
        self._width_begun: bytes | None = None
        self._next_s: float | None = None

    @property
    def continuous(self) -> bool:
        """Whether `due` returns replies, now or later."""
        return self._next_s is not None

    def received(self, data: bytes, now_s: float) -> list[Reply]:
        """Return the replies to bytes received in pieces of any size; the reply to an unknown command is an error."""
        answers = (self._take(data[i : i + 1], now_s) for i in range(len(data)))
        return [(self._reply_s, answer + _END) for answer in answers if answer is not None]

    def due(self, now_s: float) -> list[Reply]:
        """Return the positions of the continuous output up to now; after a stall, those of the last half second."""
        if self._next_s is None:
            return []
        self._next_s = max(self._next_s, now_s - _LONGEST_CATCH_UP_S)
        count = int((now_s - self._next_s) * CONTINUOUS_HZ) + 1 if now_s >= self._next_s else 0
        times_s = [self._next_s + i / CONTINUOUS_HZ for i in range(count)]
        self._next_s += count / CONTINUOUS_HZ
        return [(self._reply_s, self._position(time_s) + _END) for time_s in times_s]

    def word(self, time_s: float) -> int:
        """Return the word that is read at a time."""
        position = math.floor(self._angle_at(time_s) / math.tau * STEPS_PER_TURN) % STEPS_PER_TURN
        return ssi_word(position, bits=self.stuck_at_bits or self.word_bits)

    def _take(self, character: bytes, now_s: float) -> bytes | None:
        if self._width_begun is not None:
            return self._set_width(character)
        if character == _SET_WIDTH:
            self._width_begun = b""
            return None
        if character in (b"\r", b"\n"):
            return None
        if character in (e201.POSITION, e201.STAMPED_POSITION, e201.HEX_POSITION, e201.HEX_STAMPED_POSITION):
            return self._read(character, now_s)
        return self._execute(character, now_s)

    def _execute(self, command: bytes, now_s: float) -> bytes | None:
        if command in (e201.CONTINUOUS, e201.STOP_CONTINUOUS):
            self._next_s = now_s if command == e201.CONTINUOUS else None
            return None
        if command in (e201.POWER_ON, e201.POWER_OFF):
            self._supplied = command == e201.POWER_ON
            return self._answer(e201.SUPPLY)
        return self._answer(command)

    def _answer(self, question: bytes) -> bytes:
        supply = b"ON:5.02V:38mA" if self._supplied else b"OFF:0.00V:0mA"
        answers = {
            e201.VERSION: f"{e201.PRODUCT} V1.30".encode(),
            e201.SERIAL_NUMBER: b"S00042",
            e201.SUPPLY: supply,
            e201.WORD_WIDTH: b"%02d" % self.word_bits,
        }
        return answers.get(question, b"Error")

    def _read(self, command: bytes, now_s: float) -> bytes:
        stamped = command in (e201.STAMPED_POSITION, e201.HEX_STAMPED_POSITION)
        if not self._supplied or (stamped and not self.stamps):
            return b"Error"
        if not stamped:
            return self._position(now_s, in_hex=command == e201.HEX_POSITION)
        stamp_us = (self._first_stamp_us + int((now_s - self._powered_s) * 1e6)) % (1 << e201.STAMP_BITS)
        form = b"%X:%X" if command == e201.HEX_STAMPED_POSITION else b"%d:%d"
        return form % (self.word(now_s), stamp_us)

    def _position(self, time_s: float, *, in_hex: bool = False) -> bytes:
        return (b"%X" if in_hex else b"%d") % self.word(time_s)

    def _set_width(self, character: bytes) -> bytes | None:
        """Collect the two digits and the CR that follow a B."""
        assert self._width_begun is not None
        if character != _END:
            self._width_begun += character
            return None
        digits, self._width_begun = self._width_begun, None
        if not (digits.isdigit() and 1 <= int(digits) <= 32):
            return b"Error"
        self.word_bits = int(digits)
        return self._answer(e201.WORD_WIDTH)
