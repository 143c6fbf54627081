"""The link to the simulated vehicle: the radio's delays and losses, and a whole rig flown with cflib over UDP."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import cflib.crtp
import numpy as np
import pytest
from cflib.crazyflie import Crazyflie
from cflib.crtp.udpdriver import UdpDriver
from hypothesis import given
from hypothesis import strategies as st
from twisted.internet.posixbase import PosixReactorBase

from cfid.records.rig_file import thesis_rig
from cfid.sim.devices import SimulatedRig
from cfid.sim.faults import CrazyflieFaults
from cfid.sim.link import Direction, RadioTruth
from cfid.sim.propulsion import STILL
from cfid.sim.service import Addresses, ServedRig
from cfid.sim.truth import SimTruth
from cfid.wire.crtp import Packet, decode_packet, encode_packet
from cfid.wire.rdt import Command, Request, decode_records, encode_request


def _latencies(truth: RadioTruth, *, every_s: float = 1.0, count: int = 5000) -> list[float]:
    direction = Direction(truth, np.random.default_rng(2))
    arrivals = [(direction.arrival_s(k * every_s), k * every_s) for k in range(count)]
    return [arrival_s - sent_s for arrival_s, sent_s in arrivals if arrival_s is not None]


def test_latency_has_the_mean_the_scatter_and_the_minimum_of_its_truth() -> None:
    latencies = _latencies(RadioTruth(latency_s=0.028, jitter_s=0.008))
    assert np.mean(latencies) == pytest.approx(0.028, rel=0.02)
    assert np.std(latencies) == pytest.approx(0.008, rel=0.05)
    assert 0.020 <= min(latencies) < 0.0201


def test_as_many_packets_are_lost_as_its_truth_says() -> None:
    assert len(_latencies(RadioTruth(loss=0.1))) == pytest.approx(4500, abs=70)
    assert _latencies(RadioTruth(loss=1.0)) == []
    assert len(_latencies(RadioTruth())) == 5000


@given(gaps_s=st.lists(st.floats(0, 0.01), min_size=2, max_size=50))
def test_no_packet_overtakes_another(gaps_s: list[float]) -> None:
    direction = Direction(RadioTruth(latency_s=0.02, jitter_s=0.02), np.random.default_rng(1))
    arrivals = [direction.arrival_s(sent_s) or 0.0 for sent_s in np.cumsum(gaps_s)]
    assert arrivals == sorted(arrivals)


# Served over UDP

InReactor = Callable[[Callable[[], Any]], Any]

RIG = thesis_rig().model_copy(update={"mounts": {}})  # no mount swings, since a swing would have to be integrated first
WAIT_S = 5.0  # the longest wait for anything, on a busy machine


class Served:
    """A simulated rig for one test, with an `open` that returns its addresses."""

    def __init__(self, reactor: PosixReactorBase, in_reactor: InReactor, folder: Path) -> None:
        self.in_reactor = in_reactor
        self.rig: SimulatedRig
        self._reactor, self._folder = reactor, folder
        self._served: ServedRig | None = None

    def open(self, truth: SimTruth | None = None, faults: CrazyflieFaults | None = None, **options: Any) -> Addresses:
        self.rig = SimulatedRig(
            RIG,
            seconds=self._reactor.seconds,
            seed=7,
            truth=truth or SimTruth(),
            crazyflie_faults=faults or CrazyflieFaults(),
            **options,
        )
        self._served = ServedRig(self.rig, reactor=self._reactor, folder=self._folder)
        addresses: Addresses = self.in_reactor(self._served.open)
        return addresses

    def close(self) -> None:
        if self._served is not None:
            self.in_reactor(self._served.close)

    def wait_for(self, motors: tuple[int, int, int, int]) -> None:
        wait_until(lambda: self.rig.crazyflie.motors == motors)


@pytest.fixture
def served(reactor: PosixReactorBase, in_reactor: InReactor, tmp_path: Path) -> Iterator[Served]:
    served = Served(reactor, in_reactor, tmp_path)
    yield served
    served.close()


@pytest.fixture
def no_usb(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cflib.crtp, "CLASSES", [UdpDriver])


def wait_until(there: Callable[[], object]) -> None:
    end_s = time.monotonic() + WAIT_S
    while not there():
        assert time.monotonic() < end_s
        time.sleep(0.005)


@contextmanager
def flown(uri: str) -> Iterator[Crazyflie]:
    """Connect as any program with cflib does, and wait until cflib has read everything."""
    cf, complete = Crazyflie(), threading.Event()
    cf.fully_connected.add_callback(lambda uri: complete.set())
    cf.open_link(uri)
    assert complete.wait(WAIT_S)
    try:
        yield cf
    finally:
        cf.close_link()


class Client:
    """A bare socket that speaks CRTP."""

    def __init__(self, addresses: Addresses) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(WAIT_S)
        self._socket.connect(("127.0.0.1", int(addresses.crazyflie_uri.rpartition(":")[2])))

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def say(self, port: int, channel: int, payload: bytes) -> None:
        self._socket.send(encode_packet(Packet(port, channel, payload)))

    def hear(self) -> Packet:
        packet = decode_packet(self._socket.recv(64))
        assert packet is not None
        return packet

    def ask(self, port: int, channel: int, payload: bytes) -> bytes:
        self.say(port, channel, payload)
        return self.hear().payload

    def hears_nothing(self, for_s: float = 0.2) -> bool:
        self._socket.settimeout(for_s)
        try:
            return not self._socket.recv(64)
        except TimeoutError:
            return True
        finally:
            self._socket.settimeout(WAIT_S)


# cflib


@pytest.mark.usefixtures("no_usb")
def test_cflib_is_fully_connected_at_once_and_knows_all_there_is(served: Served) -> None:
    addresses = served.open()
    with flown(addresses.crazyflie_uri) as cf:
        assert cf.platform.get_protocol_version() == 12
        assert {"pm.vbat", "motor.m1", "sys.isTumbled"} <= {
            f"{g}.{n}" for g in cf.log.toc.toc for n in cf.log.toc.toc[g]
        }
        assert cf.param.toc.get_element_by_complete_name("pm.lowVoltage").is_persistent()
        assert float(cf.param.get_value("pm.lowVoltage")) == pytest.approx(3.2)
        assert cf.supervisor.read_state_list() == [
            "Is armed",
            "Is auto armed",
            "Can fly",
            "Finished HL trajectory",
        ]


@pytest.mark.usefixtures("no_usb")
def test_cflib_drives_the_motors_by_parameters_and_the_load_cell_feels_it(served: Served) -> None:
    addresses = served.open()
    with flown(addresses.crazyflie_uri) as cf:
        assert lift_n(addresses) == pytest.approx(0.0, abs=0.01)
        for motor in (1, 2, 3, 4):
            cf.param.set_value(f"motorPowerSet.m{motor}", 40000)
        cf.param.set_value("motorPowerSet.enable", 1)
        served.wait_for((40000,) * 4)
        time.sleep(0.5)
        assert lift_n(addresses) == pytest.approx(4 * 0.0732, rel=0.05)
        cf.param.set_value("motorPowerSet.enable", 0)
        served.wait_for(STILL)
        wait_until(lambda: cf.param.get_value("motorPowerSet.enable") == "0")
        time.sleep(0.5)
        assert lift_n(addresses) == pytest.approx(0.0, abs=0.01)


def lift_n(addresses: Addresses) -> float:
    """Return the mean of Fz in N over half a second, less the reading of the unloaded cell.

    On a busy computer a client in Python loses records, but the mean of most of them is as good.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(1.0)
        client.sendto(encode_request(Request(Command.REAL_TIME, 3500)), (addresses.address, addresses.rdt_port))
        received: list[bytes] = []
        with suppress(TimeoutError):
            while len(received) < 3500:
                received.append(client.recv(2048))
    assert len(received) > 1000
    records = decode_records(b"".join(received))
    return float(records["counts"][:, 2].mean() / 1e6) - 1.4


# Bare UDP
