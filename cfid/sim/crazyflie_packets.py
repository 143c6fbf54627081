"""Puts the simulated Crazyflie's answers into packets, and answers what the link itself answers."""

from cfid.wire.crtp import ECHO_CHANNEL, LOG_PORT, LONGEST_PAYLOAD, PARAMETER_PORT

MEMORY_PORT, SUPERVISOR_PORT = 4, 9

_SOURCE_CHANNEL, _NULL_CHANNEL = 1, 3
# Answers in a packet of their own lack the link's bits in the header; others are the request's packet, filled in.
_OF_THEIR_OWN = {(PARAMETER_PORT, 0), (LOG_PORT, 0)} | {
    (port, channel) for port in (MEMORY_PORT, SUPERVISOR_PORT) for channel in range(4)
}


def framed(answer: bytes, *, port: int, channel: int, header: int) -> bytes:
    """Return the packet of an answer to a request with this header."""
    return new_packet(port, channel, answer) if (port, channel) in _OF_THEIR_OWN else bytes([header]) + answer


def new_packet(port: int, channel: int, payload: bytes) -> bytes:
    """Return a packet that originates in the vehicle."""
    return bytes([port << 4 | channel]) + payload


def answer_link(channel: int, payload: bytes) -> bytes | None:
    """Return an echo, even of the empty packet that searches for vehicles, or the vehicle's name."""
    if channel == _SOURCE_CHANNEL:
        return b"Bitcraze Crazyflie".ljust(LONGEST_PAYLOAD, b"\0")
    return payload if channel == ECHO_CHANNEL or (channel == _NULL_CHANNEL and not payload) else None
