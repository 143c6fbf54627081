"""Finds the encoder's serial port, and reads its identity and a position, one question at a time."""

import contextlib
import os
import termios
import time
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import serial
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from cfid.errors import DeviceError
from cfid.rig.lock import holder_of
from cfid.wire import e201
from cfid.wire.rls import RLS_13BIT_IN_22, WORD_BITS

SLOWEST_REPLY_S = 0.05  # to a poll; one or two milliseconds are usual

PORT_ERRORS = (
    OSError,
    termios.error,
)  # pyserial's own error is an OSError; the error of a plug pulled while the port opens is not

_ANSWER_S = 0.5
_DRAIN_S = 0.02
_LONGEST_DRAIN_S = 0.3
_LONGEST_S = 4.0  # for all questions to all ports: a recording that ends has to wait for them
_TRIES = 3
_BAUD = 115200  # meaningless on USB


class FoundPort(NamedTuple):
    """An encoder interface: its port, version, serial number, word width, positions, and whether those have stamps."""

    port: str
    version: str
    serial_number: str
    word_bits: int
    positions: tuple[int, ...]
    stamped: bool


def find_encoder(
    port: str, *, counts_per_turn: float | str, serial_number: str = "", configure: bool = True
) -> FoundPort:
    """Find the encoder on a port, or on any port when `port` is empty; set the word's width that the counts imply.

    A `serial_number` restricts the search to that encoder; without `configure` nothing is set. Raises DeviceError
    with the answers of all candidates, after five seconds at most.
    """
    if not (ports := ports_to_ask(port)):
        raise DeviceError(
            "no encoder interface is plugged in: no serial port has the name E201 or its maker's USB number. "
            "Plug it in, or set its port: devices.encoder.port in rig.toml, or `port`."
        )
    return encoder_among(ports, counts_per_turn=counts_per_turn, serial_number=serial_number, configure=configure)


def encoder_among(
    ports: Sequence[str], *, counts_per_turn: float | str, serial_number: str = "", configure: bool = True
) -> FoundPort:
    """Find the encoder on one of some ports, as `find_encoder` does."""
    end_s = time.monotonic() + _LONGEST_S
    reasons = []
    for candidate in ports:
        try:
            found = _ask(candidate, counts_per_turn=counts_per_turn, configure=configure, end_s=end_s)
        except DeviceError as error:
            reasons.append(str(error))
            continue
        if serial_number in ("", found.serial_number):
            return found
        reasons.append(f"{candidate}: this is the encoder {found.serial_number}, not {serial_number}.")
    raise DeviceError(" ".join(reasons))


def ports_to_ask(port: str) -> list[str]:
    """Return the port itself, or those that may be an E201's when none is named."""
    return [port] if port else list(_candidates(list_ports.comports()))


def _candidates(ports: Iterable[ListPortInfo]) -> Iterator[str]:
    """Yield ports that may be an E201's: first by name, then by the maker of the chip."""
    ports = list(ports)
    named = [info for info in ports if e201.PRODUCT in (info.product or info.description or "")]
    yield from (info.device for info in named)
    yield from (info.device for info in ports if info.vid == e201.USB_VENDOR and info not in named)


def lock_name(port: str) -> str:
    """Return the name under which a port is locked, with symbolic links resolved."""
    return os.path.realpath(port)


def word_bits(counts_per_turn: float | str) -> int | None:
    """Return the word width in bits that a number of counts per turn implies, or None when it implies none."""
    if counts_per_turn == RLS_13BIT_IN_22:
        return WORD_BITS
    counts = int(float(counts_per_turn))
    bits = counts.bit_length() - 1
    fits = counts == float(counts_per_turn) and counts.bit_count() == 1 and 1 <= bits <= e201.WIDEST_WORD
    return bits if fits else None


def _ask(port: str, *, counts_per_turn: float | str, configure: bool, end_s: float) -> FoundPort:
    if holder := holder_of(lock_name(port)):
        raise DeviceError(f"{port} is held by {holder}. End that first.")
    with _opened(port) as line:
        interview = _Interview(port, line, end_s=end_s)
        version = interview.introduced()
        width = interview.width(word_bits(counts_per_turn) if configure else None)
        bits = width or e201.WIDEST_WORD
        command, reading = interview.position(bits)
        timed = [interview.timed(command) for _ in range(_TRIES)]
        reply_s = min(seconds for seconds, _ in timed)
        if reply_s > SLOWEST_REPLY_S:
            raise DeviceError(
                f"{port}: replies after {1e3 * reply_s:.0f} ms (limit {1e3 * SLOWEST_REPLY_S:.0f} ms), too late to "
                "time a position: plug it directly into this computer."
            )
        return FoundPort(
            port=port,
            version=_text(version),
            serial_number=_text(interview.ask(e201.SERIAL_NUMBER)),
            word_bits=bits,
            positions=(reading.position, *(one.position for _, reply in timed for one in _readings(reply, bits))),
            stamped=reading.stamp_us is not None,
        )


def _readings(reply: bytes, bits: int) -> list[e201.EncoderReading]:
    return list(e201.PositionReader(word_bits=bits).feed(reply + b"\r"))


@contextlib.contextmanager
def _opened(port: str) -> Iterator[serial.Serial]:
    try:
        with serial.Serial(port, _BAUD, timeout=_DRAIN_S, write_timeout=_ANSWER_S, exclusive=True) as line:
            yield line
    except PORT_ERRORS as error:
        raise DeviceError(f"{port}: {why_not_open(error)}") from None


class _Interview:
    """Questions to the device on a port, one at a time, each with a time limit.

    Raises DeviceError for a device that is not an E201, or cannot be questioned.
    """

    def __init__(self, port: str, line: serial.Serial, *, end_s: float) -> None:
        self._port, self._line, self._end_s = port, line, end_s

    def introduced(self) -> bytes:
        """Return the device's version text; first switch off a continuous output that a killed recording left on."""
        self._line.write(e201.STOP_CONTINUOUS)
        version = self.ask(e201.VERSION)
        if not e201.names_e201(version):
            answer = f"answers '{_text(version)}'" if version else "gives no answer"
            raise DeviceError(f"{self._port}: {answer} where an E201 encoder interface sends its name: another device.")
        return version

    def width(self, expected: int | None) -> int | None:
        """Return the word's width in bits, first set to `expected` if given; None when the device does not state it."""
        found = e201.word_width(self.ask(e201.WORD_WIDTH))
        if expected in (None, found):
            return found
        self._send(e201.set_word_width(expected))
        found = e201.word_width(self.ask(e201.WORD_WIDTH))
        if found != expected:
            raise DeviceError(
                f"{self._port}: the word width was set to {expected} bits, but reads {found or 'nothing'}: check "
                "encoder.counts_per_turn in rig.toml."
            )
        return found

    def position(self, bits: int) -> tuple[bytes, e201.EncoderReading]:
        """Return a position, and the command that it answers: with stamps where the device sends them."""
        for command in (e201.STAMPED_POSITION, e201.POSITION):
            if readings := _readings(self.ask(command), bits):
                return command, readings[0]
        raise DeviceError(
            f"{self._port}: an E201, but it reports no position: is the encoder plugged into it, and powered?"
        )

    def timed(self, command: bytes) -> tuple[float, bytes]:
        """Return how long the reply to one poll takes, and the reply."""
        self._drain()
        begin_s = time.monotonic()
        self._line.write(command)
        reply = self._reply()
        return time.monotonic() - begin_s, reply

    def ask(self, question: bytes) -> bytes:
        """Return the reply to a question, without its end; anything received before is dropped."""
        self._send(question)
        return self._reply()

    def _send(self, command: bytes) -> None:
        if time.monotonic() > self._end_s:
            raise DeviceError(
                f"{self._port}: not checked, the other ports took too long: set devices.encoder.port in rig.toml."
            )
        self._drain()
        self._line.write(command)

    def _drain(self) -> None:
        end_s = time.monotonic() + _LONGEST_DRAIN_S
        while self._line.read(4096):
            if time.monotonic() > end_s:
                raise DeviceError(f"{self._port}: sends unprompted, even after the command to stop: not an E201.")

    def _reply(self) -> bytes:
        reply = b""
        end_s = time.monotonic() + _ANSWER_S
        while b"\r" not in reply and time.monotonic() < end_s:
            reply += self._line.read_until(b"\r", 256)
        return reply.partition(b"\r")[0].strip()


def _text(reply: bytes) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in reply.decode("ascii", "replace"))[:60]


def why_not_open(error: Exception) -> str:
    """Return why a port cannot be opened, and what to do."""
    number = getattr(error, "errno", None)
    text = str(error)
    if number == 13 or "Permission" in text:
        return "this user may not open it: join the group that owns it (dialout on most systems), and log in again."
    if number == 2 or "No such file" in text:
        there = ", ".join(info.device for info in list_ports.comports())
        return f"no such port. Available: {there or 'none'}."
    if number in (11, 16) or "exclusively lock" in text or "busy" in text:
        return "another program has it open: close that first."
    if number in (21, 25) or "Inappropriate ioctl" in text:
        return "this is not a serial port."
    return f"{text}."
