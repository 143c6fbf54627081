"""Faults of the simulated devices: each has its stated effect and counts its occurrences."""

import re
import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cfid.errors import ConfigError
from cfid.sim.crazyflie import CrazyflieTruth
from cfid.sim.faults import (
    SOUND_CRAZYFLIE,
    SOUND_ENCODER,
    SOUND_LOADCELL,
    CrazyflieFaults,
    EncoderFaults,
    LoadCellFaults,
    parse_faults,
)
from cfid.sim.link import RadioTruth
from cfid.sim.propulsion import STILL
from cfid.wire.app import ALL_MOTORS_THRUST, AppPorts, PingChannel, ThrustChannel, ThrustRequest, encode_thrust
from tests.sim.vehicle import CLIENT, OPENED_S, Bench


def test_words_name_faults_of_all_devices() -> None:
    encoder, loadcell, crazyflie = parse_faults(
        [
            "loadcell.drop_every=100",
            "encoder.split=true",
            "crazyflie.busy=true",
            "loadcell.status=0x80020000",
            "loadcell.silent_after_s=2.5",
            "crazyflie.tumble_after_s=3",
        ]
    )
    assert encoder == EncoderFaults(split=True)
    assert loadcell == LoadCellFaults(drop_every=100, status=0x80020000, silent_after_s=2.5)
    assert crazyflie == CrazyflieFaults(busy=True, tumble_after_s=3.0)
    assert parse_faults([]) == (SOUND_ENCODER, SOUND_LOADCELL, SOUND_CRAZYFLIE)


@pytest.mark.parametrize(
    "word",
    [
        "loadcell.dorp_every=3",
        "drop_every=3",
        "loadcell.drop_every=x",
        "loadcell.drop_every=1.5",
        "loadcell.drop_every=-1",
        "loadcell.slow_s=nan",
        "loadcell.slow_s=inf",
        "loadcell.status=0x1_0000_0000",
        "encoder.split=maybe",
        "encoder.split",
        "encoder.wrong_width=33",
        "crazyflie.tumble_deg=181",
    ],
)
def test_a_fault_that_cannot_be_is_told(word: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(word.partition("=")[0])):
        parse_faults([word])


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


# The vehicle


@pytest.mark.parametrize(
    ("faults", "within_s"), [(TUMBLE, 0.2), (EMERGENCY, 0.05), (CrazyflieFaults(reboot_after_s=0.5), 0.002)]
)
def test_what_stops_a_flight_stops_the_apps_motors_then_and_for_good(faults: CrazyflieFaults, within_s: float) -> None:
    bench = Bench(faults=faults)
    _run_app(bench, for_s=2.0)
    assert [motors for _, motors in bench.changes] == [RUNNING, STILL]
    assert 0.5 <= bench.changes[1][0] <= 0.5 + within_s


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


# The radio


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
