"""Encodes and decodes the thrust, sine and ping services of the thesis (C.2.1, C.2.4, C.2.6) and of cfid's app.

The thesis' fields come first in every payload; the app's additions follow these fields or have a channel of their own.
A decoder returns None for a payload of the wrong length. The vehicle's clock counts microseconds; fields of 32 bits
wrap.
"""

import math
import struct
from enum import IntEnum, IntFlag
from typing import NamedTuple

MIDDLE = 30000  # B of eq. 3.6
LARGEST_COMMAND = 65535
ALL_MOTORS_THRUST = 4  # the motor of a thrust request to all motors; single ones are 0 to 3
ALL_MOTORS_SINE = 0  # the motor of a sine request to all motors; single ones are 1 to 4
SAMPLES_PER_S = 500
KEEP_ALIVE_S = 0.5  # the app stops the motors this long after the last keep-alive
PROTOCOLS = (1, 2)  # from 2 on, requests and keep-alives carry their owner's number
NO_OWNER = 0

_THRUST = struct.Struct("<Hi")
_THRUST_ANSWER = struct.Struct("<HiB4HI")
_SINE = struct.Struct("<HHfI")
_SINE_ANSWER = struct.Struct("<HHfIBBI")
_CROSSING = struct.Struct("<HIIH")
_DONE = struct.Struct("<BBII")
_HELLO = struct.Struct("<4sBHHQ")
_ALIVE = struct.Struct("<I")
_STATE = struct.Struct("<IB4HI")
_MICROSECONDS = struct.Struct("<Q")
_OWNER = struct.Struct("<I")
_MAGIC = b"cfid"
_DONE_MARK = ord("a")


class AppPorts(NamedTuple):
    """The CRTP ports of the three services."""

    thrust: int = 10
    sine: int = 11
    ping: int = 12


class ThrustChannel(IntEnum):
    """Channels of the thrust service."""

    SET = 0
    ANSWER = 2


class SineChannel(IntEnum):
    """Channels of the sine service: both directions use 0, as in the thesis."""

    START = 0
    CROSSING = 0
    DONE = 1
    ANSWER = 2


class PingChannel(IntEnum):
    """Channels of the ping service."""

    PING = 0
    HELLO = 1
    ALIVE = 2
    STOP = 3


class AppVerdict(IntEnum):
    """The app's answer to a request."""

    ACCEPTED = 0
    WRONG_LENGTH = 1
    NO_SUCH_MOTOR = 2
    NO_KEEP_ALIVE = 3
    SINE_IS_RUNNING = 4
    MOTORS_NOT_ALLOWED = 5
    NO_SAMPLES = 6
    NO_FREQUENCY = 7
    NO_WHOLE_PERIODS = 8
    NOT_OWNER = 9


class AppOutcome(IntEnum):
    """How a sine ended."""

    FINISHED = 0
    STOPPED = 1
    KEEP_ALIVE_LOST = 2
    MOTORS_NOT_ALLOWED = 3


class Flags(IntFlag):
    """Flags of the app's state."""

    MOTORS_ALLOWED = 1
    KEEP_ALIVE_FRESH = 2
    SINE_RUNNING = 4
    NOT_OWNER = 8  # the keep-alive that this state answers was not the owner's and had no effect


class ThrustRequest(NamedTuple):
    """A command for one motor, 0 to 3, or for all, 4."""

    command: int
    motor: int


class ThrustAnswer(NamedTuple):
    """The request as the app read it, the verdict, and the commands in force at that moment."""

    command: int
    motor: int
    verdict: int
    commands: tuple[int, int, int, int]
    microseconds: int


class SineRequest(NamedTuple):
    """A sine of eq. 3.6: motor 1 to 4 or 0 for all, amplitude A, omega in rad per sample, N samples."""

    motor: int
    amplitude: int
    omega: float
    samples: int


class SineAnswer(NamedTuple):
    """The request as the app read it, the verdict, whether the sine is clipped, and l as computed from omega."""

    motor: int
    amplitude: int
    omega: float
    samples: int
    verdict: int
    clips: bool
    periods: int


class Crossing(NamedTuple):
    """A crossing of the middle: its command, the sample's index, its time on board, and the report's number."""

    command: int
    sample: int
    microseconds: int
    number: int  # the last report has command 0 and the number of samples: the motors are off


class Done(NamedTuple):
    """The end of a sine, reported a second after its motors stopped; a report that was lost has no outcome."""

    outcome: int | None = None
    samples: int | None = None
    clipped: int | None = None


class Hello(NamedTuple):
    """How the app identifies itself."""

    protocol: int
    samples_per_s: int
    keep_alive_ms: int
    microseconds: int


class AppState(NamedTuple):
    """The answer to a keep-alive or a stop: its number, flags, and the commands in force."""

    number: int
    flags: Flags
    commands: tuple[int, int, int, int]
    microseconds: int


def encode_thrust(request: ThrustRequest, owner: int = NO_OWNER) -> bytes:
    """Return `<Hi`, the thesis' struct of C.2.1, followed by the owner's number where there is one."""
    return _THRUST.pack(*request) + _owned(owner)


def decode_thrust_answer(payload: bytes) -> ThrustAnswer | None:
    """Return an acknowledgement."""
    if len(payload) != _THRUST_ANSWER.size:
        return None
    command, motor, verdict, m1, m2, m3, m4, microseconds = _THRUST_ANSWER.unpack(payload)
    return ThrustAnswer(command, motor, verdict, (m1, m2, m3, m4), microseconds)


def encode_sine(request: SineRequest, owner: int = NO_OWNER) -> bytes:
    """Return `<HHfI`, the thesis' struct of C.2.4, and the owner's number if there is one; omega becomes a float32."""
    return _SINE.pack(*request) + _owned(owner)


def decode_sine_answer(payload: bytes) -> SineAnswer | None:
    """Return an acknowledgement."""
    if len(payload) != _SINE_ANSWER.size:
        return None
    fields = _SINE_ANSWER.unpack(payload)
    return SineAnswer._make((*fields[:5], bool(fields[5]), fields[6]))


def decode_crossing(payload: bytes) -> Crossing | None:
    """Return the crossing in a report."""
    return Crossing._make(_CROSSING.unpack(payload)) if len(payload) == _CROSSING.size else None


def decode_done(payload: bytes) -> Done | None:
    """Return the end of a sine."""
    if len(payload) != _DONE.size or payload[0] != _DONE_MARK:
        return None
    return Done._make(_DONE.unpack(payload)[1:])


def decode_hello(payload: bytes) -> Hello | None:
    """Return the app's answer to a hello."""
    if len(payload) != _HELLO.size or payload[:4] != _MAGIC:
        return None
    return Hello._make(_HELLO.unpack(payload)[1:])


def encode_alive(number: int, owner: int = NO_OWNER) -> bytes:
    """Return a keep-alive or a stop, whose number the answering state repeats; a stop needs no owner."""
    return _ALIVE.pack(number) + _owned(owner)


def encode_state(state: AppState) -> bytes:
    """Return the answer to a keep-alive or a stop."""
    return _STATE.pack(state.number, state.flags, *state.commands, state.microseconds)


def decode_state(payload: bytes) -> AppState | None:
    """Return the answer to a keep-alive or a stop."""
    if len(payload) != _STATE.size:
        return None
    number, flags, m1, m2, m3, m4, microseconds = _STATE.unpack(payload)
    return AppState(number, Flags(flags), (m1, m2, m3, m4), microseconds)


def encode_ping_answer(request: bytes, microseconds: int) -> bytes:
    """Return the answer to a ping: empty for an empty ping, as in 2015; else its bytes, at most 22, and the time."""
    return request + _MICROSECONDS.pack(microseconds) if request else b""


def decode_ping_answer(request: bytes, payload: bytes) -> int | None:
    """Return the vehicle's time from the answer to a ping that was not empty."""
    if not request or len(payload) != len(request) + _MICROSECONDS.size or not payload.startswith(request):
        return None
    return int(_MICROSECONDS.unpack(payload[len(request) :])[0])


def omega_of(periods: int, samples: int) -> float:
    """Return the thesis' Omega_l = 2 pi l / N in rad per sample (eq. 3.6)."""
    return 2 * math.pi * periods / samples


def _owned(owner: int) -> bytes:
    return _OWNER.pack(owner) if owner != NO_OWNER else b""
