"""Records devices that send text unprompted: lines with values, as rig.toml states them, scales, and a tachometer."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import ConfigError, DeviceError
from cfid.records.rig_file import EncoderLines, LineDevice
from cfid.records.run import DeviceRecord
from cfid.rig.hardware import Hardware, Receiver, SerialPort
from cfid.rig.instrument import Block, Instrument, Say, Silence
from cfid.rig.lock import PortLock
from cfid.rig.progress import Reading
from cfid.rig.shown import degrees, displayed, first_force
from cfid.wire import ut372
from cfid.wire.lines import printable
from cfid.wire.scales import ScalesReader

_ABSENT_S = 5.0  # without a line: a board that restarts when its port is opened takes two seconds
_BROKEN_S = 0.4  # without a line while motors run, after which they are stopped
_SEARCH_S = 0.5
_TICKS = 4  # fewest ticks of a device's clock in a period that show how many periods a step is
_AHEAD_S = 2.0  # by which a clock may have advanced more than this computer's: a line that came late lies before
_DOUBTS = 20  # lines in a row that do not continue the clock: the number is none
_SLACK_S = 0.1  # by which a computer may delay the first line
_UNLIKE = 0.01  # fraction of this computer's time by which a device's clock may deviate
_TELLING_S = 2.0  # shortest recording that shows a clock's rate
_WRAP = 1 << 32  # of a device's clock
_SILENT_S = 10.0  # without a reading of an instrument that is held in a hand
_SHOWN_BYTES = 30  # of unreadable data: a packet of the tachometer, or a line of scales


def ready_lines(
    name: str,
    setting: LineDevice,
    hardware: Hardware,
    held: ExitStack,
    *,
    say: Say,
    patient: bool = True,
    counts_per_turn: float | str = 1.0,
) -> "TextLines":
    """Lock a device's port. Without `patient` the run ends as soon as its lines break off. Raises DeviceError."""
    if not hardware.has_port(setting.port):
        raise DeviceError(f"{setting.port}: no such port. Plug the {name} in, or set devices.{name}.port in rig.toml.")
    lock = held.enter_context(PortLock(setting.port))
    return TextLines(name, setting, lock, say=say, patient=patient, counts_per_turn=counts_per_turn)


class _Row(NamedTuple):
    """A line's arrival by this computer's clock, and its numbers."""

    received_s: float
    numbers: tuple[float, ...]


class TextLines(Instrument):
    """A device that sends lines at a stated rate; a port that is gone is opened again when it is back.

    Lines are timed as they arrive. What is lost follows from the device's own clock where it sends one, else from the
    stated rate. Without `patient` a pulled plug or a silence ends the run at once, as it must while motors run.
    """

    def __init__(
        self,
        name: str,
        setting: LineDevice,
        lock: PortLock,
        *,
        say: Say,
        patient: bool = True,
        counts_per_turn: float | str = 1.0,
    ) -> None:
        """Take the device as rig.toml states it. Raises ConfigError for an angle whose counts per turn are unknown."""
        scale, self.reading = _shown_as(name, setting, counts_per_turn)
        self.name, self.eventful = name, name in ("tachometer", "scales")
        self.record = _record(name, setting, scale)
        self._counts_per_turn = counts_per_turn
        self._setting, self._lock, self._say, self._patient = setting, lock, say, patient
        self._reader = setting.reader()
        self._names = [value.name for value in setting.in_order()]
        stamp = setting.stamp
        self._stamp_place = None if stamp is None else setting.in_order().index(stamp)
        self._tick_s = 0.0 if stamp is None else 1e-6 * setting.factor(stamp)
        self._port: SerialPort | None = None
        self._rows: list[_Row] = []
        self._first: _Row | None = None
        self._last: _Row | None = None  # the latest that counts
        self._doubted: _Row | None = None  # the line before, where its clock did not continue
        self._false = self._doubts = self._restarts = 0
        self._kept = self._counted = 0  # kept: rows after the first
        self._sent = 0.0  # lines after the first, by the device's clock, or by times of arrival and the stated rate
        self._clock_s = 0.0  # since the first row, by the device's clock or by times of arrival
        self._ticks = 0  # of the device's clock, unwrapped
        self._gone_s: float | None = None
        self._stopped = False

    def again(self) -> "TextLines":
        """Return the same device for another recording."""
        return TextLines(
            self.name,
            self._setting,
            self._lock,
            say=self._say,
            patient=self._patient,
            counts_per_turn=self._counts_per_turn,
        )

    @property
    def begun(self) -> bool:
        """Whether a matching line has come."""
        return self._last is not None

    def start(self, hardware: Hardware) -> None:
        """Open the port. Raises DeviceError naming why it cannot be opened."""
        self._hardware = hardware
        self._silence = Silence(hardware, period_s=1 / self._setting.rate_hz)
        self._port = hardware.serial(self._setting.port, self, baud=self._setting.baud)

    def received(self, data: bytes) -> None:
        """Take the bytes that the port received."""
        readings, now_s = self._reader.feed(data), self._hardware.seconds()
        if not readings:
            return
        was_gap = self._silence.end("no line came" if self.begun else "")
        if was_gap and self.begun and self._stamp_place is None:
            readings = readings[-1:]  # nothing shows when those were sent that waited in the system
        for numbers in readings:
            self._take(_Row(now_s, numbers))

    def disconnected(self) -> None:
        """Note that the plug was pulled, and look for the port until it is back."""
        self._port = None
        if self._stopped or self._gone_s is not None:
            return
        self._gone_s = self._hardware.seconds()
        if self._patient:
            self._say(f"{self._setting.port}: unplugged; waiting for the {self.name} to come back")
            self._hardware.later(_SEARCH_S, self._search)

    def take(self) -> Block:
        """Return the new rows. Raises DeviceError for a silent device, and for an unplugged one while motors run."""
        self._check()
        if not self._rows:
            return self.no_rows(self._newly_lost())
        rows, self._rows = self._rows, []
        numbers = dict(zip(self._names, zip(*(row.numbers for row in rows), strict=True), strict=True))
        setting = self._setting
        measured = [setting.factor(value) * np.array(numbers[value.name]) for value in setting.measured]
        columns: list[npt.NDArray[Any]] = [
            self._hardware.clock.unix_s(np.array([row.received_s for row in rows])),
            *measured,
        ]
        if (stamp := setting.stamp) is not None:
            columns.append(self._unwrapped(numbers[stamp.name]) * round(setting.factor(stamp)))
        return Block(columns, self._newly_lost())

    async def stop(self) -> None:
        """Expect no further line. Raises DeviceError when the device was gone."""
        self._stopped = True
        silent_s = self._silence.seconds
        if self.begun and self._silence.end("silent at the end" if self._gone_s is None else "unplugged"):
            self._sent += silent_s * self._setting.rate_hz
        for sentence in self._findings():
            self._say(sentence)
        if self._gone_s is not None and self._patient:
            raise DeviceError(
                f"{self._setting.port}: unplugged {self._hardware.seconds() - self._gone_s:.0f} s before the end, and "
                "not plugged in again."
            )

    def close(self) -> None:
        """Close the port."""
        self._stopped = True
        if self._port is not None:
            port, self._port = self._port, None
            port.close()

    def facts(self) -> Mapping[str, Any]:
        """Return losses by kind, and gaps."""
        left_out = self._reader.rejected + self._false
        losses = {
            "missing_lines": max(round(self._sent) - self._kept - left_out, 0),
            "lines_that_do_not_match": self._reader.rejected,
            "lines_with_a_false_clock": self._false,
        }
        return {"losses": losses, "gaps": self._silence.gaps}

    def _take(self, row: _Row) -> None:
        """Keep a line whose clock continues, or two that continue each other: there the clock began, or began anew.

        Two lines that ran into one have a number of too many digits: the clock jumps for one line.
        """
        step_s = self._step_s(self._last, row)
        if step_s is None and self._stamp_place is not None:
            doubted, self._doubted = self._doubted, row
            self._doubts += 1
            step_s = self._step_s(doubted, row)
            if doubted is None or step_s is None:
                self._false += 1
                return
            self._false -= 1
            self._restarts += self._last is not None
            self._keep(doubted, 0.0 if self._last is None else doubted.received_s - self._last.received_s)
        self._doubts, self._doubted = 0, None
        self._keep(row, step_s or 0.0)

    def _keep(self, row: _Row, step_s: float) -> None:
        """Keep a line that was sent `step_s` after the last one."""
        self._rows.append(row)
        self._last = row
        if self._first is None:
            self._first = row
            return
        periods = step_s * self._setting.rate_hz
        resolved = self._stamp_place is not None and _TICKS * self._tick_s * self._setting.rate_hz <= 1
        self._sent += round(periods) if resolved else periods
        self._clock_s += step_s
        self._kept += 1

    def _step_s(self, before: _Row | None, row: _Row) -> float | None:
        """Return how long after another a line was sent, None where its clock does not continue from there."""
        if before is None:
            return None
        elapsed_s = row.received_s - before.received_s
        if self._stamp_place is None:
            return elapsed_s
        ticks = round(row.numbers[self._stamp_place]) - round(before.numbers[self._stamp_place])
        step_s = self._tick_s * ((ticks + _WRAP // 2) % _WRAP - _WRAP // 2)
        return step_s if 0 <= step_s < (1 + _UNLIKE) * elapsed_s + _AHEAD_S else None

    def _unwrapped(self, stamps: tuple[float, ...]) -> npt.NDArray[np.int64]:
        """Continue a 32-bit clock (n,)."""
        ticks = np.array([round(stamp) for stamp in stamps], dtype=np.int64)
        steps = (np.diff(ticks, prepend=self._ticks % _WRAP) + _WRAP // 2) % _WRAP - _WRAP // 2
        if not self._ticks:
            steps[0] = ticks[0]
        continued = self._ticks + np.cumsum(steps)
        self._ticks = int(continued[-1])
        return np.asarray(continued)

    def _newly_lost(self) -> int | None:
        """Return the lines lost since the last block; None where more came than the stated rate allows."""
        missing = round(self._sent) - self._kept
        slack = _SLACK_S if self._stopped else 5 * _SLACK_S
        if -missing > _UNLIKE * self._kept + slack * self._setting.rate_hz:
            return None
        lost = max(missing, self._reader.rejected + self._false, self._counted if not self._stopped else 0)
        newly, self._counted = lost - self._counted, lost
        return newly

    def _findings(self) -> Iterator[str]:
        """Yield sentences at the end, on a rate or a clock that is not as stated, and on lines left out."""
        name, stated_hz = self.name, self._setting.rate_hz
        if self._sent and -(round(self._sent) - self._kept) > _UNLIKE * self._kept + _SLACK_S * stated_hz:
            yield (
                f"the {name} sent {stated_hz * self._kept / self._sent:.4g} lines a second, more than the "
                f"{stated_hz:g} that rig.toml states, so its losses are unknown: set devices.{name}.rate_hz to the "
                "rate that the device's program sets."
            )
        if self._false:
            yield (
                f"{counted(self._false, 'line')} of the {name} left out, lost: device_us jumps there and back, as "
                "where two lines run into one. Let the device end lines with a checksum, shorten the cable."
            )
        if self._restarts:
            yield (
                f"the {name}'s clock, device_us, started anew: was the device restarted? See to its supply. A swing is "
                "timed by its clock before and after."
            )
        elif self._stamp_place is not None and self._first is not None and self._last is not None:
            elapsed_s = self._last.received_s - self._first.received_s
            if elapsed_s >= _TELLING_S and abs(self._clock_s - elapsed_s) > _UNLIKE * elapsed_s + _SLACK_S:
                yield (
                    f"the {name}'s clock, device_us, went {self._clock_s:.4g} s in {elapsed_s:.4g} s: it counts "
                    f"another unit, or stands. Correct it, or leave it out of devices.{name}.values: times are then "
                    "those of arrival."
                )

    def _search(self) -> None:
        if self._stopped or self._gone_s is None:
            return
        try:
            self._lock.move(self._setting.port)  # a link may lead to another port now
            self._port = self._hardware.serial(self._setting.port, self, baud=self._setting.baud)
        except DeviceError:
            self._hardware.later(_SEARCH_S, self._search)
            return
        self._say(
            f"{self._setting.port}: the {self.name} is back after {self._hardware.seconds() - self._gone_s:.1f} s"
        )
        self._silence.end("unplugged" if self.begun else "")
        self._reader.forget()
        self._gone_s = None

    def _check(self) -> None:
        if self._stopped:
            return
        where = self._setting.port
        if self._doubts > _DOUBTS:
            raise DeviceError(
                f"{where}: the {self.name}'s clock jumps in every line: is it a clock, in the stated unit, without "
                f"commas? Correct it, or leave it out of devices.{self.name}.values."
            )
        if self._gone_s is not None:
            if not self._patient:
                raise DeviceError(f"{where}: the {self.name} was unplugged while motors run.")
            return
        if not self._silence.exceeds(_ABSENT_S if self._patient or not self.begun else _BROKEN_S):
            return
        unread = ""
        if self._reader.rejected:
            advice = "" if self.begun else f": {self._setting.unmatched(self.name)}"
            unread = (
                f" {counted(self._reader.rejected, 'line does', 'lines do')} not match what rig.toml states, "
                f"the last one '{printable(self._reader.last_rejected)}'{advice}."
            )
        raise DeviceError(
            f"{where}: the {self.name} sent no line for {self._silence.seconds:.1f} s.{unread} `cfid rig check` looks "
            "for the cause."
        )


def _shown_as(
    name: str, setting: LineDevice, counts_per_turn: float | str
) -> tuple[Mapping[str, object], Reading | None]:
    """Return what run.toml states about a device's units, and what the live line shows of it."""
    if name == "loadcell":
        return {"units": "n,nm"}, first_force(setting.measured[0].name)
    if not isinstance(setting, EncoderLines):
        return {}, displayed(setting.column_unit(setting.measured[0]))
    if not setting.counted:
        return {"angle_unit": "rad"}, degrees(setting.turn(counts_per_turn))
    if isinstance(counts_per_turn, str):
        raise ConfigError(
            f"encoder.counts_per_turn: is '{counts_per_turn}', a format of the E201's words: set the counts of a turn "
            f"that {setting.port} sends."
        )
    return {"counts_per_turn": counts_per_turn}, degrees(setting.turn(counts_per_turn))


def _record(name: str, setting: LineDevice, scale: Mapping[str, object] = MappingProxyType({})) -> DeviceRecord:
    """Return a device's description in run.toml."""
    stated: dict[str, Any] = setting.model_dump(mode="json", exclude={"rate_hz", "kind"}, exclude_defaults=True)
    return DeviceRecord.model_validate(
        {
            "file": f"{name}.csv",
            "columns": setting.columns,
            **scale,
            "asked": "lines",
            "rate_hz": setting.rate_hz,
            "lines": stated,
        }
    )


class RowParser(Protocol):
    """Turns the bytes that an instrument sends unprompted, several times a second, into rows."""

    name: str
    columns: tuple[str, ...]  # of its rows, the time first
    unit: str
    stated: Mapping[str, object]  # what run.toml states of its port

    def open(self, hardware: Hardware, port: str, receiver: Receiver) -> SerialPort:
        """Open the instrument's port. Raises DeviceError."""

    def read(self, data: bytes) -> Iterable[tuple[float, ...]]:
        """Take bytes, and return the values of rows without their time."""

    def explain(self) -> str:
        """Return the likely cause when bytes arrive but no row does."""

    def facts(self) -> Mapping[str, Any]:
        """Return what goes into run.toml at the end."""


class Ut372:
    """Parses a UT372's packets. Rows are present speeds in revolutions per minute, not counts, holds or statistics.

    A row's time is when its last byte arrived, a tenth of a second after the first.
    """

    name = "tachometer"
    columns: tuple[str, ...] = ("t", "rpm")
    unit = "rpm"
    stated: Mapping[str, object] = MappingProxyType({})

    def __init__(self) -> None:
        """Start without data."""
        self._reader = ut372.Ut372Reader()
        self._set_aside = 0
        self._shows_else = self._is_hid = False

    def open(self, hardware: Hardware, port: str, receiver: Receiver) -> SerialPort:
        """Open its USB bridge, or a serial port that it is wired to."""
        self._is_hid = Path(port).resolve().name.startswith("hidraw")
        if self._is_hid:
            usb_id = ut372.USB_VENDOR, ut372.USB_PRODUCT
            return hardware.hid(port, receiver, usb_id=usb_id, feature=ut372.SET_BAUD)
        return hardware.serial(port, receiver, baud=ut372.BAUD)

    def read(self, data: bytes) -> Iterable[tuple[float, ...]]:
        """Return speeds, and count other readings without keeping them."""
        serial = ut372.unpack_report(data) if self._is_hid else data
        for reading in self._reader.feed(data if serial is None else serial):  # another device's report is unreadable
            self._shows_else = reading.counted or reading.held or reading.statistic
            self._set_aside += self._shows_else
            if not self._shows_else:
                yield (reading.number,)

    def explain(self) -> str:
        """Return which keys to press."""
        if self._shows_else:
            return "COUNT, HOLD, MAX, MIN or AVE is lit. Press its keys until only RPM is."
        return f"its set-up menu is open, the port does not run at {ut372.BAUD} baud, or it is another device."

    def facts(self) -> Mapping[str, Any]:
        """Return how many packets were invalid, and how many showed something other than the present speed."""
        return {"rejected": self._reader.rejected, "set_aside": self._set_aside}


def find_ut372(hardware: Hardware) -> str:
    """Return the hidraw device of the one UT372 that is plugged in. Raises DeviceError naming what was found."""
    found = hardware.hid_nodes(ut372.USB_VENDOR, ut372.USB_PRODUCT)
    if not found:
        raise DeviceError(
            f"no UT372 is plugged in: there is no USB device {ut372.USB_VENDOR:04x}:{ut372.USB_PRODUCT:04x} (the "
            "search works on Linux only). Plug it in, switch it on, or set its port, or type what it shows."
        )
    if len(found) > 1:
        raise DeviceError(
            f"{len(found)} devices may be the UT372: {', '.join(found)}; multimeters have the same cable. "
            "Set the tachometer's port, or unplug the others."
        )
    return found[0]


class Scales:
    """Parses the lines of scales; `stable` is 1 or 0, and -1 where a line does not state it."""

    name = "scales"
    columns: tuple[str, ...] = ("t", "grams", "stable")
    unit = "g"

    def __init__(self, baud: int) -> None:
        """Take the speed of their port."""
        self._reader = ScalesReader()
        self._baud = baud
        self.stated: Mapping[str, object] = {"baud": baud}

    def open(self, hardware: Hardware, port: str, receiver: Receiver) -> SerialPort:
        """Open their port."""
        return hardware.serial(port, receiver, baud=self._baud)

    def read(self, data: bytes) -> Iterable[tuple[float, ...]]:
        """Return weights."""
        for grams, stable in self._reader.feed(data):
            yield grams, -1 if stable is None else int(stable)

    def explain(self) -> str:
        """Return which settings may differ."""
        return "overload, another speed, frame (8N1) or unit (g, kg, mg, lb, oz) than expected, or another device."

    def facts(self) -> Mapping[str, Any]:
        """Return how many lines were invalid."""
        return {"rejected": self._reader.rejected}


class HandHeld(Instrument):
    """An instrument that sends readings unprompted on a port of its own, at no stated rate."""

    eventful = True

    def __init__(self, port: str, parser: RowParser) -> None:
        """Take a port and what reads its bytes; nothing is opened yet."""
        self.name = parser.name
        self.record = DeviceRecord.model_validate(
            {"file": f"{parser.name}.csv", "columns": parser.columns, "port": port, **parser.stated}
        )
        self.reading = displayed(parser.unit)
        self._where, self._parser = port, parser
        self._rows: list[tuple[float, ...]] = []
        self._port: SerialPort | None = None
        self._unread = b""
        self._unread_bytes = 0
        self._gone = self._stopped = False

    def start(self, hardware: Hardware) -> None:
        """Open the port. Raises DeviceError naming why it cannot be opened."""
        self._hardware = hardware
        self._silence = Silence(hardware, period_s=_SILENT_S)
        self._port = self._parser.open(hardware, self._where, self)

    def received(self, data: bytes) -> None:
        """Take the bytes that the port received."""
        self._unread, self._unread_bytes = (self._unread + data)[-_SHOWN_BYTES:], self._unread_bytes + len(data)
        for values in self._parser.read(data):
            self._rows.append((self._hardware.seconds(), *values))
            self._silence.end()
            self._unread_bytes = 0

    def disconnected(self) -> None:
        """Note that the plug was pulled."""
        self._gone = True

    def take(self) -> Block:
        """Return the new rows. Raises DeviceError after ten seconds without a reading, or a pulled plug."""
        if not self._rows:
            if not self._stopped:
                self._check()
            return self.no_rows(None)
        rows, self._rows = self._rows, []
        times_s, *values = (np.array(column) for column in zip(*rows, strict=True))
        return Block((self._hardware.clock.unix_s(times_s), *values), None)

    async def stop(self) -> None:
        """Expect no further reading."""
        self._stopped = True

    def close(self) -> None:
        """Close the port."""
        if self._port is not None:
            port, self._port = self._port, None
            port.close()

    def facts(self) -> Mapping[str, Any]:
        """Return how many packets or lines held no reading."""
        return self._parser.facts()

    def _check(self) -> None:
        if self._gone:
            raise DeviceError(f"{self._where}: the {self.name} was unplugged: plug it in and start again.")
        if self._silence.seconds >= _SILENT_S:
            unread = f"{counted(self._unread_bytes, 'byte')} without a reading, {self._unread!r} the last: "
            nothing = "nothing: it is off, not set to send continuously, or not on this port."
            sent = unread + self._parser.explain() if self._unread_bytes else nothing
            raise DeviceError(f"{self._where}: in {self._silence.seconds:.0f} s the {self.name} sent {sent}")
