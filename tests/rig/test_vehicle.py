"""What a vehicle sends is recorded as it sent it, and what its link loses, repeats or holds up is counted."""

import json
import queue
import random
import socket
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cflib.crtp
import numpy as np
import pytest
from cflib.crazyflie import Crazyflie
from cflib.crtp.crtpstack import CRTPPacket
from cflib.crtp.exceptions import WrongUriType

from cfid.errors import DeviceError
from cfid.latency.record import ping_often
from cfid.motors.plan import StaircasePlan
from cfid.recordings.angle import angle_record
from cfid.recordings.vehicle import read_rows
from cfid.rig.link import Link, open_link
from cfid.rig.ready_vehicle import INERTIAL
from cfid.rig.tables import connect
from cfid.rig.vehicle import BATTERY
from cfid.wire.app import AppPorts, SineChannel, SineRequest, omega_of
from cfid.wire.crtp import LogCommand, Packet
from tests.flying_in_a_folder import bench_in as served_in
from tests.lab import known
from tests.rig.flying import Flight, Procedure, facts, flight_in, rows
from tests.virtual_bench import UNIX_S, Bench, bench_in

KINDS = pytest.mark.parametrize("firmware", ["app", "stock"])
RADIO = {"latency_s": 0.0285, "jitter_s": 0.008}  # table 3.2
STAIRS = StaircasePlan(steps=(0, 10000, 20000), motors=(1, 3), hold_s=0.5, rest_s=0.3)


def pinging(flight: Flight, count: int) -> Procedure:
    return lambda there: ping_often(
        there["pings"], count=count, every_s=0.1, hardware=flight.hardware, tell=lambda _: None
    )


def waiting(flight: Flight, for_s: float) -> Procedure:
    async def wait(_: Any) -> None:
        await flight.hardware.sleep(for_s)

    return wait


def sine(periods: int, samples: int = 500, *, motor: int = 1) -> SineRequest:
    return SineRequest(motor, 20000, omega_of(periods, samples), samples)


def commanded(periods: int, samples: int = 500) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return the commands of eq. 3.6, cut and clipped."""
    exact = 20000 * np.cos(2 * np.pi * periods * np.arange(samples) / samples) + 30000
    return np.clip(np.trunc(np.round(exact, 6)), 0, 65535).astype(np.int64)


def crossings_of(u: np.ndarray[Any, np.dtype[np.int64]]) -> list[int]:
    """Return where C.2.4 reports: at the first sample, and where the middle is crossed or reached."""
    falls = (u[:-1] > 30000) & (u[1:] <= 30000)
    rises = (u[:-1] < 30000) & (u[1:] >= 30000)
    return [0, *(np.flatnonzero(falls | rises) + 1).tolist()]


# Commands, sines, pings


@KINDS
def test_a_staircase_drives_the_motors_and_its_commands_are_recorded_as_they_left(
    tmp_path: Path, firmware: str
) -> None:
    with flight_in(tmp_path, crazyflie={"firmware": firmware}) as flight:
        run, failure = flight.record([flight.ready.commands(), flight.ready.usual_log()], flight.climbing(STAIRS))
    assert failure is None
    driven = [motors for _, motors in flight.history]
    assert {(10000, 0, 10000, 0), (20000, 0, 20000, 0)} <= set(driven)
    assert all(motors[1] == motors[3] == 0 for motors in driven)
    assert driven[-1] == (0, 0, 0, 0)
    commands = rows(run, "commands")
    steps = commands[commands.m1 > 0]
    assert steps.m1.tolist() == [10000, 20000]
    for _, row in steps.iterrows():
        began_s = next(time_s for time_s, motors in flight.history if motors[0] == row.m1)
        assert row.t - UNIX_S + 1.0 == pytest.approx(began_s, abs=0.02)
    log = rows(run, "crazyflie")
    assert set(log["motor.m1"]) == {0, 10000, 20000}
    assert (log[BATTERY] > 3).all()


@pytest.mark.parametrize("periods", [0, 7, 249, 250])
def test_the_crossings_of_a_sine_are_those_of_equation_3_6(tmp_path: Path, periods: int) -> None:
    u = commanded(periods)
    with flight_in(tmp_path) as flight:
        run, failure = flight.record([flight.ready.crossings()], flight.playing(sine(periods, motor=2)))
    assert failure is None
    reports, expected = rows(run, "crossings"), crossings_of(u)
    assert reports["sample"].tolist() == [*expected, len(u)]
    assert reports.thrust_rec.to_numpy() == pytest.approx([*u[expected], 0], abs=1)
    on_board_s = np.diff(reports.vehicle_us.to_numpy()) / 1e6
    assert on_board_s == pytest.approx(np.diff(reports["sample"].to_numpy()) / 500, abs=0.0021)
    assert reports.report.tolist() == list(range(len(reports)))
    assert run.header.devices["crossings"].lost == 0
    driven = np.array([motors for _, motors in flight.history])
    assert driven[:, 1].max() == 50000
    assert not driven[:, [0, 2, 3]].any()


@pytest.mark.parametrize("lost", [(0,), (3, 4, 40), (7, 81)])
def test_reports_of_a_sine_that_the_link_lost_are_counted(tmp_path: Path, lost: tuple[int, ...]) -> None:
    """The last of the 82 reports is followed by none that would show that it is missing."""
    place = (AppPorts().sine, SineChannel.CROSSING)
    with flight_in(tmp_path) as flight:
        numbers = iter(range(1000))
        flight.disturb(lambda packet: [] if packet[:2] == place and next(numbers) in lost else [packet])
        run, failure = flight.record([flight.ready.crossings()], flight.playing(sine(40)))
    assert failure is None
    assert len(crossings_of(commanded(40))) + 1 - len(rows(run, "crossings")) == len(lost)
    assert run.header.devices["crossings"].lost == len(lost)


@pytest.mark.parametrize("pause_s", [0.0, 0.6])
def test_the_end_of_an_interrupted_sine_is_not_taken_for_that_of_the_next(tmp_path: Path, pause_s: float) -> None:
    with flight_in(tmp_path) as flight:
        flight.hardware.at(0.5, flight.hardware.request_end, "SIGTERM")
        first, _ = flight.record([flight.ready.crossings(), *flight.ready.watch()], flight.playing(sine(5)))
        flight.go_on(pause_s)
        second, failure = flight.record([flight.ready.crossings()], flight.playing(sine(5)))
    assert failure is None
    assert rows(first, "crossings")["sample"].max() < 500
    assert rows(second, "crossings")["sample"].tolist() == [*crossings_of(commanded(5)), 500]


@KINDS
def test_round_trips_are_those_of_the_radio(tmp_path: Path, firmware: str) -> None:
    with flight_in(tmp_path, crazyflie={"firmware": firmware}, radio=RADIO) as flight:
        run, failure = flight.record([flight.ready.pings()], pinging(flight, 200))
        pings = flight.rig.crazyflie.radio.pings
        port = 15 if firmware == "stock" else AppPorts().ping
        own = [
            p for p in pings if p.port == port and (port != 15 or any(p.payload[1:]))
        ]  # its own echoes have number 0
    assert failure is None
    injected_s = [ping.round_trip_s for ping in own[-200:]]
    assert rows(run, "pings").rtt_s.to_numpy() == pytest.approx(injected_s, abs=1e-6)


@KINDS
def test_a_lossy_link_costs_repetitions_and_no_command(tmp_path: Path, firmware: str) -> None:
    with flight_in(tmp_path, crazyflie={"firmware": firmware}, radio={"loss": 0.1}) as flight:
        _, failure = flight.record([flight.ready.commands()], flight.climbing(STAIRS))
    assert failure is None
    assert {motors[0] for _, motors in flight.history} == {0, 10000, 20000}
    assert not any(flight.motors)


# The vehicle's log


@pytest.mark.parametrize("period_ms", [1, 100])
def test_the_log_keeps_its_period_and_counts_what_the_link_lost(tmp_path: Path, period_ms: int) -> None:
    with flight_in(tmp_path) as flight:
        flight.vehicle_suffers(drop_every=7)
        run, failure = flight.record([flight.ready.usual_log(period_ms)], waiting(flight, 3.0))
    log, lost = rows(run, "crazyflie"), known(run.header.devices["crazyflie"].lost)
    assert failure is None
    assert (log.vehicle_ms.iloc[-1] - log.vehicle_ms.iloc[0]) / period_ms + 1 == len(log) + lost
    assert lost > 0


def test_a_second_log_over_a_link_has_its_own_values(tmp_path: Path) -> None:
    """Version 0.2 wrote the values of the first log's variables under the names of the second's: 0.0 for 1 g."""
    with flight_in(tmp_path) as flight:

        def values(*names: str) -> Any:
            run, failure = flight.record([flight.ready.log(names, period_ms=10)], waiting(flight, 0.3))
            assert failure is None
            assert "rejected" not in facts(run, "crazyflie").get("losses", {})
            return rows(run, "crazyflie")[names[-1]].to_numpy()

        assert values("gyro.x", "gyro.y", "gyro.z") == pytest.approx(0.0)
        assert values("acc.x", "acc.y", "acc.z") == pytest.approx(1.0)
        assert np.all(values("motor.m1", "motor.m2", BATTERY) > 3)


def created(flight: Flight, number: int) -> int:
    """Create an empty log block as another program does, and return the error in the vehicle's answer."""
    answers = flight.rig.crazyflie.vehicle.receive(bytes([0x5D, LogCommand.CREATE, number]), flight.hardware.seconds())
    return answers[-1][1][-1]


def test_many_recordings_over_a_link_leave_no_block_behind(tmp_path: Path) -> None:
    with flight_in(tmp_path) as flight:
        for _ in range(10):
            _, failure = flight.record([flight.ready.crossings(), *flight.ready.watch()], flight.playing(sine(5, 100)))
            assert failure is None
        assert [created(flight, number) for number in range(16)] == [0] * 16  # as many as a vehicle keeps


# Packets that are lost, repeated or changed on their way


def test_what_arrives_three_times_is_recorded_once_and_counted(tmp_path: Path) -> None:
    with flight_in(tmp_path) as flight:
        flight.disturb(arriving=lambda packet: [packet] * 3)
        run, failure = flight.record([flight.ready.crossings(), *flight.ready.watch()], flight.playing(sine(12)))
    assert failure is None
    log, reports = rows(run, "crazyflie"), rows(run, "crossings")
    assert not log.vehicle_ms.duplicated().any()
    assert facts(run, "crazyflie")["losses"]["duplicates"] == pytest.approx(2 * len(log), abs=4)
    assert reports.report.tolist() == list(range(26))  # the first sample, 24 crossings, and the end
    assert run.header.devices["crossings"].lost == 0
    assert facts(run, "crossings")["duplicates"] == pytest.approx(2 * len(reports), abs=2)


def test_tables_are_those_that_cflib_reads_whatever_is_lost_and_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    draw = random.Random(5)
    with bench_in(tmp_path) as bench:
        received, arrivals = bench.rig.crazyflie.received, bench.rig.crazyflie.arrivals

        def read(passes: Callable[[Packet], bool]) -> Link:
            bench.rig.crazyflie.received, bench.rig.crazyflie.arrivals = received, arrivals  # type: ignore[method-assign]
            bench.disturb(lambda packet: [packet] if passes(packet) else [], passes)
            link = connect(bench.uri, bench.hardware).link
            link.close()
            return link

        link = read(lambda _: draw.random() > 0.25)
        again = read(lambda packet: packet.payload[:1] != b"\x02")  # no entry of a table
        assert (again.variables, again.parameters) == (link.variables, link.parameters)
        for file in (tmp_path / "cache").rglob("*.json"):
            file.write_bytes(file.read_bytes()[:-9])
        assert read(lambda _: True).variables == link.variables

    (tmp_path / "served").mkdir()
    with served_in(tmp_path / "served") as served:
        cflib.crtp.init_drivers()
        cf, connected = Crazyflie(), threading.Event()
        cf.connected.add_callback(lambda uri: connected.set())
        cf.open_link(served.uri)
        assert connected.wait(60)
        theirs = [
            {f"{entry.group}.{entry.name}": entry for group in toc.toc.values() for entry in group.values()}
            for toc in (cf.log.toc, cf.param.toc)
        ]
        cf.close_link()
    for own, listed in zip((link.variables, link.parameters), theirs, strict=True):
        assert {name: number for name, (number, _) in own.items()} == {name: e.ident for name, e in listed.items()}
        assert all(struct.calcsize(f"<{own[name].kind}") == struct.calcsize(e.pytype) for name, e in listed.items())


# Addresses that reach no vehicle


def answer_nonsense(bench: Bench) -> None:
    bench.disturb(arriving=lambda packet: [Packet(packet.port, packet.channel, b"\xaa" * 8)])


def be_busy(bench: Bench) -> None:
    bench.vehicle_suffers(busy=True)
    bench.hardware.link(bench.uri)  # asks for an echo ten times a second


@pytest.mark.parametrize(
    ("arrange", "word"),
    [
        (lambda bench: bench.vehicle_suffers(silent_after_s=0), "no answer"),
        (lambda bench: bench.vehicle_suffers(protocol=3), "version 3"),
        (answer_nonsense, "no Crazyflie"),
        (be_busy, "no answer"),
    ],
)
def test_a_vehicle_that_does_not_answer_or_is_too_old_or_none_is_told(
    tmp_path: Path, arrange: Callable[[Bench], None], word: str
) -> None:
    with bench_in(tmp_path) as bench:
        arrange(bench)
        pilot = bench.start("log", "ping")
        assert pilot.end() == 3
        assert word in pilot.err
        assert bench.hardware.seconds() < 6.0


# A vehicle in the swing, and its clock


def test_a_vehicle_in_the_swing_gives_its_axis_and_its_motors_never_turn(tmp_path: Path) -> None:
    with bench_in(tmp_path, hung_on="x") as bench:
        pilot = bench.start("log", "gyro", "--axis", "x", "--for", 8, "--json")
        assert pilot.end() == 0, pilot.err
        assert len(bench.history) == 1
        run = bench.run()
    found, log = angle_record(run.folder), read_rows(run, "crazyflie")
    assert tuple(log.columns) == ("vehicle_ms", *INERTIAL)
    assert json.loads(pilot.out)["devices"]["crazyflie"]["rows"] == len(log.time_s)
    assert run.header.kind == "swing"
    assert found.rates is not None
    assert found.rates.axis == pytest.approx((1, 0, 0), abs=0.05)
    assert 0.2 < np.abs(found.angle_rad).max() < 1.4


# Threads of a real link


@pytest.fixture
def listener() -> Any:
    with socket.socket(type=socket.SOCK_DGRAM) as vehicle:
        vehicle.bind(("127.0.0.1", 0))
        yield f"udp://127.0.0.1:{vehicle.getsockname()[1]}"


def test_a_link_that_closes_keeps_no_thread_and_sends_no_more(listener: str) -> None:
    before = threading.active_count()
    link = open_link(listener)
    assert threading.active_count() > before
    link.close()
    assert threading.active_count() == before
    with pytest.raises(DeviceError):
        link.send(Packet(15, 0, b""))


class SlowDriver:
    """A driver of cflib that takes a packet only when it is let, answers it, and loses its radio after the third."""

    def __init__(self) -> None:
        self.in_queue: queue.Queue[CRTPPacket] = queue.Queue()
        self.turn = threading.Semaphore(0)
        self.sent = 0
        self.closed = False

    def connect(self, uri: str, statistics: object, failed: Callable[[str], None]) -> None:
        self.failed = failed
        if not uri.startswith("slow://"):
            raise WrongUriType

    def send_packet(self, packet: CRTPPacket) -> None:
        self.turn.acquire()
        self.sent += 1
        self.in_queue.put(packet)
        if self.sent == 3:
            self.failed("Error communicating\nException:the radio is gone")

    def receive_packet(self, wait_s: float) -> CRTPPacket | None:
        try:
            return self.in_queue.get(timeout=0.01)
        except queue.Empty:
            return None

    def close(self) -> None:
        self.closed = True
        self.turn.release(99)


def test_a_driver_that_is_slow_holds_nobody_up_and_its_fault_is_that_of_the_link(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    driver = SlowDriver()
    monkeypatch.setattr(cflib.crtp, "CLASSES", [lambda: driver])
    link = open_link("slow://1")
    leaving = [link.send(Packet(5, 1, bytes([number]))) for number in range(5)]
    assert link.receive(0.05) is None
    driver.turn.release(3)
    assert [link.receive(10.0) for _ in range(3)] == [Packet(5, 1, bytes([number])) for number in range(3)]
    assert leaving[0].at_s is not None
    assert link.received_s >= leaving[0].at_s
    while not link.fault:
        time.sleep(0.001)
    assert "the radio is gone" in link.fault
    with pytest.raises(DeviceError):
        link.send(Packet(15, 0, b""))
    link.close()
    assert driver.closed
    with pytest.raises(DeviceError):
        open_link("nothing://1")
