"""Serves a simulated Crazyflie over UDP, one packet a datagram, as cflib's driver for `udp://` expects."""

import contextlib
import socket

from twisted.internet.base import DelayedCall
from twisted.internet.defer import Deferred, succeed
from twisted.internet.posixbase import PosixReactorBase
from twisted.internet.protocol import DatagramProtocol
from twisted.internet.udp import Port

from cfid.sim.crazyflie_faults import FaultyCrazyflie
from cfid.sim.netft import LOOPBACK, Address


class CrazyflieServer:
    """A vehicle on a port of one address; port 0 takes a free one. It sleeps until something is due."""

    def __init__(
        self, vehicle: FaultyCrazyflie, *, reactor: PosixReactorBase, address: str = LOOPBACK, port: int = 0
    ) -> None:
        """Open nothing yet."""
        self._vehicle = vehicle
        self._reactor = reactor
        self._address, self._requested_port = address, port
        self._port: Port | None = None
        self._socket: socket.socket | None = None
        self._timer: DelayedCall | None = None

    def open(self) -> str:
        """Bind the port and return its address in cflib's form. Raises twisted's CannotListenError."""
        self._port = self._reactor.listenUDP(self._requested_port, _Packets(self), self._address)
        self._socket = self._port.socket
        self._attend()
        return f"udp://{self._address}:{self._port.getHost().port}"

    def close(self) -> Deferred[None]:
        """Close the port and stop serving the vehicle; fires when it is done."""
        if self._timer is not None and self._timer.active():
            self._timer.cancel()
        return self._shut()

    def received(self, datagram: bytes, client: Address) -> None:
        """Take a datagram."""
        self._vehicle.received(datagram, client, self._reactor.seconds())
        if self._timer is not None and self._timer.active():
            self._timer.cancel()
        self._attend()

    def _attend(self) -> None:
        """Send due packets, and schedule the next event; the vehicle goes on even without a port."""
        now_s = self._reactor.seconds()
        if self._vehicle.closed(now_s):
            self._shut()
        for packet, client in self._vehicle.due(now_s):
            if self._socket is not None:
                with contextlib.suppress(OSError):  # a full buffer or no route: a radio loses packets too
                    self._socket.sendto(packet, client)
        next_s = self._vehicle.next_s(now_s)
        if next_s is not None:
            self._timer = self._reactor.callLater(max(0.0, next_s - self._reactor.seconds()), self._attend)

    def _shut(self) -> Deferred[None]:
        port, self._port, self._socket = self._port, None, None
        return (port.stopListening() if port is not None else None) or succeed(None)


class _Packets(DatagramProtocol):
    def __init__(self, server: CrazyflieServer) -> None:
        self._server = server

    def datagramReceived(self, datagram: bytes, addr: Address) -> None:  # noqa: N802 (twisted's name)
        self._server.received(datagram, addr)
