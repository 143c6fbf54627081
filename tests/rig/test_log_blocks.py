"""What the motors do is read from one block of the vehicle's log, and whatever goes wrong with it is no zero."""

import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cfid.rig.motors import MAY_BE_RUNNING
from cfid.rig.recorder import sleep
from tests.flying_in_a_folder import Bench, bench_in
from tests.rig.flying import Flight
from tests.rig.test_disturbed_vehicle_links import relayed

CREATED, DELETE, ROW = b"\x06", b"\x02", (5, 2)


@pytest.fixture(params=["app", "stock"])
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    with bench_in(tmp_path, crazyflie={"firmware": request.param}) as bench:
        yield bench


def place(packet: bytes) -> tuple[int, int]:
    return packet[0] >> 4, packet[0] & 3


@contextmanager
def another_program(bench: Bench, motor: int) -> Iterator[None]:
    """Drive one motor from elsewhere, over ports that this computer's rig.toml does not name."""
    rig = bench.folder / "rig.toml"
    rig.write_text(rig.read_text() + "thrust_port = 1\nsine_port = 6\nping_port = 14\n")
    ended = Event()
    packets = (b"\xc2" + bytes(4) + b"\x4d\0\0\0", b"\xa0" + struct.pack("<Hi", 30000, motor - 1) + b"\x4d\0\0\0")

    def drive() -> None:
        for packet in packets:
            bench.rig.crazyflie.vehicle.receive(packet, time.monotonic())

    def go_on() -> None:
        while not ended.wait(0.02):
            bench.in_loop(drive)

    thread = Thread(target=go_on)
    thread.start()
    try:
        while not bench.motors[motor - 1]:
            time.sleep(0.01)
        yield
    finally:
        ended.set()
        thread.join()


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_motor_that_another_program_drives_is_seen_whichever_packet_is_lost(tmp_path: Path, lost: int) -> None:
    """Version 0.2 read motor 1 in place of motor 2 when one request to delete a block was lost, and exited with 0."""
    left = [True] * lost

    def leaving(packet: bytes) -> bool:
        return not (place(packet) == (5, 1) and packet[1:2] == DELETE and left and left.pop())

    with bench_in(tmp_path) as bench, another_program(bench, motor=2):
        with relayed(bench.uri, lambda packet: [packet], leaving) as uri:
            ended = bench.start("motors", "stop", "--uri", uri)
            assert ended.end() == 3, ended.out
        assert MAY_BE_RUNNING in ended.err
        assert "30000" in ended.err
        assert bench.motors[1] == 30000


def no_rows(packet: bytes) -> list[bytes]:
    return [] if place(packet) == ROW else [packet]


def refused(packet: bytes) -> list[bytes]:
    """Replace the answer to the creation of a block by one of a vehicle without memory for it."""
    return [packet[:3] + b"\x0c"] if place(packet) == (5, 1) and packet[1:2] == CREATED else [packet]


@pytest.mark.parametrize("disturbed", [no_rows, refused])
def test_a_log_that_says_nothing_confirms_no_stop(bench: Bench, disturbed: Callable[[bytes], list[bytes]]) -> None:
    """Version 0.2 counted every motor whose row did not come as a motor at zero."""
    with relayed(bench.uri, disturbed) as uri:
        ended = bench.start("motors", "stop", "--uri", uri)
        assert ended.end() == 3, ended.out
    assert MAY_BE_RUNNING in ended.err
    assert "motors stopped" not in ended.out


def test_a_command_that_drove_the_motors_reads_its_own_stop_from_the_log(bench: Bench) -> None:
    rows_end = Event()

    def arriving(packet: bytes) -> list[bytes]:
        return no_rows(packet) if rows_end.is_set() else [packet]

    with relayed(bench.uri, arriving) as uri:
        pilot = bench.start("motors", "set", 20000, "--yes", "--for", 1, "--uri", uri)
        pilot.wait_until_motors_run(0.8)
        rows_end.set()
        assert pilot.end() == 3, pilot.out
    assert MAY_BE_RUNNING in pilot.err
    assert not any(bench.motors)


def test_a_second_log_over_a_link_has_its_own_values(tmp_path: Path) -> None:
    """Version 0.2 wrote the values of the first log's variables under the names of the second's: 0.0 for 1 g."""
    flight = Flight(tmp_path)

    def logged(*names: str) -> pd.DataFrame:
        run, failure = flight.record([flight.log(*names)], lambda _: wait(flight))
        assert failure is None
        assert (run.header.devices["crazyflie"].model_extra or {})["losses"]["rejected"] == 0
        return pd.read_csv(run.device_file("crazyflie"))

    assert logged("gyro.x", "gyro.y", "gyro.z")["gyro.z"].to_numpy() == pytest.approx(0.0)
    assert logged("acc.x", "acc.y", "acc.z")["acc.z"].to_numpy() == pytest.approx(1.0)
    assert np.all(logged("pm.vbat", "motor.m1", "motor.m2")["pm.vbat"] > 3)


async def wait(flight: Flight) -> Any:
    await sleep(flight.clock, 0.3)


def test_no_block_stays_on_the_vehicle_after_a_recording(tmp_path: Path) -> None:
    flight = Flight(tmp_path)
    before = [flight.sim.vehicle.receive(block(number), flight.clock.seconds()) for number in range(16)]
    assert all(answers[-1].packet[-1] == 0 for answers in before)
    flight.sim.vehicle.receive(b"\x5d\x05", flight.clock.seconds())
    for _ in range(20):
        _, failure = flight.record([flight.log()], lambda _: wait(flight))
        assert failure is None
    after = [flight.sim.vehicle.receive(block(number), flight.clock.seconds()) for number in range(16)]
    assert all(answers[-1].packet[-1] == 0 for answers in after)


def block(number: int) -> bytes:
    """Return the request to create an empty block."""
    return bytes([0x5D, 6, number])


def test_a_block_of_another_program_is_left_as_it_is(tmp_path: Path) -> None:
    flight = Flight(tmp_path)
    send = partial(flight.sim.vehicle.receive, now_s=flight.clock.seconds())
    taken = [number for number in range(120, 136) if send(block(number))[-1].packet[-1] == 0]
    for number in taken[:4]:
        send(bytes([0x5D, 2, number]))
    run, failure = flight.record([flight.log()], lambda _: wait(flight))
    assert failure is None
    assert (run.header.devices["crazyflie"].rows or 0) >= 15
    kept = [send(block(number))[-1].packet[-1] for number in taken[4:]]
    assert kept == [17] * len(kept)
