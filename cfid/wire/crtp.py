"""Encodes and decodes CRTP, the Crazyflie's packets: a header byte with port and channel, then up to 30 bytes.

Numbers are little-endian. This module covers what cfid itself exchanges with the stock ports: echo, parameters and
logging. The vehicle's tables have the numbers of parameters and variables. The thesis' three services are in `app`.
"""

import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

from cfid.wire.layout import Layout

LONGEST_PAYLOAD = 30

ECHO_PORT, ECHO_CHANNEL = 15, 0

PARAMETER_PORT = 2
READ_CHANNEL, WRITE_CHANNEL, BY_NAME_CHANNEL = 1, 2, 3

LOG_PORT = 5
LOG_CONTROL_CHANNEL, LOG_DATA_CHANNEL = 1, 2
LONGEST_LOG_ROW = 26

TABLE_CHANNEL = 0  # of the ports of parameters and of the log
TABLE_INFO, _TABLE_ENTRY = b"\x03", b"\x02"  # with 16-bit numbers, since protocol version 4

RESET_LOG = b"\x05"  # deletes all blocks

_RESERVED = 3 << 2  # the link's own bits, set by whoever sends
_ECHO = Layout("<BQ", int, mark=(0xCF,))  # cflib's own ping begins with 0 and comes back on the same channel


class Packet(NamedTuple):
    """One packet of either direction."""

    port: int
    channel: int
    payload: bytes


class LogCommand(IntEnum):
    """Commands of the log's control channel."""

    DELETE = 2
    STOP = 4
    CREATE = 6
    START_MS = 8  # cflib knows only an older command, in tens of milliseconds


class Variable(NamedTuple):
    """An entry of the vehicle's tables: its number, and its type as a letter of Python's struct."""

    number: int
    kind: str


class TableInfo(NamedTuple):
    """How many entries a table has, and its checksum: equal ones are of equal tables."""

    size: int
    checksum: int


class LogAnswer(NamedTuple):
    """The result of a command about a log block; error 0 means success."""

    command: int
    block: int
    error: int


_PARAMETER_TYPES = {"b": 0, "h": 1, "i": 2, "f": 6, "B": 8, "H": 9, "I": 10}

_LOG_TYPES = {kind: number for number, kind in enumerate("BHIbhif", 1)} | {"e": 8}
_TYPES = {LOG_PORT: {number: kind for kind, number in _LOG_TYPES.items()}} | {
    PARAMETER_PORT: {number: kind for kind, number in _PARAMETER_TYPES.items()}
}
_TYPE_BITS = 0x0F  # of an entry's type; the others say that a parameter is only read, or stored
_LOG_ANSWER = Layout("<BBB", LogAnswer)
_INFO = struct.Struct("<xHI")
_ENTRY = struct.Struct("<xHB")

decode_echo = _ECHO.decode
decode_log_answer = _LOG_ANSWER.decode


def encode_packet(packet: Packet) -> bytes:
    """Return header and payload. Raises ValueError for a port above 15, a channel above 3 or a longer payload."""
    if not (0 <= packet.port <= 15 and 0 <= packet.channel <= 3 and len(packet.payload) <= LONGEST_PAYLOAD):
        raise ValueError(f"no CRTP packet: {packet}")
    return bytes([packet.port << 4 | _RESERVED | packet.channel]) + packet.payload


def decode_packet(datagram: bytes) -> Packet | None:
    """Return the packet in a datagram, or None when it is not one; the two reserved bits may have any value."""
    if not 1 <= len(datagram) <= 1 + LONGEST_PAYLOAD:
        return None
    return Packet(datagram[0] >> 4, datagram[0] & 3, bytes(datagram[1:]))


def decode_table_info(payload: bytes) -> TableInfo | None:
    """Return the answer to TABLE_INFO, None for any other payload; what firmware adds is left out."""
    is_info = payload[:1] == TABLE_INFO and len(payload) >= _INFO.size
    return TableInfo(*_INFO.unpack_from(payload)) if is_info else None


def encode_table_entry(number: int) -> bytes:
    """Return the request for an entry of a table."""
    return _TABLE_ENTRY + struct.pack("<H", number)


def decode_table_entry(port: int, payload: bytes) -> tuple[str, Variable] | None:
    """Return the name of an entry and its variable, whose type is "" where no request of cfid has it.

    Any other payload gives None.
    """
    if payload[:1] != _TABLE_ENTRY or len(payload) <= _ENTRY.size:
        return None
    number, kind = _ENTRY.unpack_from(payload)
    group, _, name = payload[_ENTRY.size :].rstrip(b"\0").partition(b"\0")
    return f"{group.decode('latin-1')}.{name.decode('latin-1')}", Variable(
        number, _TYPES[port].get(kind & _TYPE_BITS, "")
    )


def encode_echo(number: int) -> bytes:
    """Return a payload for the link's echo channel; it carries a number and differs from those of cflib."""
    return _ECHO.encode(number)


def encode_read_parameter(parameter: Variable) -> bytes:
    """Return the request for a parameter's value."""
    return struct.pack("<H", parameter.number)


def encode_write_parameter(parameter: Variable, value: float) -> bytes:
    """Return the request to set a parameter. Raises struct.error for a value that its type cannot hold."""
    return struct.pack(f"<H{parameter.kind}", parameter.number, value)


def decode_read_parameter(parameter: Variable, payload: bytes) -> float | None:
    """Return the value from the answer to a read of this parameter: its number, a zero, the value."""
    return Layout(f"<HB{parameter.kind}", lambda value: value, mark=(parameter.number, 0)).decode(payload)


def decode_write_parameter(parameter: Variable, payload: bytes) -> float | None:
    """Return the value from the answer to a write of this parameter: its number, then the value now in force."""
    return Layout(f"<H{parameter.kind}", lambda value: value, mark=(parameter.number,)).decode(payload)


def encode_set_by_name(name: str, kind: str, value: float) -> bytes:
    """Return the request to set a parameter by its name, such as `motorPowerSet.m1`, which needs no table."""
    return _by_name(name) + struct.pack(f"<B{kind}", _PARAMETER_TYPES[kind], value)


def decode_set_by_name(name: str, payload: bytes) -> int | None:
    """Return the error number that answers a set by name: 0 for success, ENOENT where the parameter does not exist."""
    begin = _by_name(name)
    return payload[-1] if payload.startswith(begin) and len(payload) == len(begin) + 1 else None


def _by_name(name: str) -> bytes:
    return b"\0" + name.replace(".", "\0").encode() + b"\0"  # the first zero is the command


def encode_create_log(block: int, variables: Sequence[Variable]) -> bytes:
    """Return the request to create a log block of at most nine variables and 26 bytes of values."""
    types = [_LOG_TYPES[variable.kind] for variable in variables]
    entries = [struct.pack("<BH", kind | kind << 4, v.number) for kind, v in zip(types, variables, strict=True)]
    return bytes([LogCommand.CREATE, block]) + b"".join(entries)


def encode_start_log(block: int, period_ms: int) -> bytes:
    """Return the request to send a block every `period_ms` milliseconds."""
    return struct.pack("<BBH", LogCommand.START_MS, block, period_ms)


def encode_stop_log(block: int) -> bytes:
    """Return the request to stop sending a block."""
    return bytes([LogCommand.STOP, block])


def encode_delete_log(block: int) -> bytes:
    """Return the request to delete a block; its number can then be used again."""
    return bytes([LogCommand.DELETE, block])


def decode_log_row(block: int, variables: Sequence[Variable], payload: bytes) -> tuple[int, tuple[float, ...]] | None:
    """Return the vehicle's milliseconds (24 bits, wrapping) and the values in a row of this block."""
    kinds = "".join(variable.kind for variable in variables)
    row = Layout(f"<B3s{kinds}", lambda stamp, *values: (int.from_bytes(stamp, "little"), values), mark=(block,))
    return row.decode(payload)
