"""Simulates a vehicle without cfid's app: stock firmware, or the thesis' modules of 2015.

Both have the interface of the app in `app_core`, so that the vehicle treats all three alike.
"""

import math
from collections import deque
from typing import NamedTuple, Protocol

import numpy as np

from cfid.sim.propulsion import STILL, Four
from cfid.wire.app import (
    ALL_MOTORS_SINE,
    ALL_MOTORS_THRUST,
    LARGEST_COMMAND,
    MIDDLE,
    Crossing,
    Done,
    PingChannel,
    SineChannel,
    SineRequest,
    ThrustRequest,
    decode_sine,
    decode_thrust,
    encode_crossing,
    encode_done,
)

THRUST, SINE, PING = range(3)

_TICKS_A_SAMPLE = 2  # of a millisecond each: 500 Hz
_TICKS_BEFORE_DONE = 1000
_LARGEST_FLOAT = 3.4e38

Sent = tuple[int, int, bytes]  # service, channel, payload


class Seen(NamedTuple):
    """The vehicle's state as the app sees it; `idle` is powerDist.idleThrust as its owner set it."""

    can_fly: bool
    flying: bool
    needs_arming: bool
    idle: int


class Orders(NamedTuple):
    """An app's orders until its next tick.

    `commands` are those of the four motors, None to leave them to the stock controller; `feeds` gives fresh null
    setpoints, `idles_off` switches idle thrust off, and `disarms` disarms now.
    """

    commands: Four | None = None
    feeds: bool = False
    idles_off: bool = False
    disarms: bool = False


class App(Protocol):
    """The three services on a vehicle, which give orders once a millisecond."""

    def receive(self, service: int, channel: int, payload: bytes, *, now_us: int, vehicle: Seen) -> None:
        """Take a request."""

    def tick(self, *, now_us: int, vehicle: Seen) -> Orders:
        """Advance by a millisecond."""

    def sent(self) -> list[Sent]:
        """Return the packets to send."""

    def alive(self, *, now_us: int) -> bool:
        """Return whether its client's keep-alives are fresh, or a sine plays."""


class NoModules:
    """Stock firmware."""

    def receive(self, service: int, channel: int, payload: bytes, *, now_us: int, vehicle: Seen) -> None:
        """Ignore the request."""

    def tick(self, *, now_us: int, vehicle: Seen) -> Orders:
        """Leave the motors alone."""
        return Orders()

    def sent(self) -> list[Sent]:
        """Return nothing."""
        return []

    def alive(self, *, now_us: int) -> bool:
        """Return False."""
        return False


class ModulesOf2015:
    """Thrust, sine and ping as in C.2.1, C.2.4 and C.2.6: without watchdog, answers or supervisor."""

    def __init__(self) -> None:
        """Start with the motors off."""
        self._commands = STILL
        self._sent: deque[Sent] = deque()
        self._waiting: SineRequest | None = None
        self._playing: SineRequest | None = None
        self._tick = 0
        self._before = 0  # the previous sample, even if of the previous sine

    def receive(self, service: int, channel: int, payload: bytes, *, now_us: int, vehicle: Seen) -> None:
        """Execute at once; a sine that arrives while another one plays waits for its end."""
        if service == PING:
            self._sent.append((PING, PingChannel.PING, b""))
        elif service == THRUST:
            self._set(decode_thrust(payload))
        else:
            self._waiting = decode_sine(payload) or self._waiting

    def tick(self, *, now_us: int, vehicle: Seen) -> Orders:
        """Advance by a millisecond."""
        if self._playing is None and self._waiting is not None:
            self._playing, self._waiting, self._tick = self._waiting, None, 0
        if self._playing is not None:
            self._play(self._playing)
        return Orders(self._commands)

    def sent(self) -> list[Sent]:
        """Return the packets to send."""
        sent = list(self._sent)
        self._sent.clear()
        return sent

    def alive(self, *, now_us: int) -> bool:
        """Return whether a sine plays or has just ended."""
        return self._playing is not None

    def _set(self, request: ThrustRequest | None) -> None:
        if request is not None:
            self._apply(request.command, None if request.motor == ALL_MOTORS_THRUST else request.motor)

    def _play(self, sine: SineRequest) -> None:
        self._tick += 1
        sample, between = divmod(self._tick, _TICKS_A_SAMPLE)
        sample -= 1
        if not between and sample < sine.samples:
            self._play_sample(sine, sample)
        last_tick = sine.samples * _TICKS_A_SAMPLE
        if self._tick == max(last_tick, 1):  # right after the last sample, which is too short for the motors to follow
            self._commands = STILL
            self._report(0)
        if self._tick >= last_tick + _TICKS_BEFORE_DONE:
            self._sent.append((SINE, SineChannel.DONE, encode_done(Done())))
            self._playing = None

    def _play_sample(self, sine: SineRequest, sample: int) -> None:
        value = _value(sine, sample)
        if sample == 0 or self._before > MIDDLE >= value or self._before < MIDDLE <= value:
            self._report(value)
        self._before = value
        self._apply(value, None if sine.motor == ALL_MOTORS_SINE else sine.motor - 1)

    def _report(self, command: int) -> None:
        self._sent.append((SINE, SineChannel.CROSSING, encode_crossing(Crossing(command))))

    def _apply(self, command: int, motor: int | None) -> None:
        """Set one motor, 0 to 3, or all."""
        one, two, three, four = (
            command if motor in (None, place) else before for place, before in enumerate(self._commands)
        )
        self._commands = (one, two, three, four)


def _value(sine: SineRequest, sample: int) -> int:
    """Return u[n] of eq. 3.6 as in C: the phase is a float, and NaN becomes 0."""
    phase = sine.omega * sample
    if not abs(phase) < _LARGEST_FLOAT:
        return 0
    return int(min(max(sine.amplitude * math.cos(np.float32(phase)) + MIDDLE, 0), LARGEST_COMMAND))
