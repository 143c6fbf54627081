"""Encodes and decodes the thrust, sine and ping services of the thesis (C.2.1, C.2.4, C.2.6) and of cfid's app.

The thesis' fields come first in every payload; the app's additions follow these fields or have a channel of their own.
A decoder returns None for a payload of the wrong length. The vehicle's clock counts microseconds; fields of 32 bits
wrap.
"""

import math
from enum import IntEnum, IntFlag
from typing import NamedTuple

from cfid.wire.layout import Layout

MIDDLE = 30000  # B of eq. 3.6
LARGEST_COMMAND = 65535
ALL_MOTORS_THRUST = 4  # the motor of a thrust request to all motors; single ones are 0 to 3
ALL_MOTORS_SINE = 0  # the motor of a sine request to all motors; single ones are 1 to 4
SAMPLES_PER_S = 500
KEEP_ALIVE_S = 0.5  # the app stops the motors this long after the last keep-alive
PROTOCOLS = (1, 2)  # from 2 on, requests and keep-alives carry their owner's number
NO_OWNER = 0


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


_THRUST = Layout("<Hi", ThrustRequest)  # the thesis' struct of C.2.1
_THRUST_ANSWER = Layout(
    "<HiB4HI", lambda command, motor, verdict, *more: ThrustAnswer(command, motor, verdict, more[:4], more[4])
)
_SINE = Layout("<HHfI", SineRequest)  # the thesis' struct of C.2.4
_SINE_ANSWER = Layout("<HHfIB?I", SineAnswer)
_CROSSING = Layout("<HIIH", Crossing)
_DONE = Layout("<BBII", Done, mark=(ord("a"),))
_HELLO = Layout("<4sBHHQ", Hello, mark=(b"cfid",))
_ALIVE = Layout("<I", int)
_STATE = Layout("<IB4HI", lambda number, flags, *more: AppState(number, Flags(flags), more[:4], more[4]))
_MICROSECONDS = Layout("<Q", int)
_OWNER = Layout("<I", int)

decode_thrust_answer = _THRUST_ANSWER.decode
decode_sine_answer = _SINE_ANSWER.decode
decode_crossing = _CROSSING.decode
decode_done = _DONE.decode
decode_hello = _HELLO.decode
decode_state = _STATE.decode


def encode_thrust(request: ThrustRequest, owner: int = NO_OWNER) -> bytes:
    """Return a thrust request, followed by its owner's number where there is one."""
    return _THRUST.encode(*request) + _owned(owner)


def encode_sine(request: SineRequest, owner: int = NO_OWNER) -> bytes:
    """Return a sine request, followed by its owner's number where there is one; omega becomes a float32."""
    return _SINE.encode(*request) + _owned(owner)


def encode_alive(number: int, owner: int = NO_OWNER) -> bytes:
    """Return a keep-alive or a stop, whose number the answering state repeats; a stop needs no owner."""
    return _ALIVE.encode(number) + _owned(owner)


def encode_state(state: AppState) -> bytes:
    """Return the answer to a keep-alive or a stop."""
    return _STATE.encode(state.number, state.flags, *state.commands, state.microseconds)


def encode_ping_answer(request: bytes, microseconds: int) -> bytes:
    """Return the answer to a ping: empty for an empty ping, as in 2015; else its bytes, at most 22, and the time."""
    return request + _MICROSECONDS.encode(microseconds) if request else b""


def decode_ping_answer(request: bytes, payload: bytes) -> int | None:
    """Return the vehicle's time from the answer to a ping that was not empty."""
    return _MICROSECONDS.decode(payload[len(request) :]) if request and payload.startswith(request) else None


def omega_of(periods: int, samples: int) -> float:
    """Return the thesis' Omega_l = 2 pi l / N in rad per sample (eq. 3.6)."""
    return 2 * math.pi * periods / samples


def _owned(owner: int) -> bytes:
    return _OWNER.encode(owner) if owner != NO_OWNER else b""
