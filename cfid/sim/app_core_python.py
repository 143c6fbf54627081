"""What cfid's app does on the vehicle, written again in Python for machines without a C compiler.

It does what `firmware_patches/cfid_app/src/cfid_core.c` does, packet for packet; reasons stand there. It is no model of
a vehicle: it has no motors, no link and no clock.
"""

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum, auto

from cfid.sim.crazyflie_modules import PING, SINE, THRUST, Sent
from cfid.sim.propulsion import STILL, Four
from cfid.wire.app import (
    ALL_MOTORS_SINE,
    ALL_MOTORS_THRUST,
    KEEP_ALIVE_S,
    LARGEST_COMMAND,
    MIDDLE,
    PROTOCOL,
    SAMPLES_PER_S,
    AppState,
    Crossing,
    Done,
    Flags,
    Hello,
    Outcome,
    PingChannel,
    SineAnswer,
    SineChannel,
    SineRequest,
    ThrustAnswer,
    ThrustChannel,
    ThrustRequest,
    Verdict,
    decode_alive,
    decode_sine,
    decode_thrust,
    encode_crossing,
    encode_done,
    encode_hello,
    encode_sine_answer,
    encode_state,
    encode_thrust_answer,
)

_OUTBOX = 16
_MOTORS = range(len(STILL))
_KEEP_ALIVE_US = round(KEEP_ALIVE_S * 1e6)
_REST_US = 1_000_000
_MOST_PERIODS = 1 << 22
_LARGEST_OMEGA = 3.1415927410125732  # pi as a float32
_FLOAT_ROUNDING = 6.0e-8
_UNHEARD_THRUST = ThrustRequest(0, 0)  # stands in the answer to one of the wrong length
_UNHEARD_SINE = SineRequest(0, 0, 0.0, 0)
_OMEGA_BYTES = slice(4, 8)


class _Stage(Enum):
    PLAYING = auto()
    OFF = auto()
    RESTING = auto()
    GONE = auto()


@dataclass
class _Sine:
    """A sine as far as it has been played; `motor` as in a thrust request, `phase` is l n mod N."""

    motor: int
    amplitude: int
    samples: int
    periods: int
    stage: _Stage = _Stage.PLAYING
    outcome: Outcome = Outcome.FINISHED
    held: bool = False
    command: int = 0
    reports: int = 0
    phase: int = 0
    played: int = 0
    clipped: int = 0
    off_us: int = 0


class PythonCore:
    """The app; the interface is that of `AppCore`."""

    implementation = "Python"

    def __init__(self) -> None:
        """Drive nothing, and have heard nothing."""
        self._alive_us: int | None = None
        self._commands = STILL
        self._sine: _Sine | None = None
        self._outbox: deque[Sent] = deque()

    def receive(self, service: int, channel: int, payload: bytes, *, now_us: int, allowed: bool) -> None:
        """Take a request. `allowed`: whether the supervisor lets motors run."""
        self._watch(now_us, allowed)
        number = decode_alive(payload)
        if (service, channel) == (THRUST, ThrustChannel.SET):
            self._receive_thrust(payload, now_us, allowed)
        elif (service, channel) == (SINE, SineChannel.START):
            self._receive_sine(payload, allowed)
        elif (service, channel) == (PING, PingChannel.HELLO):
            hello = Hello(PROTOCOL, SAMPLES_PER_S, _KEEP_ALIVE_US // 1000, now_us)
            self._post(PING, channel, encode_hello(hello))
        elif (service, channel) == (PING, PingChannel.ALIVE) and number is not None:
            self._alive_us = now_us
            self._answer_state(channel, number, now_us, allowed)
        elif (service, channel) == (PING, PingChannel.STOP):
            self._alive_us = None
            self._stop(Outcome.STOPPED, now_us)
            self._answer_state(channel, number or 0, now_us, allowed)

    def tick(self, *, now_us: int, allowed: bool) -> Four | None:
        """Go on by a millisecond; return the commands while keep-alives come, else None."""
        self._watch(now_us, allowed)
        if self._sine and self._sine.stage is _Stage.PLAYING:
            self._play(self._sine, now_us)
        self._settle(now_us)
        return None if self._alive_us is None else self._commands

    def sent(self) -> list[Sent]:
        """Hand over what is to be sent."""
        packets = list(self._outbox)
        self._outbox.clear()
        return packets

    def alive(self, *, now_us: int) -> bool:
        """Return whether the last keep-alive is fresh and was not revoked."""
        return self._alive_us is not None and 0 <= now_us - self._alive_us < _KEEP_ALIVE_US

    def _post(self, service: int, channel: int, payload: bytes) -> bool:
        fits = len(self._outbox) < _OUTBOX
        if fits:
            self._outbox.append((service, int(channel), payload))
        return fits

    def _drive(self, motor: int, command: int) -> None:
        m1, m2, m3, m4 = (command if motor in (ALL_MOTORS_THRUST, i) else self._commands[i] for i in _MOTORS)
        self._commands = m1, m2, m3, m4

    def _watch(self, now_us: int, allowed: bool) -> None:
        if not self.alive(now_us=now_us):
            self._alive_us = None
            self._stop(Outcome.KEEP_ALIVE_LOST, now_us)
        elif not allowed:
            self._stop(Outcome.MOTORS_NOT_ALLOWED, now_us)

    def _stop(self, outcome: Outcome, now_us: int) -> None:
        self._commands = STILL
        if self._sine and self._sine.stage is _Stage.PLAYING:
            self._sine.stage, self._sine.outcome, self._sine.off_us = _Stage.OFF, outcome, now_us
            self._settle(now_us)

    def _settle(self, now_us: int) -> None:
        """Bring an ended sine on; its last two packets wait for room."""
        sine = self._sine
        if sine is None:
            return
        if sine.stage is _Stage.OFF and self._report(sine, 0, sine.off_us):
            sine.stage = _Stage.RESTING
        if sine.stage is _Stage.RESTING and now_us - sine.off_us >= _REST_US:
            done = encode_done(Done(sine.outcome, sine.played, sine.clipped))
            if self._post(SINE, SineChannel.DONE, done):
                sine.stage = _Stage.GONE

    @property
    def _sine_runs(self) -> bool:
        return self._sine is not None and self._sine.stage is not _Stage.GONE

    def _report(self, sine: _Sine, command: int, now_us: int) -> bool:
        crossing = Crossing(command, sine.played, _low(now_us, 32), _low(sine.reports, 16))
        return self._post(SINE, SineChannel.CROSSING, encode_crossing(crossing))

    def _play(self, sine: _Sine, now_us: int) -> None:
        sine.held = not sine.held
        if not sine.held:
            return
        if sine.played == sine.samples:
            self._stop(Outcome.FINISHED, now_us)
            return
        sample = _sample(sine.amplitude, sine.phase, sine.samples)
        command = _clip(sample)
        if sine.command > MIDDLE >= command or sine.command < MIDDLE <= command:  # at n = 0 too, from 0
            self._report(sine, command, now_us)
            sine.reports += 1
        self._drive(sine.motor, command)
        sine.command = command
        sine.clipped += sample != command
        sine.phase = (sine.phase + sine.periods) % sine.samples
        sine.played += 1

    def _receive_thrust(self, payload: bytes, now_us: int, allowed: bool) -> None:
        request = decode_thrust(payload)
        verdict = Verdict.WRONG_LENGTH if request is None else self._judge_thrust(request, allowed)
        request = request or _UNHEARD_THRUST
        if verdict == Verdict.ACCEPTED and request == (0, ALL_MOTORS_THRUST):
            self._stop(Outcome.STOPPED, now_us)
        elif verdict == Verdict.ACCEPTED:
            self._drive(request.motor, request.command)
        answer = ThrustAnswer(*request, verdict, self._commands, _low(now_us, 32))
        self._post(THRUST, ThrustChannel.ANSWER, encode_thrust_answer(answer))

    def _judge_thrust(self, request: ThrustRequest, allowed: bool) -> Verdict:
        if request.motor not in (*_MOTORS, ALL_MOTORS_THRUST):
            return Verdict.NO_SUCH_MOTOR
        if self._sine_runs:
            return Verdict.ACCEPTED if request == (0, ALL_MOTORS_THRUST) else Verdict.SINE_IS_RUNNING
        return Verdict.ACCEPTED if request.command == 0 else self._judge_motors(allowed)

    def _judge_motors(self, allowed: bool) -> Verdict:
        if self._alive_us is None:
            return Verdict.NO_KEEP_ALIVE
        return Verdict.ACCEPTED if allowed else Verdict.MOTORS_NOT_ALLOWED

    def _receive_sine(self, payload: bytes, allowed: bool) -> None:
        request = decode_sine(payload)
        verdict, periods = (Verdict.WRONG_LENGTH, 0) if request is None else _judge_sine(request)
        request = request or _UNHEARD_SINE
        clips = verdict == Verdict.ACCEPTED and _any_clipped(request, periods)
        if verdict == Verdict.ACCEPTED:
            verdict = Verdict.SINE_IS_RUNNING if self._sine_runs else self._judge_motors(allowed)
        if verdict == Verdict.ACCEPTED:
            motor = ALL_MOTORS_THRUST if request.motor == ALL_MOTORS_SINE else request.motor - 1
            self._commands = STILL
            self._sine = _Sine(motor, request.amplitude, request.samples, periods)
        answer = bytearray(encode_sine_answer(SineAnswer(*request, verdict, clips, periods)))
        if verdict != Verdict.WRONG_LENGTH:
            answer[_OMEGA_BYTES] = payload[_OMEGA_BYTES]  # as it came: Python changes the bits of some NaN
        self._post(SINE, SineChannel.ANSWER, bytes(answer))

    def _answer_state(self, channel: int, number: int, now_us: int, allowed: bool) -> None:
        flags = (
            Flags.MOTORS_ALLOWED * allowed
            | Flags.KEEP_ALIVE_FRESH * (self._alive_us is not None)
            | Flags.SINE_RUNNING * self._sine_runs
        )
        state = AppState(number, Flags(flags), self._commands, _low(now_us, 32))
        self._post(PING, channel, encode_state(state))


def _low(value: int, bits: int) -> int:
    return value % (1 << bits)


def _cosine(k: int, n: int) -> float:
    """Return cos(2 pi k/n), exact where it is 0, 1/2 or 1."""
    j = min(2 * k, 2 * (n - k))
    sign = 1.0
    if 2 * j > n:
        j, sign = n - j, -1.0
    if 3 * j == n:
        return sign * 0.5
    if 4 * j > n:
        return sign * math.sin(math.pi * (n - 2 * j) / (2 * n))
    return sign * math.cos(math.pi * j / n)


def _sample(amplitude: int, k: int, n: int) -> int:
    """Return A cos(2 pi k/n) + B of eq. 3.6, cut to an integer and not yet clipped."""
    return int(amplitude * _cosine(k, n) + MIDDLE)


def _clip(sample: int) -> int:
    return min(max(sample, 0), LARGEST_COMMAND)


def _judge_sine(request: SineRequest) -> tuple[Verdict, int]:
    """Return what is wrong with a request itself, and l as recovered from its omega."""
    if request.motor > len(STILL):
        return Verdict.NO_SUCH_MOTOR, 0
    if request.samples == 0:
        return Verdict.NO_SAMPLES, 0
    if not 0 <= request.omega <= _LARGEST_OMEGA:
        return Verdict.NO_FREQUENCY, 0
    exact = request.omega * request.samples / (2 * math.pi)
    nearest = math.floor(exact + 0.5)
    if nearest > _MOST_PERIODS or abs(exact - nearest) > nearest * _FLOAT_ROUNDING:
        return Verdict.NO_WHOLE_PERIODS, 0
    return Verdict.ACCEPTED, nearest


def _any_clipped(request: SineRequest, periods: int) -> bool:
    """Return whether the largest sample, at n = 0, or the smallest is clipped."""
    m = request.samples // math.gcd(request.samples, periods)
    return any((s := _sample(request.amplitude, k, m)) != _clip(s) for k in (0, m // 2))
