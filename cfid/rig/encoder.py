"""Records an encoder behind an E201 interface: finds and questions it, polls it on a grid, and finds it again."""

import math
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from twisted.internet.base import DelayedCall

from cfid.errors import DeviceError
from cfid.records.rig_file import EncoderLines, EncoderPort
from cfid.records.run import DeviceRecord
from cfid.rig.clock import unwrapped
from cfid.rig.hardware import Hardware, SerialPort
from cfid.rig.instrument import Block, PortInstrument, Say
from cfid.rig.lock import DeviceLock, holder_of
from cfid.rig.progress import degrees
from cfid.rig.text_lines import TextLines, ready_lines
from cfid.wire import e201
from cfid.wire.rls import RLS_13BIT_IN_22, WORD_BITS, decode_words

SLOWEST_REPLY_S = 0.05  # to a poll; one or two milliseconds are usual
BAUD = 115200  # meaningless on USB

_LOOK_S = 0.005


class FoundPort(NamedTuple):
    """An encoder interface: its port, version, serial number, word width, positions, and whether those have stamps."""

    port: str
    version: str
    serial_number: str
    word_bits: int
    positions: tuple[int, ...]
    stamped: bool


def ports_to_ask(hardware: Hardware, port: str) -> list[str]:
    """Return the port itself or, where none is named, those whose device names itself an E201."""
    return [port] if port else [path for path, product in hardware.serial_ports() if e201.PRODUCT in product]


async def find_encoder(
    hardware: Hardware, port: str, *, counts_per_turn: float | str, serial_number: str = "", configure: bool = True
) -> FoundPort:
    """Find the encoder on a port, or on any port when `port` is empty; set the word's width that the counts imply.

    A `serial_number` restricts the search to that encoder; without `configure` nothing is set. Raises DeviceError
    with the answers of all candidates, after five seconds at most.
    """
    ports = ports_to_ask(hardware, port)
    if not ports:
        raise DeviceError(
            "no encoder interface is plugged in: no serial port has the name E201. Plug it in, or set "
            "devices.encoder.port in rig.toml."
        )
    bits = word_bits(counts_per_turn) if configure else None
    end_s, reasons = hardware.seconds() + 4.0, []
    for candidate in ports:
        try:
            found = await _identity(hardware, candidate, bits, end_s=end_s)
        except DeviceError as error:
            reasons.append(str(error))
            continue
        if serial_number in ("", found.serial_number):
            return found
        reasons.append(f"{candidate}: this is the encoder {found.serial_number}, not {serial_number}.")
    raise DeviceError(" ".join(reasons))


def word_bits(counts_per_turn: float | str) -> int | None:
    """Return the word width in bits that a number of counts per turn implies, or None when it implies none."""
    if counts_per_turn == RLS_13BIT_IN_22:
        return WORD_BITS
    counts = int(float(counts_per_turn))
    bits = counts.bit_length() - 1
    fits = counts == float(counts_per_turn) and counts.bit_count() == 1 and 1 <= bits <= e201.WIDEST_WORD
    return bits if fits else None


async def _identity(hardware: Hardware, port: str, expected_bits: int | None, *, end_s: float) -> FoundPort:
    if holder := holder_of(port):
        raise DeviceError(f"{port} is held by {holder}. End that first.")
    interview = _Interview(hardware, port, end_s=end_s)
    try:
        version = await interview.version()
        bits = await interview.width(expected_bits) or e201.WIDEST_WORD
        command, reading = await interview.position(bits)
        timed = [await interview.timed(command) for _ in range(3)]
        reply_s = min(seconds for seconds, _ in timed)
        if reply_s > SLOWEST_REPLY_S:
            raise DeviceError(
                f"{port}: replies after {1e3 * reply_s:.0f} ms (limit {1e3 * SLOWEST_REPLY_S:.0f} ms), too late to "
                "time a position: plug it directly into this computer."
            )
        return FoundPort(
            port=port,
            version=_text(version),
            serial_number=_text(await interview.ask(e201.SERIAL_NUMBER)),
            word_bits=bits,
            positions=(reading.position, *(again.position for _, reply in timed for again in _readings(reply, bits))),
            stamped=reading.stamp_us is not None,
        )
    finally:
        interview.close()


class _Interview:
    """Questions to the device on a port, one at a time, each with a time limit.

    Raises DeviceError for a device that is not an E201, or cannot be questioned.
    """

    def __init__(self, hardware: Hardware, port: str, *, end_s: float) -> None:
        self._hardware, self._port, self._end_s = hardware, port, end_s
        self._received = b""
        self._line: SerialPort = hardware.serial(port, self, baud=BAUD)

    def received(self, data: bytes) -> None:
        self._received += data

    def disconnected(self) -> None:
        """Note nothing: no answer will come."""

    def close(self) -> None:
        self._line.close()

    async def version(self) -> bytes:
        """Return the device's version text; first switch off a continuous output that another program left on."""
        self._line.write(e201.STOP_CONTINUOUS)
        version = await self.ask(e201.VERSION)
        if not e201.names_e201(version):
            answer = f"answers '{_text(version)}'" if version else "gives no answer"
            raise DeviceError(f"{self._port}: {answer} where an E201 encoder interface sends its name: another device.")
        return version

    async def width(self, expected: int | None) -> int | None:
        """Return the word's width in bits, first set to `expected` if given; None when the device does not state it."""
        found = e201.word_width(await self.ask(e201.WORD_WIDTH))
        if expected in (None, found):
            return found
        await self._send(e201.set_word_width(expected))
        found = e201.word_width(await self.ask(e201.WORD_WIDTH))
        if found != expected:
            raise DeviceError(
                f"{self._port}: the word width was set to {expected} bits, but reads {found or 'nothing'}: check "
                "encoder.counts_per_turn in rig.toml."
            )
        return found

    async def position(self, bits: int) -> tuple[bytes, e201.EncoderReading]:
        """Return a position, and the command that it answers: with stamps where the device sends them."""
        for command in (e201.STAMPED_POSITION, e201.POSITION):
            if readings := _readings(await self.ask(command), bits):
                return command, readings[0]
        raise DeviceError(
            f"{self._port}: an E201, but it reports no position: is the encoder plugged into it, and powered?"
        )

    async def timed(self, command: bytes) -> tuple[float, bytes]:
        """Return how long the reply to one poll takes, and the reply."""
        await self._send(command)
        begin_s = self._hardware.seconds()
        reply = await self._reply()
        return self._hardware.seconds() - begin_s, reply

    async def ask(self, question: bytes) -> bytes:
        """Return the reply to a question, without its end; anything received before is dropped."""
        await self._send(question)
        return await self._reply()

    async def _send(self, command: bytes) -> None:
        """Send a command once the device is silent."""
        if self._hardware.seconds() > self._end_s:
            raise DeviceError(
                f"{self._port}: not checked, the other ports took too long: set devices.encoder.port in rig.toml."
            )
        end_s = self._hardware.seconds() + 0.3
        while True:
            self._received = b""
            await self._hardware.sleep(0.02)
            if not self._received:
                break
            if self._hardware.seconds() > end_s:
                raise DeviceError(f"{self._port}: sends unprompted, even after the command to stop: not an E201.")
        self._line.write(command)

    async def _reply(self) -> bytes:
        end_s = self._hardware.seconds() + 0.5
        while b"\r" not in self._received and self._hardware.seconds() < end_s:
            await self._hardware.sleep(_LOOK_S)
        return self._received.partition(b"\r")[0].strip()


def _readings(reply: bytes, bits: int) -> list[e201.EncoderReading]:
    return list(e201.PositionReader(word_bits=bits).feed(reply + b"\r"))


def _text(reply: bytes) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in reply.decode("ascii", "replace"))[:60]


def ready_encoder(
    setting: EncoderPort | EncoderLines, hardware: Hardware, held: ExitStack, *, counts_per_turn: float | str, say: Say
) -> "Encoder | TextLines":
    """Find and lock the encoder, of whichever kind. Raises ConfigError or DeviceError."""
    if isinstance(setting, EncoderLines):
        return ready_lines("encoder", setting, hardware, held, say=say, counts_per_turn=counts_per_turn)
    found = hardware.run(lambda _: find_encoder(hardware, setting.port, counts_per_turn=counts_per_turn))
    lock = held.enter_context(DeviceLock(found.port))
    return Encoder(found, setting, lock, counts_per_turn=counts_per_turn, say=say)


class Encoder(PortInstrument):
    """An E201 that is polled at a rate: one poll after the other, since an answer does not identify its poll.

    Answers come in the order of the questions. So after a poll without an answer, or with a doubtful one, the device's
    name is requested, and what comes before it is dropped. It is requested once, since a second name could be either
    request's. A grid point that is more than ten milliseconds, and a whole period, in the past is skipped; a poll that
    is less late is made up for.
    """

    name = "encoder"

    def __init__(
        self, found: FoundPort, setting: EncoderPort, lock: DeviceLock, *, counts_per_turn: float | str, say: Say
    ) -> None:
        """Take the interface that was found and locked, and how to sample it."""
        super().__init__(found.port, say=say, patient=True)
        self._found, self._port_setting, self._lock = found, setting.port, lock
        self._counts_per_turn, self._period_s = counts_per_turn, 1 / setting.rate_hz
        self._is_checked = counts_per_turn == RLS_13BIT_IN_22
        self.record = DeviceRecord.model_validate(
            {
                "file": "encoder.csv",
                "columns": ("t", "phi", "device_us") if found.stamped else ("t", "phi"),
                "counts_per_turn": counts_per_turn,
                "asked": "polled",
                "rate_hz": setting.rate_hz,
                "interface": found._asdict(),
            }
        )
        self.reading = degrees(counts_per_turn)
        self._command = e201.STAMPED_POSITION if found.stamped else e201.POSITION

    @property
    def _shown(self) -> str:
        return f"the encoder {self._found.serial_number}"

    def start(self, hardware: Hardware) -> None:
        """Open the port and begin to poll."""
        self._reader = e201.PositionReader(word_bits=self._found.word_bits, stamped=self._found.stamped)
        self._timer: DelayedCall | None = None  # the next poll, or the end of the wait for an answer
        self._polled_s: float | None = None  # when the poll was sent that waits for its answer
        self._place = 0  # of that poll, or the last one, on the grid
        self._polls = self._answered = self._skipped = self._passed = self._late = self._unsolicited = 0
        self._times_s: list[float] = []
        self._readings: list[e201.EncoderReading] = []
        self._last_us: int | None = None
        self._taken = self._failed_check = self._counted = 0
        self._is_resyncing = False
        self._begin(hardware, period_s=self._period_s)
        self._begun_s = hardware.seconds()
        self._poll()

    def _open(self) -> SerialPort:
        return self._hardware.serial(self._where, self, baud=BAUD)

    def received(self, data: bytes) -> None:
        """Take the bytes that the port received."""
        rejected, names = self._reader.rejected, self._reader.names
        readings = self._reader.feed(data)
        is_clean = self._reader.rejected == rejected
        if self._is_resyncing:
            self._late += len(readings)
            if self._reader.names > names:
                self._wait(0.005, self._poll_next)  # the name may have a second line
        elif self._polled_s is not None and len(readings) == 1 and is_clean and self._is_prompt(self._polled_s):
            self._keep(readings[0])
        elif readings or not is_clean:
            self._unsolicited += len(readings)
            self._resync()

    def disconnected(self) -> None:
        """Note that the plug was pulled, and look for the interface until it is back."""
        super().disconnected()
        self._cancel()
        self._polled_s = None

    def take(self) -> Block:
        """Return the new rows. Raises DeviceError when a plugged-in encoder is silent."""
        if not self._readings:
            self._check_silence()
            return self.block((), self._newly_lost())
        times_s, readings = np.array(self._times_s), self._readings
        self._times_s, self._readings = [], []
        phi = np.array([reading.position for reading in readings], dtype=np.int64)
        columns: list[npt.NDArray[Any]] = [self._hardware.unix_times_s(times_s), phi]
        if self._found.stamped:
            stamps_us = unwrapped(np.array([reading.stamp_us or 0 for reading in readings], np.int64), self._last_us)
            self._last_us = int(stamps_us[-1])
            columns.append(stamps_us)
        valid = decode_words(phi).valid if self._is_checked else np.ones(len(phi), dtype=np.bool_)
        self._taken += len(phi)
        self._failed_check += int(np.sum(~valid))
        return Block([column[valid] for column in columns], self._newly_lost(), self._wrong_format())

    async def stop(self) -> None:
        """End the polling, and take the answer that is on its way. Raises DeviceError when the encoder is gone."""
        await super().stop()
        end_s = self._hardware.seconds() + SLOWEST_REPLY_S
        while self._polled_s is not None and self._port is not None and self._hardware.seconds() < end_s:
            await self._hardware.sleep(_LOOK_S)
        self._cancel()
        self._end_silence()
        if self._is_resyncing or self._gone_s is not None:
            self._advance(answered=False)
        self._refuse_gone()

    def facts(self) -> Mapping[str, Any]:
        """Return the numbers of polls and of skipped ones, losses by kind, and gaps."""
        losses = {
            "polls_without_position": self._polls - self._answered,
            "missing_in_gaps": self._passed,
            "garbled_replies": self._reader.rejected,
            "device_errors": self._reader.errors,
            "failed_check": self._failed_check,
            "late_replies": self._late,
            "unasked": self._unsolicited,
        }
        taken = {"polls": self._polls, "skipped": self._skipped, "rate_hz": 1 / self._period_s}
        return {**taken, "losses": losses, "gaps": self._silence.gaps}

    def _poll(self) -> None:
        assert self._port is not None
        self._polls += 1
        self._polled_s = self._hardware.seconds()
        self._port.write(self._command)
        self._wait(SLOWEST_REPLY_S, self._resync)

    def _is_prompt(self, polled_s: float) -> bool:
        return self._hardware.seconds() - polled_s < SLOWEST_REPLY_S

    def _resync(self) -> None:
        """Give up the poll that waits, and request the device's name until it comes: no older answer can follow it."""
        self._polled_s, self._is_resyncing = None, True
        if self._port is not None and not self._stopped:
            self._port.write(e201.VERSION)
            self._wait(0.6, self._resync)  # a name that has not come by then is lost

    def _keep(self, reading: e201.EncoderReading) -> None:
        """Keep an answer, and poll at the next grid point."""
        self._polled_s = None
        self._answered += 1
        self._times_s.append(self._hardware.seconds())
        self._readings.append(reading)
        self._silence.end("no position came")
        self._poll_next(answered=True)

    def _poll_next(self, *, answered: bool = False) -> None:
        """Poll at the next grid point, at once if its time has come."""
        self._is_resyncing = False
        self._advance(answered=answered)
        wait_s = self._begun_s + self._place * self._period_s - self._hardware.seconds()
        if wait_s > 0:
            self._wait(wait_s, self._poll)
        elif not self._stopped:
            self._poll()

    def _advance(self, *, answered: bool) -> None:
        """Go to the next grid point that is not too old; those between are skipped, after a poll in vain lost."""
        # A busy computer, or the system's queue before a port, delays a poll by ten milliseconds at most.
        late_s = self._hardware.seconds() - self._begun_s - max(self._period_s, 0.01)
        place = max(self._place + 1, math.ceil(late_s / self._period_s))
        missed = place - self._place - 1
        self._skipped += missed if answered else 0
        self._passed += 0 if answered else missed
        self._place = place

    def _wait(self, seconds: float, act: Callable[[], None]) -> None:
        """Act after a time, in place of what was to come, unless the polling has ended."""
        self._cancel()
        if not self._stopped and self._port is not None:
            self._timer = self._hardware.later(seconds, act)

    def _cancel(self) -> None:
        if self._timer is not None and self._timer.active():
            self._timer.cancel()

    def _check_silence(self) -> None:
        if self._gone_s is None and not self._stopped and self._silence.exceeds(3.0):
            late = f" (its answers take longer than {1e3 * SLOWEST_REPLY_S:.0f} ms)" if self._late else ""
            raise DeviceError(
                f"{self._found.port}: the encoder's interface sent no position for {self._silence.seconds:.0f} s, "
                f"though polled{late}: unplug it and plug it in again; `cfid rig check` looks for the cause."
            )

    def _newly_lost(self) -> int:
        waiting = self._polled_s is not None and not self._stopped
        lost = self._polls - self._answered - waiting + self._passed + self._failed_check
        newly, self._counted = lost - self._counted, lost
        return newly

    def _wrong_format(self) -> str:
        if self._taken < 50 or self._failed_check < self._taken / 2:
            return ""
        return (
            f"{self._found.port}: {self._failed_check} of {self._taken} words fail the check of a 13-bit position in "
            "22 bits: another encoder or word width. Set encoder.counts_per_turn in rig.toml to its counts per turn."
        )

    async def _reopen(self) -> SerialPort:
        self._found = await find_encoder(
            self._hardware,
            self._port_setting,
            counts_per_turn=self._counts_per_turn,
            serial_number=self._found.serial_number,
        )
        self._where = self._found.port
        self._lock.move(self._where)
        return self._open()

    def _go_on(self) -> None:
        self._reader.forget()
        self._poll_next()
