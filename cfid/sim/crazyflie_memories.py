"""Simulates the memory port of a vehicle without decks: lists, reads and writes its memories."""

import errno
import struct
from collections.abc import Callable
from typing import NamedTuple

_COUNT, _INFO = 1, 2
_INFO_CHANNEL, _READ_CHANNEL, _WRITE_CHANNEL = range(3)
_PLACE = struct.Struct("<BI")  # memory and address, of reading and writing
_SERIAL_BYTES = 8
_LONGEST = 24  # read at once


class AbsentMemoryError(Exception):
    """A request for a memory that does not exist, on which the firmware fails an assertion."""


class _Memory(NamedTuple):
    """A kind, a size in bytes, and the function that reads an address."""

    kind: int
    size: int
    read: Callable[[int], int]


# Trajectories of the high-level commander, none of them set, and the memory tester, which returns each address.
_MEMORIES = (_Memory(0x12, 4096, lambda address: 0), _Memory(0x15, 4096, lambda address: address & 0xFF))


def answer_memory(channel: int, payload: bytes) -> bytes | None:
    """Return the answer on the same channel, None for none. Raises AbsentMemoryError."""
    if channel == _INFO_CHANNEL and payload[:1] == bytes([_COUNT]):
        return bytes([_COUNT, len(_MEMORIES)])
    if channel == _INFO_CHANNEL and payload[:1] == bytes([_INFO]):
        memory = _memory(payload[1:2])
        return payload[:2].ljust(2, b"\0") + struct.pack("<BI", memory.kind, memory.size) + bytes(_SERIAL_BYTES)
    if channel not in (_READ_CHANNEL, _WRITE_CHANNEL) or len(payload) <= _PLACE.size:
        return None
    memory = _memory(payload)
    if channel == _WRITE_CHANNEL:
        return payload[: _PLACE.size] + b"\0"  # nothing here reads it again
    address, count = _PLACE.unpack_from(payload)[1], payload[_PLACE.size]
    within = address + count <= memory.size and count <= _LONGEST
    found = bytes(memory.read(address + offset) for offset in range(count)) if within else b""
    return payload[: _PLACE.size] + bytes([0 if within else errno.EIO]) + found


def _memory(payload: bytes) -> _Memory:
    number = payload[0] if payload else 0
    if number >= len(_MEMORIES):
        raise AbsentMemoryError(f"memory {number} of {len(_MEMORIES)}")
    return _MEMORIES[number]
