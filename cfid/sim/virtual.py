"""The simulated side of the seam to the hardware: devices on a clock that passes as fast as the program computes."""

import heapq
import itertools
import os
import select
from collections import deque
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

from twisted.internet.base import DelayedCall
from twisted.internet.defer import Deferred, execute
from twisted.python.failure import Failure

from cfid.errors import DeviceError
from cfid.records.rig_file import Devices, Rig
from cfid.rig.hardware import (
    Address,
    DatagramPort,
    Hardware,
    Receiver,
    Result,
    SerialPort,
    TakeDatagram,
)
from cfid.rig.link import Arrived, Link, QueuedPacket
from cfid.rig.loadcell import RECEIVE_BUFFER_BYTES
from cfid.rig.loop import Ending
from cfid.sim.devices import SimulatedRig
from cfid.sim.faults import FaultySerial
from cfid.sim.pty import DevicePort
from cfid.sim.service import SENDING_EVERY_S, Addresses, devices_at
from cfid.wire.crtp import ECHO_CHANNEL, ECHO_PORT, Packet, decode_packet, encode_echo, encode_packet
from cfid.wire.e201 import PRODUCT

_BOX: Address = ("192.0.2.9", 49152)  # in the network reserved for examples
_CLIENT = "192.0.2.10"
_ECHO = Packet(ECHO_PORT, ECHO_CHANNEL, encode_echo(0))
_ECHO_EVERY_S = 0.0973  # near a tenth of a second, and never in step with requests that are repeated at such times
_ROUNDING_S = 1e-9
_ATTEND_S = 0.004  # between looks at the vehicle, which steps each millisecond; its packets keep their times
_numbers = itertools.count(1)


class VirtualClock:
    """A clock that goes from one call to the next, with those methods of Twisted's loop that devices use."""

    def __init__(self) -> None:
        """Start at one second, so that nothing began at zero."""
        self._now_s = 1.0
        self._calls: list[tuple[float, int, DelayedCall]] = []
        self._numbers = itertools.count()  # of calls, which keep their order where they are due at the same time

    def seconds(self) -> float:
        """Return the time."""
        return self._now_s

    def callLater(self, delay_s: float, call: Callable[..., object], *arguments: Any) -> DelayedCall:  # noqa: N802
        """Call something after a delay."""
        at_s = self._now_s + delay_s
        delayed = DelayedCall(at_s, call, arguments, {}, lambda _: None, lambda _: None, self.seconds)
        heapq.heappush(self._calls, (at_s, next(self._numbers), delayed))
        return delayed

    @property
    def next_s(self) -> float | None:
        """When the next call is due, None while there is none."""
        while self._calls and self._calls[0][2].cancelled:
            heapq.heappop(self._calls)
        return self._calls[0][0] if self._calls else None

    def step(self) -> None:
        """Go to the next call, and carry it out."""
        next_s = self.next_s
        if next_s is None:
            raise RuntimeError("nothing more will happen, and the program still waits")
        self.advance(max(next_s - self._now_s, 0.0))

    def advance(self, seconds: float) -> None:
        """Let time pass, and carry out what is due by then."""
        end_s = self._now_s + seconds
        while (next_s := self.next_s) is not None and next_s <= end_s:
            self._now_s = max(next_s, self._now_s)
            _, _, call = heapq.heappop(self._calls)
            call.called = 1
            call.func(*call.args, **call.kw)
        self._now_s = max(end_s, self._now_s)

    def stand_still(self, seconds: float) -> None:
        """Let time pass in which nothing is carried out."""
        self._now_s += seconds


class Virtual(Hardware):
    """A simulated rig as hardware. `make` makes its devices, on the clock that it is given.

    `ending` is the request to end of the run under way, for which `at` schedules signals.
    """

    def __init__(
        self, make: Callable[[Callable[[], float]], SimulatedRig], *, unix_s: float, time: VirtualClock | None = None
    ) -> None:
        """Power the devices on at a Unix time."""
        super().__init__()
        self.time: VirtualClock = time or VirtualClock()
        self.unix_less_monotonic_s = unix_s - self.time.seconds()
        self.rig = make(self.time.seconds)
        self.ending: Ending | None = None
        self.slept_s = 0.0  # for how long the computer was suspended
        self._readers: list[Any] = []
        self._links: dict[Address, _VirtualLink] = {}
        self._next_packet: DelayedCall | None = None
        number = f"{os.getpid()}-{next(_numbers)}"  # so that no other process' lock has this rig's names
        self._uri = f"sim://{number}"
        self._box = (f"192.0.2.9-{number}", _BOX[1])
        self.ports: dict[str, _VirtualPort] = {}
        self._products: dict[str, str] = {}
        self.plug_in(f"/virtual/{number}/encoder", self.rig.encoder, product=PRODUCT)
        if self.rig.loadcell_lines is not None:
            self.plug_in(f"/virtual/{number}/loadcell", self.rig.loadcell_lines)
        self.attend_vehicle()

    def at(self, seconds: float, call: Callable[..., object], *arguments: Any) -> None:
        """Do something `seconds` from now: request an end, pull a plug, press a key."""
        self.time.callLater(seconds, call, *arguments)

    def plug_in(self, path: str, device: FaultySerial, *, product: str = "") -> None:
        """Plug another device in, which has a name on USB; one whose path names a hidraw device is opened as such."""
        self._products[path] = product
        self.ports[path] = _VirtualPort(device, self.time)
        self.ports[path].begin()

    def move(self, path: str, to: str) -> None:
        """Give the device at a path another one, as a system may when its plug is back."""
        self.ports[to], self._products[to] = self.ports.pop(path), self._products.pop(path)

    def request_end(self, name: str = "SIGINT") -> None:
        """Request the end of the run under way, as a signal does."""
        if self.ending is not None:
            self.ending.request(name)

    def stand_still(self, seconds: float) -> None:
        """Let time pass in which this program does not run."""
        self.time.stand_still(seconds)

    def seconds(self) -> float:
        """Return the time."""
        return float(self.time.seconds())

    def suspended_s(self) -> float:
        """Return how long the computer has been suspended."""
        return self.slept_s

    def pause(self, seconds: float) -> None:
        """Let time pass."""
        self._go_on(self.seconds() + seconds, lambda: False)

    def run(self, main: Callable[[Ending], Coroutine[Any, Any, Result]]) -> Result:
        """Run a coroutine to its end."""
        self.ending = Ending(self.time)
        outcome: list[Result | Failure] = []
        Deferred.fromCoroutine(main(self.ending)).addBoth(outcome.append)
        while not outcome:
            self._read()
            self.time.step()
        self.ending = None
        result = outcome[0]
        if isinstance(result, Failure):
            result.raiseException()
        return result

    def hang_up(self) -> None:
        """Request the end of the run under way."""
        self.request_end("SIGHUP")

    def later(self, delay_s: float, call: Callable[..., object], *arguments: Any) -> DelayedCall:
        """Call something after a delay."""
        return self.time.callLater(delay_s, call, *arguments)

    def soon(self, call: Callable[..., object], *arguments: Any) -> None:
        """Call something at once, in the next turn."""
        self.time.callLater(0.0, call, *arguments)

    def in_thread(self, work: Callable[[], object]) -> Deferred[object]:
        """Do something now."""
        return execute(work)

    def add_reader(self, reader: Any) -> None:
        """Read what is typed while time passes."""
        self._readers.append(reader)

    def remove_reader(self, reader: Any) -> None:
        """End that."""
        if reader in self._readers:
            self._readers.remove(reader)

    def devices(self, folder: Path, rig: Rig) -> tuple[Devices, bool]:
        """Return the simulated devices."""
        encoder, *others = map(Path, self.ports)
        box, port = self._box
        where = Addresses(encoder, others[0] if others else None, box, port, port, port, self._uri)
        return devices_at(where, rig.devices, supply=self.rig.on_supply), True

    def serial_ports(self) -> list[tuple[str, str]]:
        """Return the ports of the devices that have a name, while they are plugged in."""
        named = [(path, product) for path, product in self._products.items() if product]
        return [(path, product) for path, product in named if self.ports[path].is_plugged]

    def has_port(self, path: str) -> bool:
        """Return whether a simulated device is at a path."""
        return path in self.ports and self.ports[path].is_plugged

    def serial(self, path: str, receiver: Receiver, *, baud: int) -> SerialPort:
        """Open the port of a simulated device."""
        if not self.has_port(path):
            raise DeviceError(f"{path}: no such port. Available: {', '.join(self.ports)}.")
        return _VirtualSerial(self.ports[path], receiver)

    def hid_nodes(self, vendor: int, product: int) -> list[str]:
        """Return those that are plugged in, whatever their kind."""
        return [path for path in self.ports if Path(path).name.startswith("hidraw")]

    def hid(self, path: str, receiver: Receiver, *, usb_id: tuple[int, int], feature: bytes) -> SerialPort:
        """Open a hidraw device."""
        return self.serial(path, receiver, baud=0)

    def host(self, name: str) -> str:
        """Return the name itself."""
        return name

    def datagrams(self, address: Address, take: TakeDatagram) -> DatagramPort:
        """Open a port to the simulated box; nothing answers at another address."""
        return _VirtualDatagrams(self, address, take)

    def page(self, address: Address, path: str) -> tuple[int, str]:
        """Return a page of the simulated box."""
        self._refuse_without_box(address)
        self.pause(self.rig.loadcell.faults.slow_s)
        text = self.rig.loadcell.get(path)
        return (404, "") if text is None else (200, text)

    def exchange(self, address: Address, request: bytes, size: int) -> bytes:
        """Return the simulated box' answer over TCP."""
        self._refuse_without_box(address)
        return self.rig.loadcell.box.answer(request, self.seconds())[:size]

    def link(self, uri: str) -> Link:
        """Open a link to the simulated vehicle."""
        if uri != self._uri:
            raise DeviceError(f"{uri}: no vehicle is simulated there.")
        client = (_CLIENT, 50000 + next(_numbers))
        self._links[client] = _VirtualLink(self, uri, client)
        return self._links[client]

    def forget(self, client: Address) -> None:
        """Deliver nothing more to a client whose link was closed."""
        self._links.pop(client, None)

    def find_vehicle(self) -> str:
        """Return the simulated vehicle's address."""
        return self._uri

    def is_box(self, address: Address) -> bool:
        """Return whether the simulated box is at an address, and has power."""
        return address == self._box and self.rig.loadcell.alive(self.seconds())

    def send_packet(self, packet: Packet, client: Address) -> None:
        """Send a packet to the vehicle, whose earlier answers are those of the client before."""
        if len(self._links) > 1:
            self.attend_vehicle()
        if not self.rig.crazyflie.closed(self.seconds()):
            self.rig.crazyflie.received(encode_packet(packet), client, self.seconds())
        self.attend_vehicle()

    def attend_vehicle(self) -> None:
        """Deliver the packets that the vehicle has sent, and wait for its next event."""
        vehicle, now_s = self.rig.crazyflie, self.seconds()
        if vehicle.closed(now_s):
            for link in self._links.values():
                link.fail()
        for datagram, client, arrived_s in vehicle.arrivals(now_s):
            if client in self._links:  # a program that stood still finds packets that came meanwhile at its end
                self._links[client].deliver(datagram, max(arrived_s, now_s - _ATTEND_S))
        if self._next_packet is not None and self._next_packet.active():
            self._next_packet.cancel()
        next_s = vehicle.next_s(now_s)
        if next_s is not None:
            self._next_packet = self.time.callLater(max(next_s - now_s, _ATTEND_S), self.attend_vehicle)

    def wait_for(self, within_s: float, holds: Callable[[], bool]) -> None:
        """Let time pass outside a run until something holds, or a time is over."""
        self._go_on(self.seconds() + within_s, holds)

    def _go_on(self, end_s: float, holds: Callable[[], bool]) -> None:
        while not holds() and self.seconds() < end_s:
            next_s = self.time.next_s
            self.time.advance(max(min(end_s if next_s is None else next_s, end_s) - self.seconds(), 0.0))

    def _read(self) -> None:
        """Let readers read what waits for them."""
        if self._readers:
            for reader in select.select(self._readers, [], [], 0)[0]:
                reader.doRead()

    def _refuse_without_box(self, address: Address) -> None:
        if not self.is_box(address):
            raise DeviceError(
                "http://{}:{}: no answer within 3 s. Is the box powered, and this computer in its network? "
                "See `cfid rig check`.".format(*address)
            )


class _VirtualPort(DevicePort):
    """The port of a simulated device, which one program at a time may open."""

    def __init__(self, device: Any, clock: VirtualClock) -> None:
        super().__init__(device, clock=clock)
        self.is_plugged = False
        self.receiver: Receiver | None = None

    def plug(self) -> None:
        self.is_plugged = True

    def unplug(self) -> None:
        self.is_plugged = False
        receiver, self.receiver = self.receiver, None
        if receiver is not None:
            receiver.disconnected()

    def write(self, reply: bytes) -> None:
        if self.receiver is not None:
            self.receiver.received(reply)


class _VirtualSerial:
    """An open port of a simulated device."""

    def __init__(self, port: _VirtualPort, receiver: Receiver) -> None:
        self._port, self._receiver = port, receiver
        port.receiver = receiver

    def write(self, data: bytes) -> None:
        if self._port.receiver is self._receiver:
            self._port.received(data)

    def close(self) -> None:
        if self._port.receiver is self._receiver:
            self._port.receiver = None


class _VirtualDatagrams:
    """A port that talks to the simulated box over a network without delay."""

    buffer_bytes = RECEIVE_BUFFER_BYTES
    overflowed = 0

    def __init__(self, hardware: Virtual, address: Address, take: TakeDatagram) -> None:
        self._hardware, self._address, self._take = hardware, address, take
        self._client = (_CLIENT, 40000 + next(_numbers))
        self._drained_s = hardware.seconds()

    def send(self, datagram: bytes) -> None:
        if self._hardware.is_box(self._address):
            self.drain()  # the box has sent all that was due before it receives a request
            self._hardware.rig.loadcell.request(datagram, self._client, self._hardware.seconds())

    def drain(self) -> None:
        """Take what the box has sent, each datagram at the time at which it left."""
        now_s = self._hardware.seconds()
        loadcell = self._hardware.rig.loadcell
        while self._drained_s < now_s:
            next_s = max(loadcell.box.next_s() + _ROUNDING_S, self._drained_s + SENDING_EVERY_S)
            self._drained_s = min(next_s, now_s)
            for data, client in loadcell.due(self._drained_s):
                if client == self._client:
                    self._take(data, self._address, self._drained_s)

    def close(self) -> None:
        """Release nothing."""


class _VirtualLink(Link):
    """A link to the simulated vehicle, which asks for an echo in pauses as a real one does."""

    def __init__(self, hardware: Virtual, uri: str, client: Address) -> None:
        super().__init__(uri)
        self._hardware, self._client = hardware, client
        self._packets: deque[Arrived] = deque()
        self._wake: Callable[[], None] = lambda: None
        self._sent_s = hardware.seconds()
        self._closed = False
        self._echo()

    def send(self, packet: Packet) -> QueuedPacket:
        if self._closed or (self.fault and not self.persists):
            raise DeviceError(self.fault or f"{self.uri}: the link is closed.")
        queued = QueuedPacket(packet)
        queued.at_s = self._hardware.seconds()
        self._hardware.send_packet(packet, self._client)
        return queued

    def receive(self, within_s: float) -> Packet | None:
        self._hardware.wait_for(within_s, lambda: bool(self._packets))
        return self._packets.popleft()[0] if self._packets else None

    def attach(self, wake: Callable[[], None]) -> None:
        self._wake = wake
        wake()

    def arrived(self) -> list[Arrived]:
        packets = list(self._packets)
        self._packets.clear()
        return packets

    def close(self) -> None:
        self._closed, self._wake = True, lambda: None
        self._hardware.forget(self._client)

    def deliver(self, datagram: bytes, arrived_s: float) -> None:
        packet = decode_packet(datagram)
        if packet is not None and not self._closed:
            self.received_s = arrived_s
            self._packets.append((packet, arrived_s))
            self._wake()

    def fail(self) -> None:
        if not self.fault:
            self.fault = f"{self.uri}: the link was closed."
            self._wake()

    def _echo(self) -> None:
        if not self._closed and not self.fault:
            self._hardware.later(_ECHO_EVERY_S, self._echo)
            self._hardware.send_packet(_ECHO, self._client)
