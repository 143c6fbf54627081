"""The simulated Crazyflie as a client sees it, packet by packet, on a clock that is set by hand."""

import struct
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.sim.app_core import load_core
from cfid.sim.crazyflie import CrazyflieTruth, Leaving
from cfid.sim.propulsion import STILL, BatteryTruth
from cfid.wire.app import (
    AppPorts,
    PingChannel,
    ThrustChannel,
    ThrustRequest,
    decode_ping_answer,
    encode_thrust,
)
from tests.sim.vehicle import OPENED_S, OTHER_CLIENT, Bench, rows_of

THRUST, _, PING = AppPorts()
CRASHED, LOCKED = b"\xa4\2", b"\x44\2"
WITH_DECK, BRUSHLESS = CrazyflieTruth(rpm_deck=True), CrazyflieTruth(platform="cf21bl")


# Identity


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("fd00", "fd" + b"Bitcraze Crazyflie".hex() + "00" * 12),
        ("fc0123", "fc0123"),
        ("ff", "ff"),
        ("dd00", "dd000c000000"),
        ("dd01", "dd01" + b"2026.08".hex()),
        ("dd02", "dd02" + b"Crazyflie 2.1".hex()),
        ("4c01", "400102"),
        ("5d05", "5d050000"),
        ("9c0c", "908c0e02"),  # armed by itself, and able to fly
        ("9c02", "908201"),
        ("9d0101", "91810101"),
    ],
)
def test_it_answers_as_the_firmware_does(request_: str, answer: str) -> None:
    bench = Bench()
    assert [packet.hex() for _, packet in bench.vehicle.receive(bytes.fromhex(request_), OPENED_S)] == [answer]


# Parameters


def test_a_parameter_keeps_what_it_is_set_to() -> None:
    bench = Bench()
    number = struct.pack("<H", 5)
    assert bench.ask(2, 0, b"\2" + number) == b"\2" + number + b"\x16pm\0lowVoltage\0"
    assert bench.ask(2, 1, number) == number + b"\0" + struct.pack("<f", 3.2)
    assert bench.ask(2, 2, number + struct.pack("<f", 3.5)) == number + struct.pack("<f", 3.5)
    assert bench.ask(2, 1, number) == number + b"\0" + struct.pack("<f", 3.5)
    assert bench.ask(2, 3, b"\7" + number) == b"\7" + number + b"\0\1"
    assert bench.ask(2, 3, b"\2" + number) == b"\2" + number + b"\1"


# Motors driven by motorPowerSet


def test_motor_power_set_drives_each_motor_or_all_like_the_first() -> None:
    bench = Bench()
    bench.drive((10000, 20000, 30000, 40000))
    assert bench.motors == STILL  # until the next millisecond
    bench.wait(0.002)
    assert bench.motors == (10000, 20000, 30000, 40000)
    bench.set("motorPowerSet.enable", 2)
    bench.wait(0.002)
    assert bench.motors == (10000,) * 4
    bench.set("motorPowerSet.enable", 0)
    bench.wait(0.002)
    assert bench.motors == STILL
    assert [motors[0] for _, motors in bench.changes] == [10000, 10000, 0]


@pytest.mark.parametrize(("firmware", "command"), [("stock", 29678), ("app", 25000)])  # recorded from the firmware
def test_a_clients_setpoints_drive_the_motors_while_nothing_overrides_them(
    firmware: Literal["stock", "app"], command: int
) -> None:
    bench = Bench(CrazyflieTruth(firmware=firmware), battery=BatteryTruth(volts=4.0), load_app=load_core)
    for thrust in (25000, 0, 25000):  # the first one counts for nothing: no setpoint without thrust came before it
        bench.say(3, 0, struct.pack("<fffH", 0, 0, 0, thrust), client=OTHER_CLIENT)
        bench.wait(0.1)
        bench.ask(9, 0, b"\x0c")  # another client's setpoints take no answer from this one
    assert [motors for _, motors in bench.changes] == [pytest.approx((command,) * 4, abs=256)]
    bench.drive((22000, 0, 0, 0))
    bench.wait(0.1)
    assert bench.motors == (22000, 0, 0, 0)
    bench.set("motorPowerSet.enable", 0)
    bench.wait(0.1)
    assert bench.motors == pytest.approx((command,) * 4, abs=256)
    bench.wait(2.5)
    assert bench.motors == STILL
    assert bench.ask(9, 0, b"\x0c") == b"\x8c" + LOCKED  # by its old setpoint


# Motors driven by the app


def test_motors_of_the_app_obey_while_it_lives_and_override_nothing() -> None:
    bench = Bench()
    bench.keep_alive()
    request = encode_thrust(ThrustRequest(25000, 4))
    answer = bench.say(THRUST, ThrustChannel.SET, request)
    assert answer == [bytes([THRUST << 4 | ThrustChannel.ANSWER]) + request]
    bench.wait(0.01)
    assert bench.motors == (25000,) * 4
    bench.drive((1000, 0, 0, 0))
    bench.wait(0.01)
    assert bench.motors == (1000, 0, 0, 0)
    bench.set("motorPowerSet.enable", 0)
    bench.wait(0.01)
    assert bench.motors == (25000,) * 4
    bench.wait(0.5)
    assert bench.motors == STILL
    assert bench.changes[-1][0] == pytest.approx(0.5, abs=2e-3)


def test_a_ping_is_answered_at_once_with_the_vehicles_time() -> None:
    bench = Bench(CrazyflieTruth(powered_for_s=5000.0, clock_skew=-1 / 85))
    bench.wait(1.0)
    ((packet, _),) = bench.say_and_hear(PING, PingChannel.PING, b"abc")
    assert decode_ping_answer(b"abc", packet[1:]) == pytest.approx(5001e6 * 84 / 85, abs=2)
    assert bench.ask(PING, PingChannel.PING, b"") == b""
    assert len(bench.ask(PING, PingChannel.PING, bytes(30))) == 30


# Logging


@pytest.mark.parametrize("period_ms", [1, 10])
def test_a_block_comes_at_its_period_with_the_vehicles_milliseconds(period_ms: int) -> None:
    bench = Bench(CrazyflieTruth(powered_for_s=123.0))
    created, started = bench.log("pm.vbat", "motor.m1", "motor.m1req", period_ms=period_ms)
    assert (created, started) == (b"\6\7\0", b"\x08\7\0")
    bench.drive((30000, 0, 0, 0))
    rows = rows_of(bench.wait(1.0), "fHi")
    assert len(rows) == 1000 // period_ms
    assert [stamp - 123000 for _, stamp, _ in rows] == list(range(period_ms, 1001, period_ms))
    assert [time_s for time_s, _, _ in rows] == pytest.approx([(stamp - 123000) / 1000 for _, stamp, _ in rows])
    assert rows[-1][2] == (pytest.approx(3.7), 30000, 30000)


# Time


def test_catching_up_is_the_same_as_going_along() -> None:
    def heard(steps: list[float]) -> list[Leaving]:
        bench = Bench(WITH_DECK, battery=BatteryTruth(kind="lipo"))
        bench.log("pm.vbat", "rpm.m1", "motor.m1", period_ms=3)
        bench.drive((50000, 0, 0, 0))
        return [leaving for step_s in steps for leaving in bench.vehicle.advance(OPENED_S + step_s)]

    assert heard([1.5]) == heard([k / 1700 for k in range(1, 2551)])


# Arbitrary bytes


BYTES = st.binary(max_size=32)
REQUESTS = st.tuples(st.sampled_from([0x2E, 0x5D, 0xAC, 0xBC]), st.binary(max_size=14))  # parameters, log, and the app


@given(datagrams=st.lists(st.tuples(st.integers(0, 255), BYTES) | REQUESTS, max_size=20), app=st.booleans())
def test_no_datagram_whatever_its_bytes_upsets_it(datagrams: list[tuple[int, bytes]], app: bool) -> None:
    bench = Bench(CrazyflieTruth(firmware="app" if app else "stock"))
    for header, payload in datagrams:
        for _, packet in bench.vehicle.receive(bytes([header]) + payload, OPENED_S + bench.now_s):
            assert 1 <= len(packet) <= 31
        bench.wait(0.003)
    assert all(0 <= command <= 65535 for command in bench.motors)
