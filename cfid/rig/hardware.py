"""The one seam to the hardware: clocks, serial ports, datagrams, pages and links to vehicles are opened here alone.

`Real` opens those of this computer. `cfid.sim.virtual` is the other implementation: simulated devices, on a clock that
passes as fast as the program computes.
"""

import contextlib
import http.client
import math
import signal
import socket
import time
import urllib.error
import urllib.request
from abc import ABC, abstractmethod
from collections.abc import Callable, Coroutine, Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from cfid.errors import DeviceError
from cfid.records.rig_file import Devices, Rig
from cfid.rig import sim_file
from cfid.rig.clock import Array, ahead_s
from cfid.rig.link import Link, open_link

if TYPE_CHECKING:  # Twisted takes longer to load than a stop of the motors
    from twisted.internet.base import DelayedCall
    from twisted.internet.defer import Deferred

    from cfid.rig.loop import Ending, Loop

Result = TypeVar("Result")
Address = tuple[str, int]
TakeDatagram = Callable[[bytes, Address, float], None]  # a datagram, its source, and when it arrived

_PAGE_S = 3.0  # without a byte


class SerialPort(Protocol):
    """An open serial port, or the serial bytes of a USB bridge."""

    def write(self, data: bytes) -> None:
        """Send."""

    def close(self) -> None:
        """Send waiting bytes and close; nothing is received afterwards."""


class Receiver(Protocol):
    """Takes the data of an open port."""

    def received(self, data: bytes) -> None:
        """Take received bytes."""

    def disconnected(self) -> None:
        """Note that the port is gone."""


class DatagramPort(Protocol):
    """A UDP port that talks to one address."""

    buffer_bytes: int  # of the receive buffer that the system granted
    overflowed: int  # datagrams that this computer dropped because that buffer was full, where the system reports it

    def send(self, datagram: bytes) -> None:
        """Send; if the address cannot be reached, its silence shows that."""

    def drain(self) -> None:
        """Take all datagrams that wait."""

    def close(self) -> None:
        """Close the port."""


class Hardware(ABC):
    """Everything that a program can open or wait for.

    `unix_less_monotonic_s` is measured once, when `run` begins. Inside `run`, coroutines wait by `sleep` and `later`;
    outside, code that has no loop waits by `pause`.
    """

    unix_less_monotonic_s: float

    def __init__(self) -> None:
        """Start with a program that has not stood still."""
        self._stood_s, self._looked_s = 0.0, math.inf

    @abstractmethod
    def seconds(self) -> float:
        """Return the time on the monotonic clock."""

    def unix_s(self) -> float:
        """Return the Unix time."""
        return self.seconds() + self.unix_less_monotonic_s

    def unix_times_s(self, monotonic_s: Array) -> Array:
        """Return the Unix times of instants on the monotonic clock, which steps of the wall clock do not shift."""
        return monotonic_s + self.unix_less_monotonic_s

    @abstractmethod
    def suspended_s(self) -> float:
        """Return how long the computer has been suspended since its start."""

    def awake_s(self) -> float:
        """Return the time on a clock that stands while this program does not run: suspended, or kept waiting.

        What a device sent then waits in the system. It has to be called often, as a recording does.
        """
        now_s = self.seconds()
        self._stood_s += max(now_s - self._looked_s - 0.2, 0.0)  # a recording looks every 0.05 s
        self._looked_s = now_s
        return now_s - self._stood_s

    @abstractmethod
    def pause(self, seconds: float) -> None:
        """Wait outside a loop."""

    @abstractmethod
    def run(self, main: "Callable[[Ending], Coroutine[Any, Any, Result]]") -> Result:
        """Run a coroutine to its end, and return its result or raise what it raised; signals request the end."""

    @abstractmethod
    def hang_up(self) -> None:
        """Signal this program that its terminal was closed."""

    @abstractmethod
    def later(self, delay_s: float, call: Callable[..., object], *arguments: Any) -> "DelayedCall":
        """Call something after a delay."""

    @abstractmethod
    def soon(self, call: Callable[..., object], *arguments: Any) -> None:
        """Call something in the loop, from any thread."""

    def sleep(self, seconds: float) -> "Deferred[None]":
        """Return a Deferred that fires after some seconds."""
        from twisted.internet.defer import Deferred

        slept: Deferred[None] = Deferred(lambda _: timer.cancel())
        timer = self.later(seconds, lambda: slept.callback(None))
        return slept

    @abstractmethod
    def in_thread(self, work: Callable[[], object]) -> "Deferred[object]":
        """Do something slow beside the loop."""

    @abstractmethod
    def add_reader(self, reader: Any) -> None:
        """Call `reader.doRead` whenever its `fileno` can be read."""

    @abstractmethod
    def remove_reader(self, reader: Any) -> None:
        """End that."""

    @abstractmethod
    def devices(self, folder: Path, rig: Rig) -> tuple[Devices, bool]:
        """Return the addresses of a campaign's devices, and whether they are simulated. Raises ConfigError."""

    @abstractmethod
    def serial_ports(self) -> list[tuple[str, str]]:
        """Return all serial ports, each with the name that its device gives itself."""

    @abstractmethod
    def has_port(self, path: str) -> bool:
        """Return whether there is a serial port, or a hidraw device, at a path."""

    @abstractmethod
    def serial(self, path: str, receiver: Receiver, *, baud: int) -> SerialPort:
        """Open a serial port, 8N1. Raises DeviceError naming why it cannot be opened."""

    @abstractmethod
    def hid_nodes(self, vendor: int, product: int) -> list[str]:
        """Return the hidraw devices of a kind, which exist on Linux only."""

    @abstractmethod
    def hid(self, path: str, receiver: Receiver, *, usb_id: tuple[int, int], feature: bytes) -> SerialPort:
        """Open a hidraw device after a feature report; each report is received as it is.

        Raises DeviceError, which states how a user gets the permission for a device of this vendor and product.
        """

    @abstractmethod
    def host(self, name: str) -> str:
        """Return the numeric address of a host, "" where there is none."""

    @abstractmethod
    def datagrams(self, address: Address, take: TakeDatagram) -> DatagramPort:
        """Open a UDP port to talk to an address, in the loop. `take` gets what arrives, from any source."""

    @abstractmethod
    def page(self, address: Address, path: str) -> tuple[int, str]:
        """Return status and text of a page over HTTP. Raises DeviceError where nothing answers."""

    @abstractmethod
    def exchange(self, address: Address, request: bytes, size: int) -> bytes:
        """Return the answer of `size` bytes over TCP, shorter where the other side ends it. Raises DeviceError."""

    @abstractmethod
    def link(self, uri: str) -> Link:
        """Open the link to a vehicle, without its tables. Raises DeviceError."""

    @abstractmethod
    def find_vehicle(self) -> str:
        """Return the address of the only vehicle that a radio or a USB cable reaches. Raises DeviceError."""


class Real(Hardware):
    """The hardware of this computer."""

    def __init__(self) -> None:
        """Open nothing yet."""
        super().__init__()
        self.unix_less_monotonic_s = ahead_s(time.time)
        self._loop: Loop | None = None

    @property
    def loop(self) -> "Loop":
        """The loop of the run under way."""
        assert self._loop is not None, "nothing runs"
        return self._loop

    def seconds(self) -> float:
        """Return the time on the monotonic clock."""
        return time.monotonic()

    def suspended_s(self) -> float:
        """Return how long the computer has been suspended since its start, 0 where the system does not report it."""
        boot_clock = getattr(time, "CLOCK_BOOTTIME", None)
        return 0.0 if boot_clock is None else ahead_s(lambda: time.clock_gettime(boot_clock))

    def pause(self, seconds: float) -> None:
        """Wait outside a loop."""
        time.sleep(seconds)

    def run(self, main: "Callable[[Ending], Coroutine[Any, Any, Result]]") -> Result:
        """Run a coroutine in a loop of its own; signals only request the end."""
        from cfid.rig.loop import run_until_done

        async def run_in(loop: "Loop", ending: "Ending") -> Result:
            self._loop, self.unix_less_monotonic_s = loop, ahead_s(time.time)
            return await main(ending)

        try:
            return run_until_done(run_in)
        finally:
            self._loop = None

    def hang_up(self) -> None:
        """Signal this process as the kernel signals the terminal's own session."""
        signal.raise_signal(signal.SIGHUP)

    def later(self, delay_s: float, call: Callable[..., object], *arguments: Any) -> "DelayedCall":
        """Call something after a delay."""
        return self.loop.callLater(delay_s, call, *arguments)

    def soon(self, call: Callable[..., object], *arguments: Any) -> None:
        """Call something in the loop, from any thread; after its end, nothing."""
        if self._loop is not None:
            self._loop.callFromThread(call, *arguments)

    def in_thread(self, work: Callable[[], object]) -> "Deferred[object]":
        """Do something slow on another thread."""
        from twisted.internet.threads import deferToThreadPool

        return deferToThreadPool(self.loop, self.loop.getThreadPool(), work)

    def add_reader(self, reader: Any) -> None:
        """Call `reader.doRead` whenever its `fileno` can be read."""
        self.loop.addReader(reader)

    def remove_reader(self, reader: Any) -> None:
        """End that."""
        self.loop.removeReader(reader)

    def devices(self, folder: Path, rig: Rig) -> tuple[Devices, bool]:
        """Return rig.toml's devices, or those of the simulated rig that serves the campaign."""
        return sim_file.devices_in(folder, rig)

    def serial_ports(self) -> list[tuple[str, str]]:
        """Return all serial ports, each with the name that its device gives itself."""
        from serial.tools import list_ports

        return [(info.device, info.product or info.description or "") for info in list_ports.comports()]

    def has_port(self, path: str) -> bool:
        """Return whether something is at a path."""
        return Path(path).exists()

    def serial(self, path: str, receiver: Receiver, *, baud: int) -> SerialPort:
        """Open a serial port that no other program may open meanwhile."""
        from cfid.rig.ports import open_serial

        return open_serial(self, path, receiver, baud=baud)

    def hid_nodes(self, vendor: int, product: int) -> list[str]:
        """Return the hidraw devices of a kind."""
        from cfid.rig.ports import hid_nodes

        return hid_nodes(vendor, product)

    def hid(self, path: str, receiver: Receiver, *, usb_id: tuple[int, int], feature: bytes) -> SerialPort:
        """Open a hidraw device."""
        from cfid.rig.ports import HidPort

        return HidPort(self, path, receiver, usb_id=usb_id, feature=feature)

    def host(self, name: str) -> str:
        """Return the numeric address of a host."""
        try:
            return socket.gethostbyname(name) if name else ""
        except (OSError, UnicodeError):  # UnicodeError: not a name at all
            return ""

    def datagrams(self, address: Address, take: TakeDatagram) -> DatagramPort:
        """Open a UDP port with a large buffer and the kernel's stamps."""
        from cfid.rig.ports import StampedPort

        return StampedPort.opened(self.loop, address, take)

    def page(self, address: Address, path: str) -> tuple[int, str]:
        """Return a page over HTTP."""
        where = "http://{}:{}".format(*address)
        try:
            with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(
                f"{where}{path}", timeout=_PAGE_S
            ) as answer:
                return answer.status, answer.read(1 << 18).decode("utf-8", "replace")
        except urllib.error.HTTPError as error:
            return error.code, ""
        except (OSError, ValueError, http.client.HTTPException) as error:
            cause = error.reason if isinstance(error, urllib.error.URLError) else error
            raise DeviceError(
                f"{where}: {_reason(cause)}. Is the box powered, and this computer in its network? "
                "See `cfid rig check`."
            ) from None

    def exchange(self, address: Address, request: bytes, size: int) -> bytes:
        """Return the answer to a request over TCP."""
        answer = b""
        try:
            with socket.create_connection(address, timeout=_PAGE_S) as connection:
                connection.sendall(request)
                while len(answer) < size and (part := connection.recv(size - len(answer))):
                    answer += part
        except OSError as error:
            raise DeviceError("{} TCP {}: {}.".format(*address, _reason(error))) from None
        return answer

    def link(self, uri: str) -> Link:
        """Open the link to a vehicle."""
        return open_link(uri)

    def find_vehicle(self) -> str:
        """Return the address of the only vehicle that a radio or a USB cable reaches."""
        from cfid.rig.radio import find_vehicle  # cflib

        return find_vehicle()


_in_use: ContextVar[Hardware | None] = ContextVar("hardware", default=None)


def present() -> Hardware:
    """Return the hardware that commands use: this computer's, unless `in_place` put another there."""
    return _in_use.get() or Real()


@contextlib.contextmanager
def in_place(hardware: Hardware) -> Iterator[None]:
    """Let commands use other hardware, as the demo and tests do."""
    token = _in_use.set(hardware)
    try:
        yield
    finally:
        _in_use.reset(token)


def _reason(error: object) -> str:
    if isinstance(error, TimeoutError):
        return f"no answer within {_PAGE_S:g} s"
    if isinstance(error, ConnectionRefusedError):
        return "no program listens there (connection refused)"
    if isinstance(error, http.client.HTTPException | ValueError) and not isinstance(error, OSError):
        return "the device that answers there does not speak HTTP: it is another one"
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
