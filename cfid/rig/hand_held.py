"""Records what hand-held instruments show: a tachometer, scales, and readings that the operator types."""

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from cfid.counted import counted
from cfid.errors import DeviceError
from cfid.records.run import DeviceRecord
from cfid.rig.hardware import Hardware, SerialPort
from cfid.rig.instrument import Block, Instrument, PortInstrument
from cfid.rig.progress import displayed
from cfid.wire import ut372
from cfid.wire.scales import ScalesReader

_SILENT_S = 10.0  # without a reading of an instrument that is held in a hand


class HandHeld(PortInstrument):
    """An instrument that sends readings unprompted on a port of its own, at no stated rate."""

    eventful = True
    columns: tuple[str, ...]  # of its rows, the time first
    unit: str
    _reader: ut372.Ut372Reader | ScalesReader

    def __init__(self, port: str, **stated: object) -> None:
        """Take a port, and what run.toml states of it; nothing is opened yet."""
        super().__init__(port, patient=False)
        self.record = DeviceRecord.model_validate(
            {"file": f"{self.name}.csv", "columns": self.columns, "port": port, **stated}
        )
        self.reading = displayed(self.unit)

    @abstractmethod
    def read(self, data: bytes) -> Iterable[tuple[float, ...]]:
        """Take bytes, and return the values of rows without their time."""

    @abstractmethod
    def explain(self) -> str:
        """Return the likely cause when bytes arrive but no row does."""

    def start(self, hardware: Hardware) -> None:
        """Open the port. Raises DeviceError naming why it cannot be opened."""
        self._rows: list[tuple[float, ...]] = []
        self._unread = b""
        self._unread_bytes = 0
        self._begin(hardware, period_s=_SILENT_S)

    def received(self, data: bytes) -> None:
        """Take the bytes that the port received."""
        shown_bytes = 30  # a packet of the tachometer, or a line of scales
        self._unread, self._unread_bytes = (self._unread + data)[-shown_bytes:], self._unread_bytes + len(data)
        for values in self.read(data):
            self._rows.append((self._hardware.seconds(), *values))
            self._silence.end()
            self._unread_bytes = 0

    def take(self) -> Block:
        """Return the new rows. Raises DeviceError after ten seconds without a reading, or a pulled plug."""
        if not self._rows and not self._stopped:
            self._check()
        rows, self._rows = self._rows, []
        return self.block(rows, None)

    def facts(self) -> Mapping[str, Any]:
        """Return how many packets or lines held no reading."""
        return {"rejected": self._reader.rejected}

    def _check(self) -> None:
        if self._gone_s is not None:
            raise DeviceError(f"{self._where}: the {self.name} was unplugged: plug it in and start again.")
        if self._silence.seconds >= _SILENT_S:
            unread = f"{counted(self._unread_bytes, 'byte')} without a reading, {self._unread!r} the last: "
            nothing = "nothing: it is off, not set to send continuously, or not on this port."
            sent = unread + self.explain() if self._unread_bytes else nothing
            raise DeviceError(f"{self._where}: in {self._silence.seconds:.0f} s the {self.name} sent {sent}")


class Ut372(HandHeld):
    """A UT372. Rows are present speeds in revolutions per minute, not counts, holds or statistics.

    A row's time is when its last byte arrived, a tenth of a second after the first.
    """

    name = "tachometer"
    columns = ("t", "rpm")
    unit = "rpm"

    def __init__(self, port: str) -> None:
        """Take its USB bridge, or a serial port that it is wired to."""
        super().__init__(port)
        self._reader: ut372.Ut372Reader = ut372.Ut372Reader()
        self._set_aside = 0
        self._shows_else = False
        self._is_hid = Path(port).resolve().name.startswith("hidraw")

    def _open(self) -> SerialPort:
        if self._is_hid:
            usb_id = ut372.USB_VENDOR, ut372.USB_PRODUCT
            return self._hardware.hid(self._where, self, usb_id=usb_id, feature=ut372.SET_BAUD)
        return self._hardware.serial(self._where, self, baud=ut372.BAUD)

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
        return {**super().facts(), "set_aside": self._set_aside}


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


class Scales(HandHeld):
    """Scales that send lines; `stable` is 1 or 0, and -1 where a line does not state it."""

    name = "scales"
    columns = ("t", "grams", "stable")
    unit = "g"

    def __init__(self, port: str, baud: int) -> None:
        """Take their port and its speed."""
        super().__init__(port, baud=baud)
        self._reader: ScalesReader = ScalesReader()
        self._baud = baud

    def _open(self) -> SerialPort:
        return self._hardware.serial(self._where, self, baud=self._baud)

    def read(self, data: bytes) -> Iterable[tuple[float, ...]]:
        """Return weights."""
        for grams, stable in self._reader.feed(data):
            yield grams, -1 if stable is None else int(stable)

    def explain(self) -> str:
        """Return which settings may differ."""
        return "overload, another speed, frame (8N1) or unit (g, kg, mg, lb, oz) than expected, or another device."


class Readings(Instrument):
    """Readings in a column named `value`; `t` is when a reading was typed.

    A row with `withdrawn` 1 repeats the row that it withdraws, which is already on disk.
    """

    name = "readings"
    eventful = True

    def __init__(self, value: str) -> None:
        """Take the name of the column of readings."""
        columns = ("t", "command", value, "withdrawn")
        self.record = DeviceRecord.model_validate({"file": "readings.csv", "columns": columns, "typed": True})
        self._rows: list[tuple[float, int, float, int]] = []
        self._kept: list[tuple[int, float]] = []

    def start(self, hardware: Hardware) -> None:
        """Wait for readings."""
        self._hardware = hardware

    def add(self, command: int, value: float) -> None:
        """Note a reading at a command."""
        self._kept.append((command, value))
        self._rows.append((self._hardware.seconds(), command, value, 0))

    @property
    def values(self) -> list[float]:
        """The readings that were not withdrawn, in order."""
        return [value for _, value in self._kept]

    @property
    def commands(self) -> list[int]:
        """The commands of `values`."""
        return [command for command, _ in self._kept]

    def withdraw(self) -> tuple[int, float] | None:
        """Withdraw the last reading; return its command and its value, None where there is none."""
        if not self._kept:
            return None
        command, value = self._kept.pop()
        self._rows.append((self._hardware.seconds(), command, value, 1))
        return command, value

    def take(self) -> Block:
        """Return the readings typed since the last call."""
        rows, self._rows = self._rows, []
        return self.block(rows)
