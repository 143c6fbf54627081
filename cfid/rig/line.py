"""Opens a minimal link to a vehicle, without its tables: it is ready in a moment, for a stop."""

import contextlib
import socket
import threading
import time
from typing import Any, Protocol
from urllib.parse import urlsplit

from cfid.errors import DeviceError
from cfid.wire.crtp import LONGEST_PAYLOAD, Packet, decode_packet, encode_packet


class VehicleLine(Protocol):
    """Packets to and from a vehicle."""

    def send(self, packet: Packet) -> object:
        """Send a packet, if the link takes it."""

    def receive(self, within_s: float) -> Packet | None:
        """Return the next packet, None when none comes in time."""

    def close(self) -> None:
        """Release the link."""


def open_line(uri: str) -> VehicleLine:
    """Open the link to a vehicle. Raises DeviceError, also for a radio that another process uses."""
    return _Datagrams(uri) if uri.startswith("udp://") else _Driver(uri)


class _Datagrams:
    """A UDP socket instead of cflib, whose import takes as long as the rest of a stop."""

    def __init__(self, uri: str) -> None:
        where = urlsplit(uri)
        self._socket = socket.socket(type=socket.SOCK_DGRAM)
        try:
            self._socket.connect((where.hostname or "", where.port or 0))
        except (OSError, ValueError) as error:
            self._socket.close()
            raise DeviceError(f"{uri}: {error}.") from None

    def send(self, packet: Packet) -> None:
        with contextlib.suppress(OSError):  # no program listens there at the moment
            self._socket.send(encode_packet(packet))

    def receive(self, within_s: float) -> Packet | None:
        self._socket.settimeout(max(within_s, 1e-3))
        try:
            return decode_packet(self._socket.recv(2 * LONGEST_PAYLOAD))
        except TimeoutError:
            return None
        except OSError:
            time.sleep(within_s)
            return None

    def close(self) -> None:
        self._socket.close()


class _Driver:
    """cflib's driver of a radio or a USB cable, without cflib's tables and its close, which commands the vehicle."""

    def __init__(self, uri: str) -> None:
        import cflib.crtp

        if not cflib.crtp.CLASSES:
            cflib.crtp.init_drivers()
        try:
            self._driver: Any = cflib.crtp.get_link_driver(uri, lambda *_: None, lambda *_: None)
        except Exception as error:  # its drivers, and those of USB, raise errors of any kind
            raise DeviceError(f"{uri}: {error}.") from None
        if self._driver is None:
            raise DeviceError(f"{uri}: this is not the address of a vehicle.")

    def send(self, packet: Packet) -> None:
        from cflib.crtp.crtpstack import CRTPPacket

        sent = CRTPPacket()
        sent.set_header(packet.port, packet.channel)
        sent.data = packet.payload
        self._driver.send_packet(sent)

    def receive(self, within_s: float) -> Packet | None:
        came = self._driver.receive_packet(max(within_s, 1e-3))
        return None if came is None else Packet(came.port, came.channel, bytes(came.data))

    def close(self) -> None:
        closing = threading.Thread(target=self._driver.close, daemon=True)
        closing.start()
        closing.join(1.0)
