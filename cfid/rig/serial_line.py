"""Opens serial ports in the loop, for bytes in both directions."""

from typing import Any

from twisted.internet.protocol import Protocol
from twisted.internet.serialport import SerialPort
from twisted.python.failure import Failure

from cfid.errors import DeviceError
from cfid.rig.e201_port import PORT_ERRORS, why_not_open
from cfid.rig.encoder import OpenLine, Receiver, SerialLine


class _Wire(Protocol):
    def __init__(self, receiver: Receiver) -> None:
        self._receiver = receiver

    def dataReceived(self, data: bytes) -> None:  # noqa: N802 - Twisted's name
        self._receiver.received(data)

    def connectionLost(self, reason: Failure | None = None) -> None:  # noqa: N802 - Twisted's name
        self._receiver.disconnected()


class _TwistedLine:
    """An open serial port."""

    def __init__(self, port: str, receiver: Receiver, *, loop: Any) -> None:
        """Open the port."""
        self._port = SerialPort(_Wire(receiver), port, loop, baudrate=115200)

    def write(self, data: bytes) -> None:
        """Send."""
        self._port.write(data)

    def close(self) -> None:
        """Send waiting bytes, and close."""
        self._port.loseConnection()


def serial_lines(loop: Any) -> OpenLine:
    """Return a function that opens serial ports in a loop; it raises DeviceError."""

    def opened(port: str, receiver: Receiver) -> SerialLine:
        try:
            return _TwistedLine(port, receiver, loop=loop)
        except PORT_ERRORS as error:
            raise DeviceError(f"{port}: {why_not_open(error)}") from None

    return opened
