"""Opens ports that cfid only listens to: serial ports, and the USB bridge of a UT372, which it finds on Linux."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from twisted.internet import protocol
from twisted.internet.serialport import SerialPort
from twisted.python.failure import Failure

from cfid.errors import DeviceError
from cfid.rig.e201_port import PORT_ERRORS, why_not_open
from cfid.rig.encoder import Receiver
from cfid.wire import ut372

SCALES_BAUD = 9600  # the factory setting of most scales

_HIDIOCSFEATURE = 3 << 30 | len(ut372.SET_BAUD) << 16 | ord("H") << 8 | 0x06  # linux/hidraw.h
_USB_ID = f"{ut372.USB_VENDOR:04x}:{ut372.USB_PRODUCT:04x}"
_HID_ID = f"HID_ID=0003:{ut372.USB_VENDOR:08X}:{ut372.USB_PRODUCT:08X}"  # 3 is the bus, USB
_NOT_ALLOWED = (
    'this user may not open it. Write the line SUBSYSTEM=="hidraw", '
    f'ATTRS{{idVendor}}=="{ut372.USB_VENDOR:04x}", ATTRS{{idProduct}}=="{ut372.USB_PRODUCT:04x}", TAG+="uaccess", '
    'GROUP="dialout", MODE="0660" into /etc/udev/rules.d/60-ut372.rules, then unplug the tachometer and plug it '
    "in again."
)


class Port(Protocol):
    """An open port that is only listened to."""

    def close(self) -> None:
        """Close it; nothing is received afterwards."""


Listen = Callable[[str, Receiver], Port]


def serial_ports(loop: Any, *, baud: int = SCALES_BAUD) -> Listen:
    """Return a function that opens serial ports, 8N1; it raises DeviceError."""

    def opened(port: str, receiver: Receiver) -> Port:
        try:
            return _SerialPort(port, receiver, baud=baud, loop=loop)
        except PORT_ERRORS as error:
            raise DeviceError(f"{port}: {why_not_open(error)}") from None

    return opened


def ut372_ports(loop: Any) -> Listen:
    """Return a function that opens a UT372's hidraw device, or a serial port it is wired to; it raises DeviceError."""
    listen = serial_ports(loop, baud=ut372.BAUD)

    def opened(port: str, receiver: Receiver) -> Port:
        if Path(port).resolve().name.startswith("hidraw"):
            return HidrawPort(_open_hidraw(port), receiver, loop=loop)
        return listen(port, receiver)

    return opened


def find_ut372(root: Path = Path("/")) -> str:
    """Return the hidraw device of the one UT372 that is plugged in; `root` holds dev and sys (Linux only).

    Raises DeviceError naming what was found, and what to do.
    """
    found = [node.name for node in sorted((root / "sys/class/hidraw").glob("*")) if _is_bridge(node)]
    if not found:
        raise DeviceError(
            f"no UT372 is plugged in: there is no USB device {_USB_ID} (the search works on Linux only). Plug it in, "
            "switch it on, or set its port, or type what it shows."
        )
    if len(found) > 1:
        raise DeviceError(
            f"{len(found)} devices may be the UT372: /dev/{', /dev/'.join(found)}; multimeters have the same cable. "
            "Set the tachometer's port, or unplug the others."
        )
    path = root / "dev" / found[0]
    if not os.access(path, os.R_OK | os.W_OK):
        raise DeviceError(f"{path}: {_NOT_ALLOWED}")
    return str(path)


def _is_bridge(node: Path) -> bool:
    try:
        return _HID_ID in (node / "device/uevent").read_text().splitlines()
    except OSError:  # unplugged just now
        return False


def _open_hidraw(path: str) -> int:
    """Open the bridge and set its baud rate, for which it has no default (sigrok's wiki, WCH CH9325)."""
    import fcntl

    try:
        handle = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    except PermissionError:
        raise DeviceError(f"{path}: {_NOT_ALLOWED}") from None
    except OSError as error:
        raise DeviceError(f"{path}: {error.strerror}: unplug the tachometer and plug it in again.") from None
    try:
        fcntl.ioctl(handle, _HIDIOCSFEATURE, ut372.SET_BAUD)
    except OSError as error:
        os.close(handle)
        raise DeviceError(f"{path}: its baud rate cannot be set ({error.strerror}): this is not a UT372.") from None
    return handle


class _SerialPort(protocol.Protocol):
    """An open serial port."""

    def __init__(self, port: str, receiver: Receiver, *, baud: int, loop: Any) -> None:
        self._receiver = receiver
        self._port = SerialPort(self, port, loop, baudrate=baud)

    def dataReceived(self, data: bytes) -> None:  # noqa: N802 - Twisted's name
        self._receiver.received(data)

    def connectionLost(self, reason: Failure | None = None) -> None:  # noqa: N802 - Twisted's name
        self._receiver.disconnected()

    def close(self) -> None:
        self._port.loseConnection()


class HidrawPort:
    """An open bridge, which passes on the serial bytes in its reports."""

    def __init__(self, handle: int, receiver: Receiver, *, loop: Any) -> None:
        """Take an open device; each read of it returns a report."""
        self._handle, self._receiver, self._loop = handle, receiver, loop
        loop.addReader(self)

    def fileno(self) -> int:
        """Return the file descriptor that the loop waits for."""
        return self._handle

    def logPrefix(self) -> str:  # noqa: N802 - Twisted's name
        """Return a name for Twisted's log."""
        return "hidraw"

    def doRead(self) -> None:  # noqa: N802 - Twisted's name
        """Read a report."""
        try:
            report = os.read(self._handle, 64)
        except BlockingIOError:
            return
        except OSError:  # unplugged
            report = b""
        if not report:
            self.connectionLost(None)
            return
        data = ut372.unpack_report(report)
        self._receiver.received(report if data is None else data)  # another device's report counts as unreadable

    def connectionLost(self, reason: object) -> None:  # noqa: N802 - Twisted's name
        """Take the end of the device as a pulled plug."""
        self.close()
        self._receiver.disconnected()

    def close(self) -> None:
        """Close the device, once."""
        if self._handle >= 0:
            self._loop.removeReader(self)
            os.close(self._handle)
            self._handle = -1
