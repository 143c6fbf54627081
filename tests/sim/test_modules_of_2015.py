"""The thesis' firmware modules, as a vehicle of 2015 has them: their bytes, their sine, and what they lack."""

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cfid.sim.crazyflie_truth import CrazyflieTruth
from cfid.sim.propulsion import STILL
from tests.sim.vehicle import Bench

OLD = CrazyflieTruth(firmware="old")
THRUST, SINE, PING = 10, 11, 12


def _thrust(bench: Bench, command: int, motor: int) -> None:
    assert bench.say(THRUST, 0, struct.pack("<Hi", command, motor)) == []  # nothing acknowledges it
    bench.wait(0.002)


def _sine(motor: int, amplitude: int, periods: int, samples: int) -> bytes:
    return struct.pack("<HHfI", motor, amplitude, 2 * math.pi * periods / max(samples, 1), samples)


def test_a_ping_on_any_channel_is_answered_with_nothing_on_channel_0() -> None:
    bench = Bench(OLD)
    for channel in range(4):
        assert bench.say(PING, channel, b"abc") == [bytes([PING << 4])]


def test_a_command_goes_straight_to_one_motor_or_to_all_and_stays() -> None:
    bench = Bench(OLD)
    _thrust(bench, 20000, 2)
    assert bench.motors == (0, 0, 20000, 0)
    _thrust(bench, 10000, 4)
    _thrust(bench, 0, 0)
    assert bench.motors == (0, 10000, 10000, 10000)
    bench.wait(60.0)  # no watchdog
    assert bench.motors == (0, 10000, 10000, 10000)
    bench.vehicle.turn(-1.0)  # no supervisor
    bench.wait(1.0)
    assert bench.motors == (0, 10000, 10000, 10000)


@pytest.mark.parametrize("payload", [b"", b"\0" * 5, struct.pack("<Hi", 20000, 5), struct.pack("<Hi", 20000, -1)])
def test_a_command_that_makes_no_sense_does_nothing(payload: bytes) -> None:
    bench = Bench(OLD)
    bench.say(THRUST, 0, payload)
    bench.wait(0.01)
    assert bench.motors == STILL


def test_a_sine_is_played_at_500_hz_and_ends_with_a_zero_and_an_a() -> None:
    bench = Bench(OLD)
    bench.say(SINE, 0, _sine(3, 20000, 5, 500))
    came = bench.wait(3.0)
    played = [(time_s, motors[2]) for time_s, motors in bench.changes]
    assert all(motors[:2] == (0, 0) and motors[3] == 0 for _, motors in bench.changes)
    expected = [int(20000 * math.cos(2 * math.pi * 5 * n / 500) + 30000) for n in range(500)]
    steps = [round((time_s - played[0][0]) * 500) for time_s, _ in played[:-1]]
    for n, (_, command) in zip(steps, played[:-1], strict=True):
        assert command == pytest.approx(expected[n], abs=1)
    assert played[-1][0] == pytest.approx(1.0)
    assert played[-1][1] == 0

    assert all(packet[0] == SINE << 4 and len(packet) == 3 for _, packet in came[:-1])
    reports = [(time_s, *struct.unpack("<H", packet[1:])) for time_s, packet in came[:-1]]
    assert (reports[0][1], reports[-1][1]) == (50000, 0)
    assert len(reports) == 1 + 2 * 5 + 1
    for k, (time_s, command) in enumerate(reports[1:-1]):
        assert time_s - played[0][0] == pytest.approx((0.5 + k) * 0.1, abs=0.0025)
        assert command == pytest.approx(30000, abs=1300)
    assert came[-1][0] == pytest.approx(reports[-1][0] + 1.0)
    assert came[-1][1] == bytes([SINE << 4 | 1]) + b"a"


def test_a_sine_of_all_motors_clips_at_what_a_motor_can_do() -> None:
    bench = Bench(OLD)
    bench.say(SINE, 0, _sine(0, 65535, 5, 500))
    bench.wait(0.99)
    assert {len(set(motors)) for _, motors in bench.changes} == {1}
    commands = [motors[0] for _, motors in bench.changes]
    assert (min(commands), max(commands)) == (0, 65535)


def test_a_sine_that_comes_while_one_plays_waits_for_its_end() -> None:
    bench = Bench(OLD)
    bench.say(SINE, 0, _sine(1, 20000, 1, 50))
    bench.wait(0.05)
    bench.say(SINE, 0, _sine(2, 20000, 1, 50))
    bench.wait(1.0)
    assert {motors[1] for _, motors in bench.changes} == {0}
    assert len([1 for _, packet in bench.wait(2.0) if packet[1:] == b"a"]) == 2
    assert max(motors[1] for _, motors in bench.changes) == 50000


@pytest.mark.parametrize("omega", [math.nan, math.inf, -1.0, 3e38])
def test_a_sine_of_no_frequency_is_played_all_the_same(omega: float) -> None:
    bench = Bench(OLD)
    bench.say(SINE, 0, struct.pack("<HHfI", 1, 20000, omega, 10))
    assert bench.wait(2.0)[-1][1][1:] == b"a"
    assert bench.motors == STILL


def test_a_sine_of_no_samples_ends_at_once() -> None:
    bench = Bench(OLD)
    bench.say(SINE, 0, _sine(1, 20000, 0, 0))
    assert [packet[1:] for _, packet in bench.wait(2.0)] == [b"\0\0", b"a"]


@settings(max_examples=50)
@given(st.integers(0, 65535), st.integers(0, 65535), st.integers(0, 60), st.integers(1, 120))
def test_every_sine_ends_with_motors_that_stand(motor: int, amplitude: int, periods: int, samples: int) -> None:
    bench = Bench(OLD)
    bench.say(SINE, 0, _sine(motor, amplitude, periods, samples))
    assert bench.wait(1.5)[-1][1][1:] == b"a"
    assert bench.motors == STILL
