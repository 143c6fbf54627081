"""The simulated box on real loopback sockets, also read by independent clients from the package index."""

import socket
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from twisted.internet.error import CannotListenError
from twisted.internet.posixbase import PosixReactorBase

from cfid.sim.faults import SOUND_LOADCELL, FaultyNetFT, LoadCellFaults
from cfid.sim.loadcell import LoadCellTruth, SimulatedLoadCell
from cfid.sim.netft import ANY_FREE, LOOPBACK, BoxPorts, NetFTBox, NetFTServer
from cfid.wire.netft import READ_FORCES, READING_BYTES, configuration_query, read_reading, read_settings
from cfid.wire.rdt import Command, Request, decode_records, encode_request

InReactor = Callable[[Callable[[], Any]], Any]

LOAD = np.array([1.0, -2.0, 3.0, 0.01, -0.02, 0.03])
TRUTH = LoadCellTruth(noise_std=(0.0,) * 6, bias=(0.0,) * 6, drift_per_s=(0.0,) * 6)
NO_OTHER_ADDRESS = "this system binds no loopback address but 127.0.0.1, or the port is taken"


class _Served:
    """A box with a constant load on the sockets of one test."""

    def __init__(self, reactor: PosixReactorBase, in_reactor: InReactor) -> None:
        self._reactor = reactor
        self._in_reactor = in_reactor
        self._server: NetFTServer | None = None
        self.address = LOOPBACK

    def open(
        self,
        faults: LoadCellFaults = SOUND_LOADCELL,
        *,
        rate_hz: float = 7000,
        address: str = LOOPBACK,
        ports: BoxPorts = ANY_FREE,
    ) -> BoxPorts:
        now_s = self._reactor.seconds()
        rng = np.random.default_rng(6)
        box = NetFTBox(
            load_cell=SimulatedLoadCell(TRUTH, rng),
            plant=lambda time_s: np.tile(LOAD, (len(time_s), 1)),
            rate_hz=rate_hz,
            powered_s=now_s,
        )
        self.box = FaultyNetFT(box, faults, opened_s=now_s, rng=rng)
        self.address = address
        self._server = NetFTServer(self.box, reactor=self._reactor, address=address, ports=ports)
        opened: BoxPorts = self._in_reactor(self._server.open)
        return opened

    def close(self) -> None:
        if self._server is not None:
            self._in_reactor(self._server.close)

    def get(self, port: int, path: str) -> str:
        with urllib.request.urlopen(f"http://{self.address}:{port}{path}", timeout=5) as answer:
            return str(answer.read().decode())


@pytest.fixture
def served(reactor: PosixReactorBase, in_reactor: InReactor) -> Iterator[_Served]:
    served = _Served(reactor, in_reactor)
    yield served
    served.close()


@pytest.fixture
def client() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(2)
        yield client


def _listen(client: socket.socket, *, for_s: float) -> bytes:
    """Return all bytes that arrive within a time."""
    messages, end_s = [], time.monotonic() + for_s
    client.settimeout(0.05)
    while time.monotonic() < end_s:
        try:
            messages.append(client.recv(2048))
        except TimeoutError:
            continue
    return b"".join(messages)


def test_asked_for_records_come_at_their_rate(served: _Served, client: socket.socket) -> None:
    ports = served.open()
    began_s = time.monotonic()
    client.sendto(encode_request(Request(Command.REAL_TIME, 3500)), (LOOPBACK, ports.rdt))
    records = decode_records(b"".join(client.recv(2048) for _ in range(3500)))
    assert time.monotonic() - began_s >= 0.49
    np.testing.assert_array_equal(records["rdt_sequence"], np.arange(1, 3501))
    np.testing.assert_array_equal(records["counts"], np.tile(1e6 * LOAD, (3500, 1)))
    assert _listen(client, for_s=0.1) == b""


def test_a_rate_set_over_http_holds_from_the_next_request(served: _Served, client: socket.socket) -> None:
    ports = served.open()
    served.get(ports.http, "/comm.cgi?comrdtrate=900&comrdtbsiz=10")
    settings = read_settings(served.get(ports.http, configuration_query(1)))
    assert (settings.rate_hz, settings.buffer_size) == (1000, 10)
    client.sendto(encode_request(Request(Command.BUFFERED)), (LOOPBACK, ports.rdt))
    records = decode_records(client.recv(2048))
    assert np.diff(records["ft_sequence"]).tolist() == [7] * 9


def test_an_unknown_page_is_not_found(served: _Served) -> None:
    ports = served.open()
    with pytest.raises(urllib.error.HTTPError, match="404"):
        served.get(ports.http, "/no.such.page")


def test_a_single_reading_comes_over_tcp_in_any_slicing(served: _Served) -> None:
    ports = served.open(LoadCellFaults(udp_blocked=True))
    with socket.create_connection((LOOPBACK, ports.tcp), timeout=5) as connection:
        for part in (READ_FORCES[:7], READ_FORCES[7:] + READ_FORCES):
            connection.sendall(part)
            time.sleep(0.02)
        readings = [connection.recv(READING_BYTES, socket.MSG_WAITALL) for _ in range(2)]
    values = np.array([read_reading(reading).values for reading in readings])
    np.testing.assert_allclose(values[:, 2] * 1832 / 1e6, 3.0, atol=0.002)


def test_a_slow_box_answers_late(served: _Served) -> None:
    ports = served.open(LoadCellFaults(slow_s=0.3))
    began_s = time.monotonic()
    served.get(ports.http, configuration_query(0))
    assert time.monotonic() - began_s >= 0.3


def test_a_box_without_power_answers_nobody_and_then_forgets_the_stream(served: _Served, client: socket.socket) -> None:
    ports = served.open(LoadCellFaults(restart_after_s=0.2, restart_for_s=0.5))
    client.sendto(encode_request(Request(Command.REAL_TIME)), (LOOPBACK, ports.rdt))
    assert _listen(client, for_s=0.15)
    time.sleep(0.15)
    _listen(client, for_s=0.05)
    with pytest.raises(OSError, match=r"reset|closed"):
        served.get(ports.http, configuration_query(0))
    time.sleep(0.5)
    assert _listen(client, for_s=0.05) == b""
    assert read_settings(served.get(ports.http, configuration_query(1)))


def test_closed_ports_are_free_again(served: _Served, client: socket.socket) -> None:
    ports = served.open()
    client.sendto(encode_request(Request(Command.REAL_TIME)), (LOOPBACK, ports.rdt))
    client.recv(2048)
    served.close()
    assert served.open(ports=ports) == ports


def test_pynetft_reads_units_and_values_and_misses_exactly_what_was_dropped(served: _Served) -> None:
    pynetft = pytest.importorskip("pynetft")
    ports = served.open(LoadCellFaults(drop_every=100))
    config = pynetft.Config(sensor_host=LOOPBACK, rdt_port=ports.rdt, http_port=ports.http)
    with pynetft.Client(config) as reader:
        assert reader.wait_for_first_sample(2.0)
        time.sleep(0.5)
        sample = reader.latest_sample()
        served.box.faults = SOUND_LOADCELL  # a loss shows only once a later record arrives
        time.sleep(0.05)
        health = reader.health()
    assert sample.wrench == pytest.approx(tuple(LOAD))
    assert (sample.force_unit.value, sample.torque_unit.value) == ("N", "N-m")
    assert served.box.mishaps.dropped_records >= 30
    assert health.lost_count == served.box.mishaps.dropped_records
    assert health.malformed_count == health.duplicate_count == 0


def test_netft_reads_single_records_and_takes_its_tare(served: _Served) -> None:
    module = pytest.importorskip("NetFT")
    try:
        served.open(address="127.0.0.77", ports=BoxPorts(49152, 0, 0))  # the only port that this client uses
    except CannotListenError:
        pytest.skip(NO_OTHER_ADDRESS)
    sensor = module.Sensor("127.0.0.77")
    with sensor.sock:
        sensor.sock.settimeout(2)
        assert sensor.getMeasurement() == (1e6 * LOAD).astype(int).tolist()
        assert sensor.tare(20) == pytest.approx(1e6 * LOAD)
        assert sensor.getForce() == [0, 0, 0]
