"""Events that a vehicle may meet: packets of any bytes, ticks that come soon or late, consent given and withdrawn."""

from collections.abc import Iterable
from typing import NamedTuple

from hypothesis import strategies as st

from cfid.sim.app_core import PING, SINE, THRUST, AppCore, Sent
from cfid.sim.propulsion import Four
from cfid.wire import app
from tests.firmware.stand import MAY_NOT_RUN, MAY_RUN

BEGIN_US = 2**32 - 3_000_000  # the low 32 bits wrap during the events


class Event(NamedTuple):
    """A packet, or a tick if there is none, `after_us` microseconds after the previous event."""

    after_us: int
    allowed: bool
    packet: Sent | None


class Outcome(NamedTuple):
    """The commands that a tick returned, and the packets in the outbox if it was emptied after the event."""

    commands: Four | None
    sent: tuple[Sent, ...]


def _sine(draw: tuple[int, int, int, int]) -> bytes:
    motor, amplitude, samples, periods = draw
    omega = app.omega_of(periods % (samples // 2 + 1), samples)
    return app.encode_sine(app.SineRequest(motor, amplitude, omega, samples))


_words = st.integers(0, 65535)
_numbers = st.integers(0, 2**32 - 1).map(app.encode_alive)
_thrusts = st.builds(app.ThrustRequest, _words, st.integers(0, 4)).map(app.encode_thrust)
_sines = st.tuples(st.integers(0, 4), _words, st.integers(1, 40), st.integers(0, 20)).map(_sine)
_requests = st.tuples(st.just(THRUST), st.just(0), _thrusts) | st.tuples(st.just(SINE), st.just(0), _sines)
_keep_alives = st.tuples(st.just(PING), st.just(int(app.PingChannel.ALIVE)), _numbers)
_any_packets = st.one_of(
    _keep_alives,
    _requests,
    st.tuples(st.just(THRUST), st.just(0), st.binary(min_size=6, max_size=6)),
    st.tuples(st.just(SINE), st.just(0), st.binary(min_size=12, max_size=12)),
    st.tuples(st.just(PING), st.integers(0, 3), _numbers),
    st.tuples(st.integers(0, 3), st.integers(0, 3), st.binary(max_size=30)),
)
_mostly = st.sampled_from([True, True, True, True, False])
_pauses = st.sampled_from([0, 1, 1000, 399_000, 499_999, 500_000, 1_000_000]) | st.integers(0, 700_000)
_some = st.builds(lambda after_us, allowed, packet: [Event(after_us, allowed, packet)], _pauses, _mostly, _any_packets)


def _ticks(count: int, every_us: int, allowed: bool) -> list[Event]:
    return [Event(every_us, allowed, None)] * count


_later = st.builds(_ticks, st.just(1), _pauses, _mostly)
_soon = st.builds(_ticks, st.integers(1, 120), st.just(1000), _mostly)
_kept_alive = st.builds(
    lambda packet, after_us, ticks: [Event(after_us, True, packet), *ticks], _keep_alives, _pauses, _soon
)
_driven = st.builds(
    lambda first, packet, ticks: [first[0], Event(0, True, packet), *ticks], _kept_alive, _requests, _soon
)

# Sequences in which events depend on each other, so that motors often do run, and any other events between them.
events = st.lists(st.one_of(_driven, _kept_alive, _soon, _later, _some), max_size=12).map(
    lambda runs: [event for run in runs for event in run]
)


def outcomes(core: AppCore, happening: Iterable[Event], *, drained_every: int) -> list[Outcome]:
    """Return what the core did at each event; its outbox is emptied at every `drained_every`-th, so it can fill."""
    now_us, done = BEGIN_US, []
    for number, (after_us, allowed, packet) in enumerate(happening):
        now_us += after_us
        vehicle = MAY_RUN if allowed else MAY_NOT_RUN
        commands = None
        if packet is None:
            commands = core.tick(now_us=now_us, vehicle=vehicle).held
        else:
            core.receive(*packet, now_us=now_us, vehicle=vehicle)
        sent = core.sent() if number % drained_every == 0 else []
        done.append(Outcome(commands, tuple(sent)))
    return done
