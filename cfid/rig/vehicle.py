"""Sends requests to a vehicle over an open link, awaits the answers, and monitors the link.

Log blocks are created under a number that is free, and deleted; the error in every answer is read.
"""

import errno
from collections import defaultdict
from collections.abc import Callable, Coroutine, Sequence
from typing import Any, TypeVar

from twisted.internet.defer import Deferred

from cfid.errors import DeviceError
from cfid.rig.hardware import Hardware
from cfid.rig.link import Link
from cfid.rig.loop import Ending
from cfid.wire import crtp
from cfid.wire.crtp import (
    LOG_CONTROL_CHANNEL,
    LOG_DATA_CHANNEL,
    LOG_PORT,
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

BATTERY = "pm.vbat"

ANSWER_S = 0.15
TRIES = 3

_LOG_TRIES = 10  # so that a block is created over a link that loses every fifth packet
_ROW_S = 0.5

_FIRST_BLOCK, _BLOCKS = 128, 128  # numbers of log blocks; clients that use cflib number theirs from 1


class Vehicle:
    """The vehicle for procedures and instruments."""

    def __init__(self, link: Link, hardware: Hardware) -> None:
        """Take an open link, and its packets from now on."""
        self.link, self.hardware = link, hardware
        self._handlers: dict[Place, list[Handler]] = defaultdict(list)
        self._blocks = 0
        # The least and the largest command that this program lets each motor obey; None while commands change.
        self.expected: tuple[Sequence[int], Sequence[int]] | None = ((0, 0, 0, 0), (0, 0, 0, 0))
        self._heard_s = self._heard_awake_s = 0.0  # when the last packet arrived, and then on the awake clock
        self.begin()

    def begin(self) -> None:
        """Take the packets that arrive from now on, in the run that begins."""
        self.link.arrived()  # drops earlier packets
        self._woken = False
        self._heard_awake_s = self.hardware.awake_s()
        self.link.attach(self._wake)

    @property
    def uri(self) -> str:
        """The vehicle's address."""
        return self.link.uri

    def new_block(self) -> int:
        """Return a number for a log block, another one at each call."""
        self._blocks += 1
        return _FIRST_BLOCK + self._blocks % _BLOCKS

    def listen(self, port: int, channel: int, handle: Handler) -> None:
        """Call `handle` with payload and monotonic time of every packet that arrives there."""
        self._handlers[port, channel].append(handle)

    def ignore(self, port: int, channel: int, handle: Handler) -> None:
        """End that."""
        handlers = self._handlers[port, channel]
        if handle in handlers:
            handlers.remove(handle)

    def send(self, port: int, channel: int, payload: bytes) -> None:
        """Send a packet. Raises DeviceError when the link is gone."""
        self.link.send(Packet(port, channel, payload))

    def check(self) -> None:
        """Raise DeviceError when the link failed or no packet arrives any more. Call it with every block of rows."""
        if self.link.fault:
            raise DeviceError(self.link.fault)
        if self.link.received_s != self._heard_s:
            self._heard_s, self._heard_awake_s = self.link.received_s, self.hardware.awake_s()
        silent_s = self.hardware.awake_s() - self._heard_awake_s
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
            self.link.send(request)
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
        departure = self.link.send(request)
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

        timer = self.hardware.later(within_s, over)
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
            self.hardware.soon(self._dispatch)

    def _dispatch(self) -> None:
        self._woken = False
        for packet, arrived_s in self.link.arrived():
            for handle in tuple(self._handlers[packet.port, packet.channel]):
                handle(packet.payload, arrived_s)


class LogBlock:
    """Variables that the vehicle logs under one number, which no earlier block on this link had."""

    def __init__(self, vehicle: Vehicle, names: Sequence[str]) -> None:
        """Take variables of 26 bytes at most. Raises DeviceError for one that the firmware does not have."""
        self.variables = [_variable(vehicle, name) for name in names]
        self._vehicle, self._names = vehicle, names
        self._number: int | None = None

    async def start(self, period_ms: int) -> None:
        """Create the block and begin its rows. Raises DeviceError when the vehicle refuses, or does not answer."""
        # Firmware keeps sixteen blocks at the same time.
        for _ in range(17):
            number = self._vehicle.new_block()
            error = await self._command(crtp.encode_create_log(number, self.variables))
            if error != errno.EEXIST:  # of another program, or created by a request whose answer was lost
                break
        self._number = None if error == errno.EEXIST else number
        self._check(error)
        self._check(await self._command(crtp.encode_start_log(number, period_ms)))

    def row(self, payload: bytes) -> tuple[int, tuple[float, ...]] | None:
        """Return the vehicle's milliseconds and the values in a row of this block, None for any other payload."""
        return None if self._number is None else crtp.decode_log_row(self._number, self.variables, payload)

    def is_row(self, payload: bytes) -> bool:
        """Return whether a payload names this block, whatever its length."""
        return self._number is not None and payload[:1] == bytes([self._number])

    async def delete(self) -> None:
        """End the rows and delete the block, and wait for both answers.

        A block that the vehicle did not delete does no harm: its number is not used again before the next connection,
        which deletes all blocks.
        """
        number, self._number = self._number, None
        if number is not None and not self._vehicle.link.fault:
            for end in (crtp.encode_stop_log(number), crtp.encode_delete_log(number)):
                if await self._command(end, tries=3) is None:
                    return

    async def _command(self, payload: bytes, *, tries: int = _LOG_TRIES) -> int | None:
        """Return the error of the answer, 0 for success, None without an answer."""

        def error(answer: bytes) -> int | None:
            read = crtp.decode_log_answer(answer)
            return read.error if read and (read.command, read.block) == (payload[0], payload[1]) else None

        request = Packet(LOG_PORT, LOG_CONTROL_CHANNEL, payload)
        return await self._vehicle.ask(request, error, within_s=0.1, tries=tries)

    def _check(self, error: int | None) -> None:
        if error != 0:
            reason = "no answer" if error is None else f"error {error}"
            raise DeviceError(f"{self._vehicle.uri}: the vehicle does not log {', '.join(self._names)}: {reason}.")


async def logged(vehicle: Vehicle, names: Sequence[str]) -> tuple[float, ...]:
    """Return the present values of log variables, all of one moment. Raises DeviceError when no row arrives."""
    block = LogBlock(vehicle, names)
    try:
        await block.start(20)
        row = await vehicle.next((LOG_PORT, LOG_DATA_CHANNEL), block.row, within_s=_ROW_S)
    finally:
        await block.delete()
    if row is None:
        raise DeviceError(f"{vehicle.uri}: the vehicle sent no row of {', '.join(names)} within {_ROW_S:g} s.")
    return row[0][1]


def _variable(vehicle: Vehicle, name: str) -> Variable:
    variable = vehicle.link.variable(name)
    if variable is None:
        raise DeviceError(f"{vehicle.uri}: this firmware does not log {name}.")
    return variable


def asked(vehicle: Vehicle, question: Callable[[Vehicle], Coroutine[Any, Any, Answer]]) -> Answer:
    """Return the answer to a question to a vehicle, outside a recording.

    Raises KeyboardInterrupt when a signal arrived meanwhile, and what the question raises.
    """

    async def main(ending: Ending) -> Answer:
        vehicle.begin()
        answer = await question(vehicle)
        if ending.signal:
            raise KeyboardInterrupt
        return answer

    return vehicle.hardware.run(main)
