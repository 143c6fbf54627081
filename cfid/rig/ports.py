"""Ports of this computer in the rig's loop, by Twisted: serial ports, hidraw devices, and UDP with kernel stamps."""

import contextlib
import errno
import fcntl
import os
import socket
import struct
import sys
import termios
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import serial
from serial.tools import list_ports
from twisted.internet.protocol import DatagramProtocol, Protocol
from twisted.internet.serialport import SerialPort
from twisted.internet.udp import Port

from cfid.errors import DeviceError

if TYPE_CHECKING:
    from cfid.rig.hardware import Address, Hardware, Receiver, TakeDatagram

RECEIVE_BUFFER_BYTES = 4 << 20  # 1.4 s of single records at 7 kHz; the usual buffer holds 37 ms
# Wake-ups cost the most: the system collects datagrams, and every block of a recording takes those that wait.
_PAUSE_S, _SHORT_PAUSE_S = 0.25, 0.025  # with the buffer that was requested, and with a smaller one
_LONGEST_DRAIN_S = 0.025
_LONGEST_DATAGRAM = 2048
_CLOCK_STEP_S = 1e-3  # more than the wall clock drifts between two reads: then it was set

# Linux, asm-generic/socket.h; Python 3.11 has no names for them.
_SO_TIMESTAMPNS = 35
_SO_RXQ_OVFL = 40
_SO_RCVBUFFORCE = 33  # may exceed the system's limit, for those who may set that limit
_TIMESPEC = struct.Struct("@ll")
_OVERFLOW = struct.Struct("@I")

_FEATURE_REPORT = 3 << 30 | ord("H") << 8 | 0x06  # linux/hidraw.h, HIDIOCSFEATURE without a size in bits 16 to 29


class _Serial(SerialPort):
    """An open serial port, which no other program may open meanwhile."""

    _serialFactory = partial(serial.Serial, exclusive=True)  # noqa: N815 - Twisted's name

    def __init__(self, hardware: Any, path: str, receiver: "Receiver", *, baud: int) -> None:
        protocol: Any = Protocol()
        protocol.dataReceived = receiver.received
        protocol.connectionLost = lambda reason: receiver.disconnected()
        super().__init__(protocol, path, hardware.loop, baudrate=baud)

    def close(self) -> None:
        self.loseConnection()


def open_serial(hardware: "Hardware", path: str, receiver: "Receiver", *, baud: int) -> _Serial:
    """Open a serial port. Raises DeviceError naming why it cannot be opened."""
    try:
        return _Serial(hardware, path, receiver, baud=baud)
    except (OSError, termios.error) as error:  # pyserial's own is an OSError; that of a plug pulled just now is not
        raise DeviceError(f"{path}: {_why_not_open(error)}") from None


def _why_not_open(error: Exception) -> str:
    """Return why a port cannot be opened, and what to do."""
    number = getattr(error, "errno", None)
    if number == errno.EACCES:
        return "this user may not open it: join the group that owns it (dialout on most systems), and log in again."
    if number == errno.ENOENT:
        available = ", ".join(info.device for info in list_ports.comports())
        return f"no such port. Available: {available or 'none'}."
    if number in (errno.EAGAIN, errno.EBUSY):
        return "another program has it open: close that first."
    if number in (errno.EISDIR, errno.ENOTTY) or "Inappropriate ioctl" in str(error):
        return "this is not a serial port."
    return f"{error}."


def hid_nodes(vendor: int, product: int, root: Path = Path("/")) -> list[str]:
    """Return the hidraw devices of a USB vendor and product; `root` holds dev and sys."""
    identity = f"HID_ID=0003:{vendor:08X}:{product:08X}"  # 3 is the bus, USB
    found = []
    for node in sorted((root / "sys/class/hidraw").glob("*")):
        with contextlib.suppress(OSError):  # unplugged just now
            if identity in (node / "device/uevent").read_text().splitlines():
                found.append(str(root / "dev" / node.name))
    return found


class HidPort:
    """An open hidraw device; each read of it returns a report."""

    def __init__(
        self, hardware: "Hardware", path: str, receiver: "Receiver", *, usb_id: tuple[int, int], feature: bytes
    ) -> None:
        """Open the device and send it a feature report. Raises DeviceError, for no permission with advice."""
        self._hardware, self._receiver = hardware, receiver
        try:
            self._handle = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        except PermissionError:
            vendor, product = usb_id
            raise DeviceError(
                f'{path}: this user may not open it. Write the line SUBSYSTEM=="hidraw", '
                f'ATTRS{{idVendor}}=="{vendor:04x}", ATTRS{{idProduct}}=="{product:04x}", TAG+="uaccess", '
                'GROUP="dialout", MODE="0660" into /etc/udev/rules.d/60-cfid.rules, then unplug the device and plug it '
                "in again."
            ) from None
        except OSError as error:
            raise DeviceError(f"{path}: {error.strerror}: unplug the device and plug it in again.") from None
        try:
            fcntl.ioctl(self._handle, _FEATURE_REPORT | len(feature) << 16, feature)
        except OSError as error:
            os.close(self._handle)
            raise DeviceError(f"{path}: it cannot be set up ({error.strerror}): another device.") from None
        hardware.add_reader(self)

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
        if report:
            self._receiver.received(report)
        else:
            self.connectionLost(None)

    def connectionLost(self, reason: object) -> None:  # noqa: N802 - Twisted's name
        """Take the end of the device as a pulled plug."""
        self.close()
        self._receiver.disconnected()

    def write(self, data: bytes) -> None:
        """Send a report."""
        os.write(self._handle, data)

    def close(self) -> None:
        """Close the device, once."""
        if self._handle >= 0:
            self._hardware.remove_reader(self)
            os.close(self._handle)
            self._handle = -1


class StampedPort(Port):
    """A UDP port with a large receive buffer, the kernel's stamps, and few wake-ups."""

    def __init__(self, loop: Any, address: "Address", take: "TakeDatagram") -> None:
        """Take the address to talk to, and what takes the datagrams; `opened` opens it."""
        super().__init__(0, DatagramProtocol(), reactor=loop)
        self.buffer_bytes = self.overflowed = 0
        self._address, self._take = address, take
        self._stamped = False
        self._read_s = time.monotonic()
        self._unix_less_monotonic_s = time.time() - self._read_s

    @classmethod
    def opened(cls, loop: Any, address: "Address", take: "TakeDatagram") -> "StampedPort":
        """Return an open port."""
        port = cls(loop, address, take)
        port.startListening()
        return port

    def createInternetSocket(self) -> socket.socket:  # noqa: N802 - Twisted's name
        """Make the socket with its options."""
        made: socket.socket = super().createInternetSocket()
        self.buffer_bytes = _enlarge(made)
        self._stamped = sys.platform == "linux" and _ask_for_stamps(made)
        return made

    def send(self, datagram: bytes) -> None:
        """Send; if the address cannot be reached, its silence shows that."""
        with contextlib.suppress(OSError):
            self.socket.sendto(datagram, self._address)

    def close(self) -> None:
        """Close the port."""
        if self.connected:
            self.stopListening()

    def doRead(self) -> None:  # noqa: N802 - Twisted's name
        """Take all waiting datagrams, and read again a little later."""
        self.drain()
        self.stopReading()
        pause_s = _PAUSE_S if self.buffer_bytes >= RECEIVE_BUFFER_BYTES else _SHORT_PAUSE_S
        self.reactor.callLater(pause_s, self._read_again)

    def drain(self) -> None:
        """Take all waiting datagrams."""
        if self.socket is None:
            return
        now_s = time.monotonic()
        read_s, self._read_s = self._read_s, now_s
        before_s, self._unix_less_monotonic_s = self._unix_less_monotonic_s, time.time() - now_s
        clock_was_set = abs(self._unix_less_monotonic_s - before_s) > _CLOCK_STEP_S
        with contextlib.suppress(OSError):  # none waits, or the network reports that no program listens
            while True:
                if self._stamped:
                    data, ancillary, _, source = self.socket.recvmsg(_LONGEST_DATAGRAM, 64)
                    arrival_s = now_s if clock_was_set else self._stamp(ancillary, read_s, now_s)
                else:
                    data, source = self.socket.recvfrom(_LONGEST_DATAGRAM)
                    arrival_s = now_s
                self._take(data, source, arrival_s)

    def _read_again(self) -> None:
        if self.connected:
            self.startReading()

    def _stamp(self, ancillary: list[tuple[int, int, bytes]], read_s: float, now_s: float) -> float:
        """Return when the system received a datagram, on the monotonic clock; its stamp is of the wall clock.

        The datagram arrived after the last read, which would otherwise have taken it: an earlier stamp is rejected.
        """
        arrival_s = now_s
        for _, kind, value in ancillary:
            if kind == _SO_TIMESTAMPNS:
                seconds, nanoseconds = _TIMESPEC.unpack(value)
                arrival_s = seconds + 1e-9 * nanoseconds - self._unix_less_monotonic_s
            elif kind == _SO_RXQ_OVFL:
                (self.overflowed,) = _OVERFLOW.unpack(value)
        return arrival_s if read_s - _CLOCK_STEP_S < arrival_s < now_s + _LONGEST_DRAIN_S else now_s


def _enlarge(made: socket.socket) -> int:
    """Request a large receive buffer; return the size granted, which Linux reports doubled."""
    for option in (_SO_RCVBUFFORCE, socket.SO_RCVBUF) if sys.platform == "linux" else (socket.SO_RCVBUF,):
        try:
            made.setsockopt(socket.SOL_SOCKET, option, RECEIVE_BUFFER_BYTES)
            break
        except OSError:
            continue
    granted = made.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    return granted // 2 if sys.platform == "linux" else granted


def _ask_for_stamps(made: socket.socket) -> bool:
    try:
        made.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        made.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
    except OSError:
        return False
    return True
