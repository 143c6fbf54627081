"""CRTP, the Crazyflie's packets: one header byte with port and channel, then up to 30 bytes; numbers little-endian.

Holds what cfid itself says on the stock ports. The thesis' three services are `app`'s; cflib speaks the rest.
"""

import struct
from typing import NamedTuple

LONGEST_PAYLOAD = 30

LINK_PORT, ECHO_CHANNEL = 15, 0
LOG_PORT, LOG_CONTROL_CHANNEL = 5, 1
START_MS_COMMAND = 8  # cflib knows only the older one, which counts in tens of milliseconds

_RESERVED = 3 << 2  # the link's own bits, set by whoever sends
_ECHO = struct.Struct("<BQ")
_START_MS = struct.Struct("<BBH")
_ECHO_MARK = 0xCF  # cflib's own ping begins with 0 and comes back on the same channel


class Packet(NamedTuple):
    """One packet of either direction."""

    port: int
    channel: int
    payload: bytes


def encode_packet(packet: Packet) -> bytes:
    """Return header and payload. Raises ValueError for a port above 15, a channel above 3 or a longer payload."""
    if not (0 <= packet.port <= 15 and 0 <= packet.channel <= 3 and len(packet.payload) <= LONGEST_PAYLOAD):
        raise ValueError(f"no CRTP packet: {packet}")
    return bytes([packet.port << 4 | _RESERVED | packet.channel]) + packet.payload


def decode_packet(datagram: bytes) -> Packet | None:
    """Return the packet of a datagram, None when it cannot be one; the two reserved bits are anybody's."""
    if not 1 <= len(datagram) <= 1 + LONGEST_PAYLOAD:
        return None
    return Packet(datagram[0] >> 4, datagram[0] & 3, bytes(datagram[1:]))


def encode_echo(number: int) -> bytes:
    """Return what the link's echo channel shall send back: unlike cflib's own, and told apart by its number."""
    return _ECHO.pack(_ECHO_MARK, number)


def decode_echo(payload: bytes) -> int | None:
    """Return the number of an echo of ours, None for anybody else's."""
    if len(payload) != _ECHO.size:
        return None
    mark, number = _ECHO.unpack(payload)
    return int(number) if mark == _ECHO_MARK else None


def encode_start_log(block: int, period_ms: int) -> bytes:
    """Return the request to send a log block every so many milliseconds."""
    return _START_MS.pack(START_MS_COMMAND, block, period_ms)
