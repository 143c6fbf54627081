"""The simulated Net F/T box, without wires and on loopback sockets, where independent clients read it too."""

import struct
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from twisted.internet.error import CannotListenError
from twisted.internet.posixbase import PosixReactorBase

from cfid.sim.faults import SOUND_LOADCELL, FaultyNetFT, LoadCellFaults
from cfid.sim.loadcell import SATURATED, LoadCellTruth, SimulatedLoadCell
from cfid.sim.netft import Address, NetFTBox
from cfid.sim.service import ANY_FREE, LOOPBACK, BoxPorts, NetFTServer
from cfid.wire.netft import (
    READ_FORCES,
    read_reading,
    read_settings,
)
from cfid.wire.rdt import Command, Records, Request, decode_records, encode_request

CLIENT: Address = ("127.0.0.1", 1000)
QUIET = LoadCellTruth(noise_std=(0.0,) * 6, bias=(0.0,) * 6, drift_per_s=(0.0,) * 6)
LOAD = np.array([1.0, -2.0, 3.0, 0.01, -0.02, 0.03])
FOREVER = Request(Command.REAL_TIME)


def _constant(time_s: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.tile(LOAD, (len(time_s), 1))


def _box(
    *,
    truth: LoadCellTruth = QUIET,
    rate_hz: float = 7000,
    buffer_size: int = 1,
    first_ft_sequence: int = 0,
    status: int = 0,
    internal_hz: int = 7000,
) -> NetFTBox:
    return NetFTBox(
        load_cell=SimulatedLoadCell(truth, np.random.default_rng(5)),
        plant=_constant,
        rate_hz=rate_hz,
        buffer_size=buffer_size,
        first_ft_sequence=first_ft_sequence,
        status=status,
        internal_hz=internal_hz,
    )


def _ask(box: NetFTBox, request: Request, *, now_s: float = 0.0, client: Address = CLIENT) -> None:
    box.request(encode_request(request), client, now_s)


def _joined(datagrams: Iterable[tuple[bytes, Address]]) -> Records:
    return decode_records(b"".join(data for data, _ in datagrams))


def test_a_load_beyond_the_range_is_clipped_and_says_so() -> None:
    cell = SimulatedLoadCell(QUIET, np.random.default_rng(1))
    counts, status = cell.read(np.array([0.0, 1.0]), np.array([[0, 0, 59, 0, 0, 0], [0, 0, 61.0, 0, 0, 0]]))
    assert status.tolist() == [0, SATURATED]
    assert counts[:, 2].tolist() == [59_000_000, 60_000_000]


def test_an_unloaded_cell_shows_its_bias_its_drift_and_its_noise() -> None:
    truth = LoadCellTruth(bias=(0.5, 0, 0, 0, 0, 0), drift_per_s=(0.01, 0, 0, 0, 0, 0))
    cell = SimulatedLoadCell(truth, np.random.default_rng(1))
    counts, _ = cell.read(100 + np.arange(7000) / 700, np.zeros((7000, 6)))
    force_n = counts[:, 0] / 1e6
    assert force_n[:500].mean() == pytest.approx(0.5 + 0.01 * 0.36, abs=0.002)
    assert force_n[-500:].mean() - force_n[:500].mean() == pytest.approx(0.01 * 9.3, abs=0.003)
    assert force_n[:500].std() == pytest.approx(0.01, rel=0.15)


def test_each_request_numbers_its_records_from_one_while_the_box_counts_on() -> None:
    box = _box()
    _ask(box, FOREVER)
    first = _joined(box.due(0.1))
    _ask(box, FOREVER, now_s=0.2)
    second = _joined(box.due(0.3))
    assert first["rdt_sequence"][0] == second["rdt_sequence"][0] == 1
    assert first["ft_sequence"][0] == 1
    assert second["ft_sequence"][0] == 1401
    np.testing.assert_array_equal(first["counts"][0], 1e6 * LOAD)


@pytest.mark.parametrize(("rate_hz", "step"), [(7000, 1), (3500, 2), (1000, 7), (100, 70), (7, 1000)])
def test_ft_sequence_advances_by_the_internal_rate_over_the_rate(rate_hz: int, step: int) -> None:
    box = _box(rate_hz=rate_hz)
    _ask(box, FOREVER)
    records = _joined(box.due(1.0))
    assert len(records) == rate_hz
    assert set(np.diff(records["ft_sequence"]).tolist()) == {step}


def test_a_stall_is_caught_up_for_two_seconds_and_the_rest_looks_lost() -> None:
    box = _box()
    _ask(box, FOREVER)
    box.due(1.0)
    records = _joined(box.due(11.0))
    assert len(records) == pytest.approx(14000, abs=2)
    assert box.skipped_records == records["rdt_sequence"][0] - 7001
    assert records["rdt_sequence"][-1] == records["ft_sequence"][-1] == 77000


def test_a_software_bias_makes_the_present_load_zero_even_twice() -> None:
    box = _box()
    for now_s in (0.0, 0.5):
        _ask(box, Request(Command.BIAS), now_s=now_s)
    _ask(box, FOREVER, now_s=1.0)
    assert not _joined(box.due(1.1))["counts"].any()
    assert read_settings(box.page()).bias == tuple(1e6 * LOAD)


def test_a_single_reading_times_its_scale_factor_is_the_load() -> None:
    box = _box()
    header, force, torque, per_n, per_nm, *factors = struct.unpack(">HBBII6H", box.answer(b"\x01" + bytes(19), 0.0))
    assert (header, force, torque, per_n, per_nm) == (0x1234, 2, 3, 10**6, 10**6)
    reading = read_reading(box.answer(READ_FORCES, 0.0))
    assert reading.status == 0
    np.testing.assert_allclose(np.array(reading.values) * factors, 1e6 * LOAD, atol=max(factors))


# On loopback sockets

InReactor = Callable[[Callable[[], Any]], Any]
NO_OTHER_ADDRESS = "this system binds no loopback address but 127.0.0.1, or the port is taken"


class _Served:
    """A box with a constant load on the sockets of one test."""

    def __init__(self, reactor: PosixReactorBase, in_reactor: InReactor) -> None:
        self._reactor = reactor
        self._in_reactor = in_reactor
        self._server: NetFTServer | None = None

    def open(
        self,
        faults: LoadCellFaults = SOUND_LOADCELL,
        *,
        address: str = LOOPBACK,
        ports: BoxPorts = ANY_FREE,
    ) -> BoxPorts:
        now_s = self._reactor.seconds()
        rng = np.random.default_rng(6)
        box = NetFTBox(
            load_cell=SimulatedLoadCell(QUIET, rng),
            plant=lambda time_s: np.tile(LOAD, (len(time_s), 1)),
            powered_s=now_s,
        )
        self.box = FaultyNetFT(box, faults, opened_s=now_s, rng=rng)
        self._server = NetFTServer(self.box, reactor=self._reactor, address=address, ports=ports)
        opened: BoxPorts = self._in_reactor(self._server.open)
        return opened

    def close(self) -> None:
        if self._server is not None:
            self._in_reactor(self._server.close)


@pytest.fixture
def served(reactor: PosixReactorBase, in_reactor: InReactor) -> Iterator[_Served]:
    served = _Served(reactor, in_reactor)
    yield served
    served.close()


def test_pynetft_reads_units_and_values_and_misses_exactly_what_was_dropped(served: _Served) -> None:
    pynetft = pytest.importorskip("pynetft")
    ports = served.open(LoadCellFaults(drop_every=100))
    config = pynetft.Config(sensor_host=LOOPBACK, rdt_port=ports.rdt, http_port=ports.http)
    with pynetft.Client(config) as reader:
        assert reader.wait_for_first_sample(20.0)
        time.sleep(0.5)
        sample = reader.latest_sample()
        served.box.faults = SOUND_LOADCELL  # a loss shows only once a later record arrives
        time.sleep(0.05)
        health = reader.health()
    assert sample.wrench == pytest.approx(tuple(LOAD))
    assert (sample.force_unit.value, sample.torque_unit.value) == ("N", "N-m")
    assert served.box.mishaps["drop_every"] > 0
    assert health.lost_count == served.box.mishaps["drop_every"]
    assert health.malformed_count == health.duplicate_count == 0


def test_netft_reads_single_records_and_takes_its_tare(served: _Served) -> None:
    module = pytest.importorskip("NetFT")
    try:
        served.open(address="127.0.0.77", ports=BoxPorts(49152, 0, 0))  # the only port that this client uses
    except CannotListenError:
        pytest.skip(NO_OTHER_ADDRESS)
    sensor = module.Sensor("127.0.0.77")
    with sensor.sock:
        sensor.sock.settimeout(20)
        assert sensor.getMeasurement() == (1e6 * LOAD).astype(int).tolist()
        assert sensor.tare(20) == pytest.approx(1e6 * LOAD)
        assert sensor.getForce() == [0, 0, 0]
