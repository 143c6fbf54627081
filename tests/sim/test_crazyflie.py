"""The simulated Crazyflie as a client sees it, packet by packet, on a clock that is set by hand."""

import struct
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.sim.app_core import load_core
from cfid.sim.crazyflie import CrazyflieTruth, Leaving, compensated
from cfid.sim.propulsion import BRUSHLESS as ROTORS_OF_BRUSHLESS
from cfid.sim.propulsion import STILL, BatteryTruth, RotorTruth
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


@pytest.mark.parametrize(
    "request_", ["", "00", "3c0000", "dd03", "ff01", "5f00", "4c05", "9d", "9e01", "fe00", "ff" * 32]
)
def test_what_the_firmware_does_not_answer_it_does_not_either(request_: str) -> None:
    assert Bench().vehicle.receive(bytes.fromhex(request_), OPENED_S) == []


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


@pytest.mark.parametrize(("channel", "payload", "answer"), [
    (0, "02ffff", "02"),
    (0, "02", "02"),
    (1, "ffff", "ffff02"),
    (2, "ffff01", "ffff02"),
    (3, "07ffff", "07ffff02"),
])  # fmt: skip
def test_a_parameter_that_is_not_there_is_answered_with_no_such_entry(channel: int, payload: str, answer: str) -> None:
    assert Bench().ask(2, channel, bytes.fromhex(payload)).hex() == answer


def test_a_parameter_that_can_only_be_read_is_not_set_and_a_value_that_is_cut_neither() -> None:
    bench = Bench()
    assert bench.say(2, 2, b"\7\0\0") == []  # system.selftestPassed
    assert bench.ask(2, 1, b"\7\0") == b"\7\0\0\1"
    assert bench.say(2, 2, b"\1\0\1") == []
    assert bench.say(2, 2, b"\1") == bench.say(2, 1, b"") == []


def test_a_parameter_is_set_by_its_name_or_an_error_says_why_not() -> None:
    bench = Bench()
    for name, rest, error in (
        (b"motorPowerSet\0m1\0", b"\x09\x30\x75", 0),
        (b"motorPowerSet\0m5\0", b"\x09\x30\x75", 2),
        (b"motorPowerSet\0m1\0", b"\x08\x01", 22),
        (b"system\0selftestPassed\0", b"\x00\x00", 13),
    ):
        assert bench.ask(2, 3, b"\0" + name + rest) == b"\0" + name + bytes([error])
    assert bench.ask(2, 1, b"\1\0") == b"\1\0\0\x30\x75"
    assert bench.say(2, 3, b"\0motorPowerSet\0m1") == []


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


def test_compensated_for_the_battery_a_command_rises_as_the_voltage_falls() -> None:
    bench = Bench(battery=BatteryTruth(volts=4.2))
    bench.drive((32768, 0, 0, 0), enable=3)
    bench.wait(0.002)
    full = bench.motors[0]
    assert bench.motors == (full,) * 4
    assert compensated(32768, volts=3.0) == pytest.approx(full * 4.2 / 3.0, abs=2)
    assert compensated(65535, volts=2.5) == 65535
    assert compensated(32768, volts=1.9) == compensated(5000, volts=4.2) == 0
    motor_v = full / 65535 * 4.2  # at which the firmware's cubic gives half of 0.12 N
    cubic_n = (0.005960923942142, -0.01847364358025878, 0.04724465241828281, -0.014830744918356092)
    assert np.polyval(cubic_n, motor_v) == pytest.approx(0.06, rel=1e-3)


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


def test_motors_of_motor_power_set_outlive_tumble_emergency_stop_and_a_client_that_is_gone() -> None:
    bench = Bench()
    bench.drive((30000,) * 4)
    bench.wait(0.1)
    bench.vehicle.turn(-1.0)
    bench.wait(1.0)
    assert bench.ask(9, 0, b"\x0c") == b"\x8c" + CRASHED
    bench.say(9, 1, b"\3")
    bench.wait(30.0)
    assert bench.motors == (30000,) * 4
    assert bench.ask(9, 0, b"\x0c") == b"\x8c" + (0x264 | 0x80).to_bytes(2, "little")  # also locked


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


def test_stock_firmware_says_nothing_on_the_apps_ports_and_has_motor_power_set() -> None:
    bench = Bench(CrazyflieTruth(firmware="stock"))
    for port in AppPorts():
        for channel in range(4):
            assert bench.say(port, channel, b"\0" * 12) == []
    bench.drive((20000, 0, 0, 0))
    bench.wait(0.01)
    assert bench.motors == (20000, 0, 0, 0)


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


def test_a_block_that_is_stopped_or_deleted_comes_no_more() -> None:
    bench = Bench()
    bench.log("pm.vbat", period_ms=1)
    assert len(bench.wait(0.01)) == 10
    assert bench.ask(5, 1, b"\4\7") == b"\4\7\0"
    assert bench.wait(0.01) == []
    assert bench.ask(5, 1, b"\3\7\2") == b"\3\7\0"
    assert len(bench.wait(0.1)) == 5
    assert bench.ask(5, 1, b"\2\7") == b"\2\7\0"
    assert bench.ask(5, 1, b"\2\7") == b"\2\7\2"
    assert bench.wait(0.1) == []


def test_a_value_is_sent_as_the_type_that_is_asked_for() -> None:
    bench = Bench(battery=BatteryTruth(volts=3.75))
    bench.log("pm.vbatMV", "pm.vbatMV", "pm.vbat", "pm.vbat", period_ms=1, kinds="BfHe")
    ((_, _, values),) = rows_of(bench.wait(0.001), "BfHe")
    assert values == (3750 % 256, 3750.0, 3, 3.75)
    bench.drive((65535, 0, 0, 0))
    bench.wait(0.01)
    bench.log("motor.m1", period_ms=1, block=8, kinds="e")
    assert rows_of(bench.wait(0.001), "e", block=8)[0][2] == (float("inf"),)  # too large for a half


def test_wrong_requests_for_blocks_are_answered_with_their_error() -> None:
    bench = Bench()
    entry = struct.pack("<BH", 7, bench.table()["pm.vbat"][0])
    for command in (2, 3, 4, 7, 8):
        assert bench.ask(5, 1, bytes([command, 9])) == bytes([command, 9, 2])  # no such block
    assert bench.ask(5, 1, b"\0\1") == b"\0\1\x08"  # no such command
    assert bench.ask(5, 1, b"\6\1\7\xfe\xff") == b"\6\1\2"  # no such variable
    assert bench.ask(5, 1, b"\6\1" + entry) == b"\6\1\x11"  # the block exists already
    assert bench.ask(5, 1, b"\6\2" + 6 * entry) == b"\6\2\0"
    assert bench.ask(5, 1, b"\7\2" + entry) == b"\7\2\7"  # 28 bytes, of which 26 fit
    assert [bench.ask(5, 1, bytes([6, block]))[2] for block in range(3, 18)] == [0] * 14 + [12]  # at most 16 blocks
    assert bench.ask(5, 1, b"\5") == b"\5\0\0"
    small = 9 * struct.pack("<BH", 1, 0)
    blocks = [bench.ask(5, 1, bytes([6 + append, block]) + small)[2] for block in range(14) for append in (0, 1)]
    assert blocks[:14] == [0] * 14
    assert blocks[14:16] == [12, 12]  # at most 128 variables
    assert bench.ask(5, 0, b"\2\xff\xff") == b"\2"


def test_a_client_that_is_gone_is_logged_to_no_more_and_the_vehicle_rests() -> None:
    bench = Bench()
    bench.log("motor.m1", period_ms=10)
    assert len(bench.wait(60.0)) == 300
    assert bench.faulty.next_s(OPENED_S + bench.now_s) is None


def test_speeds_are_logged_by_those_that_can_measure_them() -> None:
    assert not [name for name in Bench().table() if "rpm" in name]
    for truth, name, rotors in (
        (WITH_DECK, "rpm.m2", RotorTruth()),
        (BRUSHLESS, "motor.m2_rpm", RotorTruth(**ROTORS_OF_BRUSHLESS)),
    ):
        steady = rotors.steady_rad_per_s(np.array(40000.0), volts=3.7) * 60 / (2 * np.pi)
        bench = Bench(truth)
        bench.drive((0, 40000, 0, 0))
        bench.wait(2.0)
        bench.log(name, period_ms=10)
        assert rows_of(bench.wait(0.01), "H")[0][2] == (pytest.approx(steady, rel=1e-4),)


def test_the_log_says_what_the_supervisor_thinks() -> None:
    bench = Bench()
    bench.drive((2000, 0, 0, 0))
    bench.wait(0.1)
    bench.log("supervisor.info", "sys.canfly", "sys.isFlying", "sys.isTumbled", "acc.z", period_ms=10)
    assert rows_of(bench.wait(0.012), "HBBBf")[0][2] == (0x21E, 1, 1, 0, 1.0)
    bench.vehicle.turn(-1.0)
    assert rows_of(bench.wait(0.3), "HBBBf")[-1][2] == (0x2A4, 0, 0, 1, -1.0)


# Time


def test_a_vehicle_at_rest_wants_no_attention_and_one_with_motors_wants_it_every_millisecond() -> None:
    bench = Bench()
    bench.say(15, 0, b"ping")
    assert bench.vehicle.next_s is None
    bench.drive((1000, 0, 0, 0))
    bench.wait(10.0)
    assert bench.vehicle.next_s == pytest.approx(OPENED_S + 10.001)
    bench.set("motorPowerSet.enable", 0)
    bench.wait(10.0)
    assert bench.vehicle.next_s is None


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
