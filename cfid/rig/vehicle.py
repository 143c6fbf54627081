"""A vehicle in a loop: requests and their answers over an open link, and a watch over the link itself."""

from collections import defaultdict
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

from twisted.internet.defer import Deferred

from cfid.errors import DeviceError
from cfid.wire.crtp import (
    PARAMETER_PORT,
    WRITE_CHANNEL,
    Packet,
    Variable,
    decode_write_parameter,
    encode_write_parameter,
)

Answer = TypeVar("Answer")
Hear = Callable[[bytes, float], None]
Place = tuple[int, int]  # port and channel

SILENT_S = 0.5  # cflib pings ten times a second: five answers in a row are missing then

ANSWER_S = 0.15
TRIES = 3


class Departure(Protocol):
    """When a packet left, on the monotonic clock; None while it has not."""

    at_s: float | None


class Wire(Protocol):
    """An open link, as `crazyflie.Link` is one."""

    uri: str
    fault: str
    heard_s: float

    def send(self, packet: Packet) -> "Departure":
        """Send a packet without waiting. Raises DeviceError when the link is gone."""

    def attach(self, wake: Callable[[], None]) -> None:
        """Call `wake` from any thread when packets have come."""

    def arrived(self) -> list[tuple[Packet, float]]:
        """Return the packets that came, with their times on the monotonic clock."""

    def variable(self, name: str) -> Variable | None:
        """Return a log variable."""

    def parameter(self, name: str) -> Variable | None:
        """Return a parameter."""


class Vehicle:
    """What procedures and instruments talk to; `loop` is Twisted's."""

    def __init__(self, wire: Wire, *, loop: Any) -> None:
        """Take an open link; its packets are heard from now on."""
        self.wire, self.loop = wire, loop
        self._hearing: dict[Place, list[Hear]] = defaultdict(list)
        self._woken = False
        wire.arrived()  # what came before belongs to nobody here
        wire.attach(self._wake)

    @property
    def uri(self) -> str:
        """Where the vehicle is."""
        return self.wire.uri

    def listen(self, port: int, channel: int, hear: Hear) -> None:
        """Call `hear` with payload and monotonic time of every packet that comes there."""
        self._hearing[port, channel].append(hear)

    def send(self, port: int, channel: int, payload: bytes) -> None:
        """Send a packet. Raises DeviceError when the link is gone."""
        self.wire.send(Packet(port, channel, payload))

    def check(self) -> None:
        """Raise DeviceError when the link failed or nothing comes any more."""
        if self.wire.fault:
            raise DeviceError(self.wire.fault)
        silent_s = self.loop.seconds() - self.wire.heard_s
        if silent_s > SILENT_S:
            raise DeviceError(f"{self.uri}: the link was lost: nothing came for {silent_s:.1f} s.")

    async def ask(
        self,
        request: Packet,
        read: Callable[[bytes], Answer | None],
        *,
        channel: int | None = None,
        within_s: float = ANSWER_S,
        tries: int = TRIES,
    ) -> Answer | None:
        """Send a request until a payload comes back for which `read` returns something; None when none does.

        The answer is expected on the request's port, on its channel unless another is given. Raises DeviceError
        when the link is gone.
        """
        place = (request.port, request.channel if channel is None else channel)
        for _ in range(tries):
            self.wire.send(request)
            came = await self._next(place, read, within_s)
            if came is not None:
                return came[0]
        return None

    async def write_parameter(
        self, parameter: Variable, value: int, *, within_s: float = ANSWER_S, tries: int = TRIES
    ) -> None:
        """Write a parameter, until the vehicle repeats the value. Raises DeviceError when it does not.

        Not through cflib, whose queue stops for ever where one answer is lost.
        """

        def written(payload: bytes) -> bool | None:
            return decode_write_parameter(parameter, payload) == value or None

        request = Packet(PARAMETER_PORT, WRITE_CHANNEL, encode_write_parameter(parameter, value))
        if not await self.ask(request, written, within_s=within_s, tries=tries):
            raise DeviceError(f"{self.uri}: the vehicle does not take a parameter.")

    async def times_of_answer(
        self, request: Packet, read: Callable[[bytes], bool | None], *, within_s: float
    ) -> tuple[float, float] | None:
        """Send a request once and return when it left and when its answer came, None without an answer."""
        departure = self.wire.send(request)
        came = await self._next((request.port, request.channel), read, within_s)
        return None if came is None or departure.at_s is None else (departure.at_s, came[1])

    async def _next(
        self, place: Place, read: Callable[[bytes], Answer | None], within_s: float
    ) -> tuple[Answer, float] | None:
        came: Deferred[tuple[Answer, float] | None] = Deferred()

        def hear(payload: bytes, arrived_s: float) -> None:
            answer = read(payload)
            if answer is not None and not came.called:
                came.callback((answer, arrived_s))

        def over() -> None:
            if not came.called:
                came.callback(None)

        timer = self.loop.callLater(within_s, over)
        self._hearing[place].append(hear)
        try:
            return await came
        finally:
            self._hearing[place].remove(hear)
            if timer.active():
                timer.cancel()

    def _wake(self) -> None:
        if not self._woken:
            self._woken = True
            self.loop.callFromThread(self._hear)

    def _hear(self) -> None:
        self._woken = False
        for packet, arrived_s in self.wire.arrived():
            for hear in tuple(self._hearing[packet.port, packet.channel]):
                hear(packet.payload, arrived_s)
