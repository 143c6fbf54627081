"""Faults of the simulated vehicle and its link: each has its stated effect and counts its occurrences."""

import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cfid.sim.crazyflie import CrazyflieTruth
from cfid.sim.faults import CrazyflieFaults
from cfid.sim.link import RadioTruth
from cfid.sim.propulsion import STILL, BatteryTruth
from cfid.wire.app import ALL_MOTORS_THRUST, AppPorts, PingChannel, ThrustChannel, ThrustRequest, encode_thrust
from cfid.wire.crtp import encode_echo
from tests.sim.vehicle import CLIENT, OPENED_S, OTHER_CLIENT, Bench, rows_of

PORTS = AppPorts()
RUNNING = (25000,) * 4
TUMBLE, EMERGENCY = CrazyflieFaults(tumble_after_s=0.5), CrazyflieFaults(emergency_after_s=0.5)


def _run_app(bench: Bench, *, for_s: float) -> None:
    """Drive all motors through the app, and keep the app alive throughout."""
    bench.keep_alive()
    bench.say(PORTS.thrust, ThrustChannel.SET, encode_thrust(ThrustRequest(RUNNING[0], ALL_MOTORS_THRUST)))
    for _ in range(round(for_s / 0.1)):
        bench.wait(0.1)
        bench.keep_alive()


def _echo(bench: Bench) -> bool:
    return bool(bench.say(15, 0, b"\1"))


# The link


def test_dropped_packets_are_missing_in_either_direction() -> None:
    bench = Bench(faults=CrazyflieFaults(drop_every=10))
    assert [_echo(bench) for _ in range(100)].count(False) == bench.faulty.mishaps.dropped == 10
    bench = Bench(faults=CrazyflieFaults(drop_to_vehicle_every=4))
    assert [_echo(bench) for _ in range(100)].count(False) == bench.faulty.mishaps.dropped_to_vehicle == 25


@pytest.mark.parametrize(("for_s", "heard"), [(None, [True, False, False]), (0.5, [True, False, True])])
def test_a_silent_link_passes_nothing_either_way(for_s: float | None, heard: list[bool]) -> None:
    bench = Bench(faults=CrazyflieFaults(silent_after_s=0.2, silent_for_s=for_s))
    bench.log("motor.m1", period_ms=10)
    answers = []
    for _ in range(3):
        bench.wait(0.1)
        answers.append(_echo(bench))
        bench.wait(0.3)
    assert answers == heard
    rows = rows_of(bench.wait(0.1), "H")
    assert bool(rows) == heard[-1]
    assert bench.faulty.mishaps.silenced > 30


def test_a_closed_port_leaves_the_vehicle_going_on() -> None:
    bench = Bench(faults=CrazyflieFaults(closed_after_s=0.5))
    assert not bench.faulty.closed(OPENED_S + 0.49)
    assert bench.faulty.next_s(OPENED_S) == OPENED_S + 0.5
    assert bench.faulty.closed(OPENED_S + 0.5)
    bench.drive(RUNNING)
    bench.wait(1.0)
    assert bench.motors == RUNNING


def test_a_second_client_is_answered_unless_the_vehicle_is_busy() -> None:
    for busy in (False, True):
        bench = Bench(faults=CrazyflieFaults(busy=busy))
        assert _echo(bench)
        answers = bench.say_and_hear(15, 0, b"\1", client=OTHER_CLIENT)
        assert [client for _, client in answers] == ([] if busy else [OTHER_CLIENT])
        assert bench.faulty.mishaps.refused == busy
        assert bench.say_and_hear(15, 0, b"\1")[0][1] == CLIENT
        bench.wait(1.1)
        assert bench.say_and_hear(15, 0, b"\1", client=OTHER_CLIENT)  # the first client is gone


# The vehicle


@pytest.mark.parametrize(
    ("faults", "within_s"), [(TUMBLE, 0.2), (EMERGENCY, 0.05), (CrazyflieFaults(reboot_after_s=0.5), 0.002)]
)
def test_what_stops_a_flight_stops_the_apps_motors_then_and_for_good(faults: CrazyflieFaults, within_s: float) -> None:
    bench = Bench(faults=faults)
    _run_app(bench, for_s=2.0)
    assert [motors for _, motors in bench.changes] == [RUNNING, STILL]
    assert 0.5 <= bench.changes[1][0] <= 0.5 + within_s


def test_a_battery_that_falls_shows_2_9_volts_and_slower_rotors() -> None:
    bench = Bench(CrazyflieTruth(rpm_deck=True), faults=CrazyflieFaults(low_battery_after_s=1.0))
    bench.drive((40000, 0, 0, 0))
    bench.wait(0.9)
    bench.log("pm.vbat", "rpm.m1", period_ms=10)
    rows = rows_of(bench.wait(1.0), "fH")
    assert rows[0][2] == pytest.approx((3.7, 19200), rel=0.01)
    assert rows[-1][2] == pytest.approx((2.9, 19200 * (381 + 1632 * 2.9 / 3.7) / (381 + 1632)), rel=0.01)


def test_a_restarted_vehicle_is_deaf_for_a_second_and_starts_from_nothing() -> None:
    bench = Bench(faults=CrazyflieFaults(reboot_after_s=1.0))
    bench.drive(RUNNING)
    bench.log("motor.m1", period_ms=10)
    assert bench.wait(0.995)[-1][1][5:] == struct.pack("<H", RUNNING[0])
    bench.wait(0.01)
    assert not _echo(bench)
    bench.wait(1.0)
    assert _echo(bench)
    assert bench.motors == STILL
    assert bench.wait(1.0) == []
    stamp = struct.unpack("<Q", bench.ask(PORTS.ping, PingChannel.PING, b"a")[1:])[0]
    assert stamp == pytest.approx((bench.now_s - 1.0) * 1e6, abs=2)


def test_faults_can_come_and_go_while_it_runs() -> None:
    bench = Bench(battery=BatteryTruth(volts=3.9))
    bench.faulty.faults = CrazyflieFaults(silent_after_s=0, low_battery_after_s=0, protocol=3)
    assert not _echo(bench)
    bench.faulty.faults = CrazyflieFaults(low_battery_after_s=0, protocol=3)
    assert bench.ask(13, 1, b"\0")[1] == 3
    assert bench.vehicle.volts == 2.9
    bench.faulty.faults = CrazyflieFaults()
    assert bench.ask(13, 1, b"\0")[1] == 12
    assert bench.vehicle.volts == 3.9


# The radio


def test_answers_come_as_late_as_the_radio_says_and_pings_are_remembered() -> None:
    bench = Bench(radio=RadioTruth(latency_s=0.02, jitter_s=0.005))
    asked, late_s = [], []
    for number in range(300):
        asked_s = bench.now_s
        port, payload = ((PORTS.ping, b"abcd"), (15, encode_echo(number)))[number % 2]
        assert bench.say(port, 0, payload) == []
        ((came_s, _),) = bench.wait(0.2)
        asked.append((port, payload))
        late_s.append(came_s - asked_s)
    pings = bench.faulty.radio.pings
    assert [ping[:2] for ping in pings] == asked
    assert [ping.round_trip_s for ping in pings] == pytest.approx(late_s)
    assert np.mean(late_s) == pytest.approx(0.04, rel=0.03)
    assert min(late_s) > 0.03


@settings(max_examples=50)
@given(
    steps_s=st.lists(st.floats(0, 0.05), min_size=1, max_size=30),
    faults=st.builds(
        CrazyflieFaults,
        drop_every=st.integers(0, 3),
        tumble_after_s=st.none() | st.floats(0, 0.5),
        reboot_after_s=st.none() | st.floats(0, 0.5),
        silent_after_s=st.none() | st.floats(0, 0.5),
    ),
)
@example(steps_s=[0.046875], faults=CrazyflieFaults(reboot_after_s=0.03260903043399844))
def test_how_often_the_server_looks_changes_nothing(steps_s: list[float], faults: CrazyflieFaults) -> None:
    def heard(looks_s: list[float]) -> list[bytes]:
        bench = Bench(CrazyflieTruth(firmware="stock"), faults=faults, radio=RadioTruth(latency_s=0.01, jitter_s=0.005))
        bench.faulty.received(b"\x5d\x06\x01\x77\x00\x00\x22\x11\x00", CLIENT, OPENED_S)
        bench.faulty.received(b"\x5d\x08\x01\x03\x00", CLIENT, OPENED_S)
        for name, value in ((b"m1", b"\x09\x30\x75"), (b"enable", b"\x08\x01")):
            bench.faulty.received(b"\x2f\x00motorPowerSet\x00" + name + b"\x00" + value, CLIENT, OPENED_S)
        return [packet for look_s in [*looks_s, 2.0] for packet, _ in bench.faulty.due(OPENED_S + look_s)]

    assert heard([]) == heard(list(np.cumsum(steps_s)))
