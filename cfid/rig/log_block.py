"""Log blocks of a vehicle: created under a number that is free, and deleted; the error in every answer is read."""

import errno
from collections.abc import Sequence

from cfid.errors import DeviceError
from cfid.rig.vehicle import Vehicle
from cfid.wire import crtp
from cfid.wire.crtp import LOG_CONTROL_CHANNEL, LOG_DATA_CHANNEL, LOG_PORT, Packet, Variable

BATTERY = "pm.vbat"

_MOST_BLOCKS = 16  # that firmware keeps at the same time
_ANSWER_S = 0.1
_TRIES, _TRIES_TO_DELETE = 10, 3  # so that a block is created over a link that loses every fifth packet
_SINGLE_MS = 20
_ROW_S = 0.5


class LogBlock:
    """Variables that the vehicle logs under one number, which no earlier block on this link had."""

    def __init__(self, vehicle: Vehicle, names: Sequence[str]) -> None:
        """Take variables of 26 bytes at most. Raises DeviceError for one that the firmware does not have."""
        self.variables = [_variable(vehicle, name) for name in names]
        self._vehicle, self._names = vehicle, names
        self._number: int | None = None

    async def start(self, period_ms: int) -> None:
        """Create the block and begin its rows. Raises DeviceError when the vehicle refuses, or does not answer."""
        for _ in range(_MOST_BLOCKS + 1):
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
        if number is not None and not self._vehicle.wire.fault:
            for end in (crtp.encode_stop_log(number), crtp.encode_delete_log(number)):
                if await self._command(end, tries=_TRIES_TO_DELETE) is None:
                    return

    async def _command(self, payload: bytes, *, tries: int = _TRIES) -> int | None:
        """Return the error of the answer, 0 for success, None without an answer."""

        def error(answer: bytes) -> int | None:
            read = crtp.decode_log_answer(answer)
            return read.error if read and (read.command, read.block) == (payload[0], payload[1]) else None

        request = Packet(LOG_PORT, LOG_CONTROL_CHANNEL, payload)
        return await self._vehicle.ask(request, error, within_s=_ANSWER_S, tries=tries)

    def _check(self, error: int | None) -> None:
        if error != 0:
            reason = "no answer" if error is None else f"error {error}"
            raise DeviceError(f"{self._vehicle.uri}: the vehicle does not log {', '.join(self._names)}: {reason}.")


async def logged(vehicle: Vehicle, names: Sequence[str]) -> tuple[float, ...]:
    """Return the present values of log variables, all of one moment. Raises DeviceError when no row arrives."""
    block = LogBlock(vehicle, names)
    try:
        await block.start(_SINGLE_MS)
        row = await vehicle.next((LOG_PORT, LOG_DATA_CHANNEL), block.row, within_s=_ROW_S)
    finally:
        await block.delete()
    if row is None:
        raise DeviceError(f"{vehicle.uri}: the vehicle sent no row of {', '.join(names)} within {_ROW_S:g} s.")
    return row[0][1]


def _variable(vehicle: Vehicle, name: str) -> Variable:
    variable = vehicle.wire.variable(name)
    if variable is None:
        raise DeviceError(f"{vehicle.uri}: this firmware does not log {name}.")
    return variable
