"""Simulates the vehicle's log: blocks of variables that a client creates and starts, sent at a period."""

import errno
import math
import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple

from cfid.sim.crazyflie_toc import TOC_CHANNEL, Entry, Toc
from cfid.wire.crtp import LOG_CONTROL_CHANNEL, LONGEST_LOG_ROW

_MOST_BLOCKS, _MOST_VARIABLES = 16, 128  # the latter in all blocks together
_DELETE, _START, _STOP, _RESET, _CREATE, _APPEND, _START_MS = 2, 3, 4, 5, 6, 7, 8
_OF_A_BLOCK = (_DELETE, _START, _STOP, _CREATE, _APPEND, _START_MS)
_START_UNIT_MS = 10  # of the older command
_KINDS = dict(enumerate("BHIbhife", 1))
_CODES = {kind: code for code, kind in _KINDS.items()}
_ENTRY = struct.Struct("<BH")  # of a block: types of storage and transmission, number in the table
_STAMP_BYTES = 3
_LARGEST_HALF = 65504.0


class LoggedVariable(NamedTuple):
    """A name, a type as a letter of Python's struct, and the function that reads its value."""

    name: str
    kind: str
    read: Callable[[], float]


_MEMORY = 0xFFFF  # as a number: an address in memory instead of a variable, which the firmware does not check
_IN_MEMORY = LoggedVariable("memory", "I", lambda: 0)


class _Block:
    """Variables, each with the type it is sent as; `period_ms` is None while the block is not started."""

    def __init__(self) -> None:
        self.entries: list[tuple[str, LoggedVariable]] = []
        self.period_ms: int | None = None
        self.next_ms = 0

    @property
    def size(self) -> int:
        return sum(struct.calcsize(kind) for kind, _ in self.entries)


class Log:
    """The log's blocks, and the answers of the log port."""

    def __init__(self, variables: Sequence[LoggedVariable]) -> None:
        """Start without a block."""
        self._variables = variables
        limits = bytes([_MOST_BLOCKS, _MOST_VARIABLES])
        self._toc = Toc([Entry(variable.name, _CODES[variable.kind]) for variable in variables], tail=limits)
        self._blocks: dict[int, _Block] = {}

    @property
    def streaming(self) -> bool:
        """Whether a block is started."""
        return any(block.period_ms is not None for block in self._blocks.values())

    def reset(self) -> None:
        """Delete all blocks."""
        self._blocks.clear()

    def answer(self, channel: int, payload: bytes, now_ms: int) -> bytes | None:
        """Return the answer on the same channel, None for none: command, block, and an error or 0."""
        if channel == TOC_CHANNEL:
            return self._toc.answer(payload)
        if channel != LOG_CONTROL_CHANNEL:
            return None
        command, number = payload[:2].ljust(2, b"\0")
        return bytes([command, number, self._execute(command, number, payload[2:], now_ms)])

    def due(self, now_ms: int) -> list[bytes]:
        """Return the rows of all blocks whose time has come: block, a stamp of 24 bits, and the values."""
        rows = []
        for number, block in self._blocks.items():
            if block.period_ms is not None and block.next_ms <= now_ms:
                stamp = (now_ms % (1 << 8 * _STAMP_BYTES)).to_bytes(_STAMP_BYTES, "little")
                values = b"".join(_packed(kind, variable.read()) for kind, variable in block.entries)
                rows.append(bytes([number]) + stamp + values)
                block.next_ms += block.period_ms
                block.period_ms = block.period_ms or None  # a period of zero sends one row
        return rows

    def _execute(self, command: int, number: int, arguments: bytes, now_ms: int) -> int:
        if command == _RESET:
            self.reset()
            return 0
        if command not in _OF_A_BLOCK:
            return errno.ENOEXEC
        if command == _CREATE:
            if number in self._blocks:
                return errno.EEXIST
            if len(self._blocks) == _MOST_BLOCKS:
                return errno.ENOMEM
            self._blocks[number] = _Block()
        if number not in self._blocks:
            return errno.ENOENT
        return self._execute_on_block(command, number, arguments, now_ms)

    def _execute_on_block(self, command: int, number: int, arguments: bytes, now_ms: int) -> int:
        block = self._blocks[number]
        if command in (_CREATE, _APPEND):
            return self._append(block, arguments)
        if command == _DELETE:
            del self._blocks[number]
        elif command == _STOP:
            block.period_ms = None
        else:
            short, long = arguments[:1], arguments[:2]
            period_ms = int.from_bytes(long if command == _START_MS else short, "little")
            block.period_ms = period_ms * (_START_UNIT_MS if command == _START else 1)
            block.next_ms = now_ms + max(block.period_ms, 1)
        return 0

    def _append(self, block: _Block, arguments: bytes) -> int:
        """Append variables until one does not fit or does not exist; those before it stay, as on the vehicle."""
        for code, number in _ENTRY.iter_unpack(arguments[: len(arguments) // _ENTRY.size * _ENTRY.size]):
            kind = _KINDS.get(code & 0x0F)
            if kind is None or (number >= len(self._variables) and number != _MEMORY):
                return errno.ENOENT
            if block.size + struct.calcsize(kind) > LONGEST_LOG_ROW:
                return errno.E2BIG
            if sum(len(other.entries) for other in self._blocks.values()) == _MOST_VARIABLES:
                return errno.ENOMEM
            block.entries.append((kind, _IN_MEMORY if number == _MEMORY else self._variables[number]))
        return 0


def _packed(kind: str, value: float) -> bytes:
    """Return a value in the type that the client requested, truncated as in C."""
    if kind == "e" and abs(value) > _LARGEST_HALF:
        value = math.copysign(math.inf, value)
    if kind in "fe":
        return struct.pack("<" + kind, value)
    bits = 8 * struct.calcsize(kind)
    return (int(value) % (1 << bits)).to_bytes(bits // 8, "little")
