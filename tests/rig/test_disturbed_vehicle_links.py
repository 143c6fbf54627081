"""Links to a vehicle that lose, repeat or hold up packets, and what a driver of cflib carries."""

import queue
import random
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import cflib.crtp
import pandas as pd
import pytest
from cflib.crazyflie import Crazyflie
from cflib.crtp.crtpstack import CRTPPacket
from cflib.crtp.exceptions import WrongUriType

from cfid.errors import DeviceError
from cfid.rig import tables
from cfid.rig.link import Link
from cfid.wire.app import AppPorts
from cfid.wire.crtp import Packet
from tests.flying_in_a_folder import Bench, bench_in

pytestmark = pytest.mark.usefixtures("in_time")


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_in(tmp_path) as bench:
        yield bench


@contextmanager
def relayed(
    uri: str, arriving: Callable[[bytes], Sequence[bytes]], leaving: Callable[[bytes], bool] = lambda packet: True
) -> Iterator[str]:
    """Yield a relayed address of the vehicle; `arriving` returns what arrives of each packet from the vehicle.

    Of the packets to the vehicle those pass for which `leaving` is true.
    """
    ended = threading.Event()
    with socket.socket(type=socket.SOCK_DGRAM) as near, socket.socket(type=socket.SOCK_DGRAM) as far:
        near.bind(("127.0.0.1", 0))
        far.connect(("127.0.0.1", urlsplit(uri).port or 0))

        def relay() -> None:
            client = None
            while not ended.is_set():
                ready, _, _ = select.select([near, far], [], [], 0.1)
                if near in ready:
                    datagram, client = near.recvfrom(64)
                    if leaving(datagram):
                        far.send(datagram)
                if far in ready and client is not None:
                    for datagram in arriving(far.recv(64)):
                        near.sendto(datagram, client)

        thread = threading.Thread(target=relay)
        thread.start()
        try:
            yield f"udp://127.0.0.1:{near.getsockname()[1]}"
        finally:
            ended.set()
            thread.join()


def test_packets_that_arrive_three_times_are_those_of_one_vehicle(bench: Bench) -> None:
    with relayed(bench.uri, lambda packet: [packet] * 3) as uri:
        pilot = bench.start("motors", "set", 20000, "--motor", 1, "--for", 2, "--yes", "--uri", uri)
        assert pilot.end() == 0, pilot.err
    assert any(any(motors) for _, motors in bench.history)
    assert not any(bench.motors)


def test_an_empty_packet_before_the_apps_hello_hides_no_app(bench: Bench) -> None:
    empty = bytes([AppPorts().ping << 4])
    with relayed(bench.uri, lambda packet: [empty, packet]) as uri:
        pilot = bench.start("motors", "set", 20000, "--motor", 1, "--for", 1, "--yes", "--uri", uri)
        assert pilot.end() == 0, pilot.err
    assert "which runs cfid's app" in pilot.err
    assert any(any(motors) for _, motors in bench.history)


def test_a_row_of_the_vehicles_log_that_arrives_three_times_is_recorded_once_and_counted(bench: Bench) -> None:
    with relayed(bench.uri, lambda packet: [packet] * 3) as uri:
        pilot = bench.start("log", "gyro", "--axis", "x", "--for", 1, "--uri", uri)
        assert pilot.end() == 0, pilot.err
    record = bench.run().header.devices["crazyflie"]
    stamps = pd.read_csv(bench.run().device_file("crazyflie"))["vehicle_ms"]

    assert not stamps.duplicated().any()
    assert len(stamps) == record.rows
    again = (record.model_extra or {})["losses"]["duplicates"]
    assert again == pytest.approx(2 * record.rows, abs=4)
    assert f"{again} duplicates" in pilot.out


def test_a_report_of_a_sine_that_arrives_twice_is_recorded_once_and_is_no_loss(bench: Bench) -> None:
    with relayed(bench.uri, lambda packet: [packet] * 2) as uri:
        pilot = bench.start("log", "sine", "--l", 12, "--n", 1000, "--yes", "--uri", uri)
        assert pilot.end() == 0, pilot.err
    record = bench.run().header.devices["crossings"]
    reports = pd.read_csv(bench.run().device_file("crossings"))["report"]

    assert reports.tolist() == list(range(26))  # the first sample, 24 crossings, and the end
    assert record.lost == 0
    assert (record.model_extra or {})["duplicates"] == len(reports)


def test_tables_are_those_that_cflib_reads_whatever_is_lost_and_are_kept(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    draw = random.Random(5)

    def passes(packet: bytes) -> bool:
        return draw.random() > 0.25

    with relayed(bench.uri, lambda packet: [packet] if passes(packet) else [], leaving=passes) as uri:
        link = tables.connect(uri)
        link.close()
    cflib.crtp.init_drivers()
    cf, connected = Crazyflie(), threading.Event()
    cf.connected.add_callback(lambda uri: connected.set())
    cf.open_link(bench.uri)
    assert connected.wait(10)
    theirs = [
        {f"{entry.group}.{entry.name}": entry for group in toc.toc.values() for entry in group.values()}
        for toc in (cf.log.toc, cf.param.toc)
    ]
    cf.close_link()

    for own, listed in zip((link.variables, link.parameters), theirs, strict=True):
        assert {name: number for name, (number, _) in own.items()} == {name: e.ident for name, e in listed.items()}
        assert all(struct.calcsize(f"<{own[name].kind}") == struct.calcsize(e.pytype) for name, e in listed.items())

    def no_entry(packet: bytes) -> bool:
        return packet[1:2] != b"\x02"

    with relayed(bench.uri, lambda packet: [packet], leaving=no_entry) as uri:
        again = tables.connect(uri)
        again.close()
    assert (again.variables, again.parameters) == (link.variables, link.parameters)

    for file in (tmp_path / "cache").rglob("*.json"):
        file.write_bytes(file.read_bytes()[:-9])
    third = tables.connect(bench.uri)
    third.close()
    assert third.variables == link.variables


def test_a_link_that_closes_keeps_no_processor_busy_and_no_thread() -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as vehicle:
        vehicle.bind(("127.0.0.1", 0))
        before = threading.active_count()
        link = Link(f"udp://127.0.0.1:{vehicle.getsockname()[1]}")
        time.sleep(0.3)  # until it receives, and asks for echoes
        began_s, clock_s = time.process_time(), time.monotonic()
        link.close()
        assert time.process_time() - began_s < 0.1
        assert time.monotonic() - clock_s < 1.0
        assert threading.active_count() == before
        with pytest.raises(DeviceError):
            link.send(Packet(15, 0, b""))


class SlowDriver:
    """A driver of cflib that takes a packet every 0.1 s, answers it, and loses its radio after the third."""

    def __init__(self) -> None:
        self.in_queue: queue.Queue[CRTPPacket] = queue.Queue()
        self.sent: list[CRTPPacket] = []
        self.closed = False

    def connect(self, uri: str, statistics: object, failed: Callable[[str], None]) -> None:
        self.failed = failed
        if not uri.startswith("slow://"):
            raise WrongUriType

    def send_packet(self, packet: CRTPPacket) -> None:
        time.sleep(0.1)
        self.sent.append(packet)
        self.in_queue.put(packet)
        if len(self.sent) == 3:
            self.failed("Error communicating\nException:the radio is gone")

    def receive_packet(self, wait_s: float) -> CRTPPacket | None:
        try:
            return self.in_queue.get(timeout=wait_s)
        except queue.Empty:
            return None

    def close(self) -> None:
        self.closed = True


def test_a_driver_of_cflib_that_is_slow_holds_nobody_up_and_its_fault_is_that_of_the_link(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    driver = SlowDriver()
    monkeypatch.setattr(cflib.crtp, "CLASSES", [lambda: driver])
    link = Link("slow://1")
    began_s = time.monotonic()
    leaving = [link.send(Packet(5, 1, bytes([number]))) for number in range(5)]
    assert time.monotonic() - began_s < 0.05

    assert link.receive(2.0) == Packet(5, 1, b"\0")
    left_s = [packet.at_s for packet in leaving[:2]]
    assert left_s[0] is not None
    assert link.received_s - left_s[0] == pytest.approx(0.1, abs=0.05)
    end_s = time.monotonic() + 5
    while not link.fault and time.monotonic() < end_s:
        time.sleep(0.01)
    assert link.fault == "slow://1: the link failed: the radio is gone."
    with pytest.raises(DeviceError):
        link.send(Packet(15, 0, b""))
    link.close()
    assert driver.closed
    with pytest.raises(DeviceError):
        Link("nothing://1")
