"""A vehicle whose packets arrive more than once, as UDP may deliver them, and a link that closes while it sends."""

import select
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import pandas as pd
import pytest
from cflib.crazyflie import Crazyflie
from cflib.crtp.crtpstack import CRTPPacket

from cfid.rig.cflib_drivers import RepeatingUdp
from cfid.rig.crazyflie import Link
from cfid.wire.app import AppPorts
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


class SlowDriver:
    """A driver of cflib whose sender, having checked for the link, is held up until the link is closed."""

    def __init__(self) -> None:
        self.looked, self.closing = threading.Event(), threading.Event()
        self.sent: list[object] = []

    @property
    def needs_resending(self) -> bool:
        self.looked.set()
        self.closing.wait(0.2)
        return True

    def send_packet(self, packet: object) -> None:
        self.sent.append(packet)

    def close(self) -> None:
        self.closing.set()


def test_a_packet_that_cflib_is_sending_when_the_link_closes_is_sent_or_left_out() -> None:
    cf, driver, faults = Crazyflie(), SlowDriver(), list[BaseException]()
    cf.link = driver
    packet = CRTPPacket(header=0x50, data=[5])

    def send() -> None:
        try:
            cf.send_packet(packet, expected_reply=(5,))
        except AttributeError as error:
            faults.append(error)

    sender = threading.Thread(target=send)
    sender.start()
    assert driver.looked.wait(10)
    Link("udp://127.0.0.1:9", cf).close()
    sender.join()

    assert not faults
    assert driver.sent == [packet]


def test_a_link_that_closes_keeps_no_processor_busy() -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as vehicle:
        vehicle.bind(("127.0.0.1", 0))
        driver = RepeatingUdp()
        driver.connect(f"udp://127.0.0.1:{vehicle.getsockname()[1]}", None, None)
        time.sleep(0.1)  # until it receives
        began_s = time.process_time()
        driver.close()
        assert time.process_time() - began_s < 0.1
        assert not driver._thread.is_alive()
