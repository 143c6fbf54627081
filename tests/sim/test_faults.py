"""Faults of the simulated devices: each has its stated effect and counts its occurrences."""

import re
import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cfid.errors import ConfigError
from cfid.sim.crazyflie import CrazyflieTruth
from cfid.sim.e201 import E201Device
from cfid.sim.faults import (
    SOUND_CRAZYFLIE,
    SOUND_ENCODER,
    SOUND_LOADCELL,
    CrazyflieFaults,
    EncoderFaults,
    FaultyNetFT,
    FaultySerial,
    LoadCellFaults,
    parse_faults,
)
from cfid.sim.link import RadioTruth
from cfid.sim.loadcell import SATURATED, LoadCellTruth, SimulatedLoadCell
from cfid.sim.netft import NetFTBox
from cfid.sim.propulsion import STILL, BatteryTruth
from cfid.wire.app import ALL_MOTORS_THRUST, AppPorts, PingChannel, ThrustChannel, ThrustRequest, encode_thrust
from cfid.wire.rdt import Command, Records, Request, decode_records, encode_request, is_block
from tests.sim.vehicle import CLIENT, OPENED_S, OTHER_CLIENT, Bench, rows_of

START = encode_request(Request(Command.REAL_TIME))


def _faulty(faults: LoadCellFaults, *, buffer_size: int = 1) -> FaultyNetFT:
    cell_rng, fault_rng = np.random.default_rng(2).spawn(2)  # faults must not change the noise
    box = NetFTBox(
        load_cell=SimulatedLoadCell(LoadCellTruth(), cell_rng),
        plant=lambda time_s: np.zeros((len(time_s), 6)),
        buffer_size=buffer_size,
        powered_s=100.0,
    )
    return FaultyNetFT(box, faults, opened_s=100.0, rng=fault_rng)


def _stream(faulty: FaultyNetFT, *, until_s: float, request: bytes = START) -> list[bytes]:
    """Send the request at time zero, and return the datagrams collected every 2 ms."""
    faulty.request(request, CLIENT, 100.0)
    return [data for i in range(1, round(until_s * 500) + 1) for data, _ in faulty.due(100 + i / 500)]


def _records(datagrams: list[bytes]) -> Records:
    return decode_records(b"".join(datagrams))


def test_dropped_datagrams_are_missing_and_counted_in_records() -> None:
    faulty = _faulty(LoadCellFaults(drop_every=10), buffer_size=40)
    datagrams = _stream(faulty, until_s=1, request=encode_request(Request(Command.BUFFERED)))
    records = _records(datagrams)
    assert faulty.mishaps["drop_every"] == 17 * 40
    assert records["rdt_sequence"][-1] - len(records) == 17 * 40


def test_doubled_datagrams_come_twice_and_reordered_ones_swap_with_the_next() -> None:
    doubled, swapped = _faulty(LoadCellFaults(duplicate_every=50)), _faulty(LoadCellFaults(reorder_every=100))
    sequence = _records(_stream(doubled, until_s=1))["rdt_sequence"]
    assert len(sequence) - len(np.unique(sequence)) == doubled.mishaps["duplicate_every"] == 140
    sequence = _records(_stream(swapped, until_s=1))["rdt_sequence"].astype(int)
    assert np.sum(np.diff(sequence) < 0) == pytest.approx(70, abs=1)
    assert set(range(1, len(sequence))) <= set(sequence.tolist())


def test_corrupted_datagrams_are_cut_short_or_have_one_bit_flipped_in_turns() -> None:
    faulty, sound = _faulty(LoadCellFaults(corrupt_every=100)), _faulty(SOUND_LOADCELL)
    pairs = list(zip(_stream(faulty, until_s=1), _stream(sound, until_s=1), strict=True))
    cut = [data for data, _ in pairs if not is_block(len(data))]
    assert len(cut) == 35
    flipped = [
        (int.from_bytes(data) ^ int.from_bytes(as_sent)).bit_count() for data, as_sent in pairs if is_block(len(data))
    ]
    assert sorted(flipped) == [0] * 6930 + [1] * 35


@pytest.mark.parametrize(
    ("faults", "received_s"),
    [
        (LoadCellFaults(silent_after_s=0.2), {0.1: True, 0.5: False, 0.9: False}),
        (LoadCellFaults(silent_after_s=0.2, silent_for_s=0.5), {0.1: True, 0.5: False, 0.9: True}),
        (LoadCellFaults(udp_blocked=True), {0.1: False, 0.5: False, 0.9: False}),
        (LoadCellFaults(second_client_after_s=0.4), {0.1: True, 0.5: False, 0.9: False}),
        (LoadCellFaults(restart_after_s=0.2), {0.1: True, 0.5: False, 0.9: False}),
    ],
)
def test_a_stream_falls_silent_when_it_should(faults: LoadCellFaults, received_s: dict[float, bool]) -> None:
    faulty = _faulty(faults)
    faulty.request(START, CLIENT, 100.0)
    received = {}
    for at_s in received_s:
        faulty.due(100 + at_s - 0.002)
        received[at_s] = bool(faulty.due(100 + at_s))
    assert received == received_s


def test_a_status_and_a_saturation_come_when_they_should() -> None:
    early = LoadCellFaults(status_after_s=0.5)
    status = _records(_stream(_faulty(early), until_s=1))["status"]
    assert (status[0], status[-1]) == (0, 0x80010000)
    overloaded = _records(_stream(_faulty(LoadCellFaults(saturate_after_s=0.5)), until_s=1))
    assert (overloaded["status"][0], overloaded["status"][-1]) == (0, SATURATED)
    assert overloaded["counts"][-1, 2] == 60_000_000


def _replies(faults: EncoderFaults, *, at_s: float = 0.0, questions: int = 12) -> tuple[list[bytes], FaultySerial]:
    faulty = FaultySerial(E201Device(lambda _: 1.0), faults, opened_s=0.0)
    return [reply for _ in range(questions) for _, reply in faulty.received(b"?", at_s)], faulty


def test_garbled_replies_lose_bytes_or_their_end_or_begin_with_junk() -> None:
    sound = _replies(SOUND_ENCODER)[0][0]
    replies, faulty = _replies(EncoderFaults(corrupt_every=4))
    odd = [reply for reply in replies if reply != sound]
    assert faulty.mishaps["corrupt_every"] == len(odd) == 3
    assert len(odd[0]) == len(sound) - 2
    assert odd[1] == sound[:-1]
    assert odd[2].endswith(sound)


def test_a_split_reply_is_whole_when_put_together() -> None:
    faulty = FaultySerial(E201Device(lambda _: 1.0), EncoderFaults(split=True, slow_s=0.1), opened_s=0.0)
    (first_s, first), (second_s, second) = faulty.received(b"?", 0.0)
    assert 0.1 == first_s < second_s
    assert first + second == _replies(SOUND_ENCODER)[0][0]


def test_a_wrong_width_reads_other_words_than_it_says() -> None:
    replies, faulty = _replies(EncoderFaults(wrong_width=13))
    assert int(replies[0]) < 8192
    assert faulty.received(b"b", 0.0)[0][1] == b"22\r"


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
    assert bool(rows_of(bench.wait(0.1), "H")) == heard[-1]


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
