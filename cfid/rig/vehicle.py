"""Sends requests to a vehicle over an open link in a loop, awaits the answers, and monitors the link."""

from collections import defaultdict
from collections.abc import Callable, Coroutine, Sequence
from typing import Any, Protocol, TypeVar

from twisted.internet.defer import Deferred

from cfid.errors import DeviceError
from cfid.rig.loop import Ending, Loop, run_until_done
from cfid.rig.stalls import Stalls
from cfid.wire.crtp import (
    PARAMETER_PORT,
    READ_CHANNEL,
    WRITE_CHANNEL,
    Packet,
    Variable,
    decode_read_parameter,
    decode_write_parameter,
    encode_read_parameter,
    encode_write_parameter,
)

Answer = TypeVar("Answer")
Handler = Callable[[bytes, float], None]
Place = tuple[int, int]  # port and channel

SILENT_S = 0.5  # an open link asks for an echo ten times a second: five answers in a row are missing then

ANSWER_S = 0.15
TRIES = 3

_FIRST_BLOCK, _BLOCKS = 128, 128  # numbers of log blocks; clients that use cflib number theirs from 1


class Departure(Protocol):
    """When a packet left, on the monotonic clock; None while it has not."""

    at_s: float | None


class Wire(Protocol):
    """An open link, such as `link.Link`."""

    uri: str
    fault: str
    received_s: float

    @property
    def firmware_protocol(self) -> int:
        """The version of CRTP that the vehicle speaks."""

    def send(self, packet: Packet) -> Departure:
        """Send a packet without waiting. Raises DeviceError when the link is gone."""

    def attach(self, wake: Callable[[], None]) -> None:
        """Call `wake` from any thread when packets have arrived."""

    def arrived(self) -> list[tuple[Packet, float]]:
        """Return the packets that arrived, with their times on the monotonic clock."""

    def variable(self, name: str) -> Variable | None:
        """Return a log variable."""

    def parameter(self, name: str) -> Variable | None:
        """Return a parameter."""


class Vehicle:
    """The vehicle for procedures and instruments; `loop` is Twisted's."""

    def __init__(self, wire: Wire, *, loop: Any) -> None:
        """Take an open link, and its packets from now on."""
        self.wire, self.loop = wire, loop
        self._handlers: dict[Place, list[Handler]] = defaultdict(list)
        self._woken = False
        self._blocks = 0
        # The least and the largest command that this program lets each motor obey; None while commands change.
        self.expected: tuple[Sequence[int], Sequence[int]] | None = ((0, 0, 0, 0), (0, 0, 0, 0))
        self.stalls = Stalls(loop)
        wire.arrived()  # drops earlier packets
        wire.attach(self._wake)

    @property
    def uri(self) -> str:
        """The vehicle's address."""
        return self.wire.uri

    def new_block(self) -> int:
        """Return a number for a log block, another one at each call."""
        self._blocks += 1
        return _FIRST_BLOCK + self._blocks % _BLOCKS

    def listen(self, port: int, channel: int, handle: Handler) -> None:
        """Call `handle` with payload and monotonic time of every packet that arrives there."""
        self._handlers[port, channel].append(handle)

    def send(self, port: int, channel: int, payload: bytes) -> None:
        """Send a packet. Raises DeviceError when the link is gone."""
        self.wire.send(Packet(port, channel, payload))

    def silent_s(self, since_s: float) -> float:
        """Return how long nothing arrived since a time, without the stalls of this program, in which packets wait."""
        return float(self.loop.seconds() - since_s - self.stalls.since(since_s))

    def check(self) -> None:
        """Raise DeviceError when the link failed or no packet arrives any more. Call it with every block of rows."""
        self.stalls.note()
        if self.wire.fault:
            raise DeviceError(self.wire.fault)
        silent_s = self.silent_s(self.wire.received_s)
        if silent_s > SILENT_S:
            raise DeviceError(f"{self.uri}: the link was lost: no packet for {silent_s:.1f} s.")

    async def ask(
        self,
        request: Packet,
        read: Callable[[bytes], Answer | None],
        *,
        channel: int | None = None,
        within_s: float = ANSWER_S,
        tries: int = TRIES,
    ) -> Answer | None:
        """Send a request repeatedly until `read` returns an answer from an arriving payload; None when it never does.

        The answer is expected on the request's port, on its channel unless another is given. Raises DeviceError
        when the link is gone.
        """
        place = (request.port, request.channel if channel is None else channel)
        for _ in range(tries):
            self.wire.send(request)
            came = await self.next(place, read, within_s=within_s)
            if came is not None:
                return came[0]
        return None

    async def read_parameter(
        self, parameter: Variable, *, within_s: float = ANSWER_S, tries: int = TRIES
    ) -> float | None:
        """Return a parameter's value, None without an answer. Raises DeviceError when the link is gone."""
        request = Packet(PARAMETER_PORT, READ_CHANNEL, encode_read_parameter(parameter))
        return await self.ask(
            request, lambda payload: decode_read_parameter(parameter, payload), within_s=within_s, tries=tries
        )

    async def write_parameter(
        self, parameter: Variable, value: int, *, within_s: float = ANSWER_S, tries: int = TRIES
    ) -> None:
        """Write a parameter, until the vehicle repeats the value. Raises DeviceError when it does not."""

        def written(payload: bytes) -> bool | None:
            return decode_write_parameter(parameter, payload) == value or None

        request = Packet(PARAMETER_PORT, WRITE_CHANNEL, encode_write_parameter(parameter, value))
        if not await self.ask(request, written, within_s=within_s, tries=tries):
            raise DeviceError(f"{self.uri}: the vehicle did not confirm a parameter: the link loses packets.")

    async def times_of_answer(
        self, request: Packet, read: Callable[[bytes], bool | None], *, within_s: float
    ) -> tuple[float, float] | None:
        """Send a request once; return when it left and when its answer arrived, None without an answer."""
        departure = self.wire.send(request)
        came = await self.next((request.port, request.channel), read, within_s=within_s)
        return None if came is None or departure.at_s is None else (departure.at_s, came[1])

    async def next(
        self, place: Place, read: Callable[[bytes], Answer | None], *, within_s: float
    ) -> tuple[Answer, float] | None:
        """Return what `read` returns from a payload that arrives there, and when it arrived; None if none does."""
        came: Deferred[tuple[Answer, float] | None] = Deferred()

        def handle(payload: bytes, arrived_s: float) -> None:
            answer = read(payload)
            if answer is not None and not came.called:
                came.callback((answer, arrived_s))

        def over() -> None:
            if not came.called:
                came.callback(None)

        timer = self.loop.callLater(within_s, over)
        self._handlers[place].append(handle)
        try:
            return await came
        finally:
            self._handlers[place].remove(handle)
            if timer.active():
                timer.cancel()

    def _wake(self) -> None:
        if not self._woken:
            self._woken = True
            self.loop.callFromThread(self._dispatch)

    def _dispatch(self) -> None:
        self._woken = False
        for packet, arrived_s in self.wire.arrived():
            for handle in tuple(self._handlers[packet.port, packet.channel]):
                handle(packet.payload, arrived_s)


class OnALink:
    """What has no port or lock of its own to release."""

    def close(self) -> None:
        """Do nothing: the code that opened the link closes it."""


def asked(wire: Wire, question: Callable[[Vehicle], Coroutine[Any, Any, Answer]]) -> Answer:
    """Return the answer to a question to a vehicle, before a recording runs a loop.

    Raises KeyboardInterrupt when a signal arrived meanwhile, and what the question raises.
    """

    async def main(loop: Loop, ending: Ending) -> Answer:
        answer = await question(Vehicle(wire, loop=loop))
        if ending.signal:
            raise KeyboardInterrupt
        return answer

    return run_until_done(main)
