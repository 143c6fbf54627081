"""Encodes and decodes the exchange with the firmware's supervisor: its state word, its commands, relaxed setpoints.

Firmware from protocol 12 on (release 2026.04) answers on port 9. Before that, arming and recovery were commands of the
platform port, and the state word was available only as the log variable `supervisor.info`.
"""

from enum import IntFlag
from typing import NamedTuple, Self

from cfid.wire.crtp import Packet

SUPERVISOR_PORT, INFO_CHANNEL, COMMAND_CHANNEL = 9, 0, 1
PLATFORM_PORT, PLATFORM_CHANNEL, VERSION_CHANNEL = 13, 0, 1
SETPOINT_PORT, META_CHANNEL = 7, 1
PORT_SINCE = 12  # version of the protocol
INFO_VARIABLE = "supervisor.info"

RELEASE, DEVICE = b"\x01", b"\x02"  # questions about the firmware and the vehicle, which text answers

_ANSWER = 0x80
_ARM, _RECOVER, _WORD = 0x01, 0x02, 0x0C

# Releases a setpoint that some client left behind. Firmware fails an assertion at any other payload length.
RELAX_SETPOINT = Packet(SETPOINT_PORT, META_CHANNEL, bytes(5))
ASK_STATE = Packet(SUPERVISOR_PORT, INFO_CHANNEL, bytes([_WORD]))


class Bits(IntFlag):
    """The bits of the state word, which the supervisor updates 25 times a second."""

    CAN_BE_ARMED = 1 << 0
    ARMED = 1 << 1
    ARMS_ITSELF = 1 << 2
    CAN_FLY = 1 << 3
    FLYING = 1 << 4
    TUMBLED = 1 << 5
    LOCKED = 1 << 6
    CRASHED = 1 << 7
    HIGH_LEVEL = 1 << 8  # the high-level commander flies
    DECK_FAULT = 1 << 11


_STATES = (  # bits, the name of a state that has them, and what the operator does before motors may run
    (Bits.LOCKED, "locked", "turn it off and on (an emergency stop, an old setpoint or a blocked rotor locked it)"),
    (Bits.CRASHED, "crashed", "put it upright and run `cfid motors recover`"),
    (
        Bits.TUMBLED,
        "tumbled",
        "put it upright; one that is fastened upside down needs the parameter supervisor.tmblChckEn at 0",
    ),
    (Bits.DECK_FAULT, "deck fault", "look at its console for the deck that failed its test"),
    (Bits.FLYING, "flying", ""),
    (Bits.CAN_FLY, "ready", ""),
    (Bits.ARMED, "arming", ""),
    (Bits.CAN_BE_ARMED, "disarmed", ""),
    (Bits(0), "not ready", ""),
)


class VehicleState(NamedTuple):
    """A state: its name for operators, whether motors may start from it, and what to do where they may not."""

    bits: Bits

    @classmethod
    def of(cls, word: int) -> Self:
        """Return the state of a word, without its unknown bits."""
        return cls(Bits(word & sum(Bits)))

    @property
    def name(self) -> str:
        """Return the state's name; the word cannot distinguish landed from ready, nor level-out from flying."""
        return next(name for bits, name, _ in _STATES if bits in self.bits)

    @property
    def remedy(self) -> str:
        """Return what the operator has to do before motors may run; empty where nothing has to be done."""
        return next(remedy for bits, _, remedy in _STATES if bits in self.bits)

    @property
    def can_fly(self) -> bool:
        """Whether the supervisor lets commanded motors run."""
        return Bits.CAN_FLY in self.bits

    @property
    def armed(self) -> bool:
        """Whether the vehicle is armed: one with idle thrust then turns its rotors."""
        return Bits.ARMED in self.bits

    @property
    def arms_itself(self) -> bool:
        """Whether the vehicle arms itself without a client, as brushed vehicles do."""
        return Bits.ARMS_ITSELF in self.bits

    @property
    def is_passing(self) -> bool:
        """Whether the vehicle is between two states, and will be in another one within 0.2 s."""
        return self.name == "not ready"


def decode_state(payload: bytes) -> VehicleState | None:
    """Return the state from the answer to `ASK_STATE`, or None for any other payload."""
    if len(payload) != 3 or payload[0] != _ANSWER | _WORD:
        return None
    return VehicleState.of(int.from_bytes(payload[1:], "little"))


def encode_arming(*, arm: bool, protocol: int) -> Packet:
    """Return the request to arm or disarm in a version of the protocol."""
    return _request(_ARM, arm, protocol=protocol)


def encode_recovery(*, protocol: int) -> Packet:
    """Return the request to recover from a crash, which the firmware grants to a vehicle that is upright."""
    return _request(_RECOVER, protocol=protocol)


def decode_arming(payload: bytes, *, protocol: int) -> bool | None:
    """Return whether a request to arm or disarm was granted, or None for any payload that answers no such request."""
    return _granted(_ARM, payload, protocol=protocol)


def decode_recovery(payload: bytes, *, protocol: int) -> bool | None:
    """Return whether a recovery was granted, or None for any payload that answers no such request."""
    return _granted(_RECOVER, payload, protocol=protocol)


def _request(command: int, *more: int, protocol: int) -> Packet:
    port, channel = (SUPERVISOR_PORT, COMMAND_CHANNEL) if protocol >= PORT_SINCE else (PLATFORM_PORT, PLATFORM_CHANNEL)
    return Packet(port, channel, bytes([command, *more]))


def _granted(command: int, payload: bytes, *, protocol: int) -> bool | None:
    """Return whether a command was granted. The byte that follows states the result; old firmware omits it."""
    first, shortest = (_ANSWER | command, 3) if protocol >= PORT_SINCE else (command, 2)
    return bool(payload[1]) if shortest <= len(payload) <= 3 and payload[0] == first else None
