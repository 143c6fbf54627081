"""The load cell's box: every record is a row or a loss in its place, and whatever breaks the stream is told."""

import socketserver
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pytest

from cfid.errors import DeviceError
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import LoadCellBox, load_rig
from cfid.rig.check import check_loadcell
from cfid.rig.hardware import Address, DatagramPort, Real, TakeDatagram
from cfid.rig.loadcell import read_settings, ready_loadcell
from cfid.wire.rdt import Command, Request, decode_request, encode_request
from tests.virtual_lab import LOADCELL_HZ, Lab, Logged, held_elsewhere, lab_in, recorded

LOG = ("log", "loadcell")
BLOCK = 14  # records per datagram
STRANGER = ("192.0.2.66", 4000)


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with lab_in(tmp_path) as lab:
        yield lab


class Recording(Logged):
    """A recording of the load cell; things happen `at` seconds from its start."""

    def __init__(self, lab: Lab, *words: object, at: Mapping[float, Callable[[], object]] = MappingProxyType({})):
        super().__init__(lab, "loadcell", *words, at=at)
        self.arrivals = Counter[str](self.facts.get("arrivals"))  # a kind that did not happen is left out

    def check(self, *, requests: int = 1) -> None:
        """Check that rows and losses add up to what the box sent, in order, and that each time is that of its count."""
        rows = self.rows
        assert self.device.rows == len(rows)
        assert self.arrivals["lost"] == self.lost
        assert np.all(np.diff(self.times_s) > 0)
        if requests == 1:
            assert len(rows) + self.lost == rows["rdt_sequence"].iloc[-1]
            assert np.all(np.diff(rows["rdt_sequence"]) > 0)
            assert np.all(
                (rows["ft_sequence"] - 10 * rows["rdt_sequence"]) % 2**32 == (rows["ft_sequence"][0] - 10) % 2**32
            )
            apart_s = np.diff(self.times_s) / np.diff(rows["rdt_sequence"])
            assert np.abs(apart_s - 1 / LOADCELL_HZ).max() < 3e-6


def box_of(lab: Lab) -> LoadCellBox:
    """Return the box as rig.toml states it, at its simulated address."""
    box = lab.hardware.devices(lab.folder, load_rig(lab.folder / RIG_FILE))[0].loadcell
    assert isinstance(box, LoadCellBox)
    return box


# Datagrams


@pytest.mark.parametrize("first_ft", [1000, 2**32 - 20_000])
def test_all_records_are_rows_evenly_timed_over_the_wrap_of_the_count_too(lab: Lab, first_ft: int) -> None:
    lab.box.box._first_ft_sequence = first_ft
    log = Recording(lab, "--for", 4)

    assert log.ended.code == 0
    assert log.run.header.state == "complete"
    assert (log.lost, log.gaps) == (0, [])
    assert len(log.rows) == pytest.approx(4 * LOADCELL_HZ, abs=60)
    log.check()


@pytest.mark.parametrize("fault", ["drop_every", "duplicate_every", "reorder_every", "corrupt_every"])
def test_what_the_network_does_to_datagrams_is_counted_and_no_row_is_out_of_its_place(lab: Lab, fault: str) -> None:
    lab.loadcell_suffers(**{fault: 7})
    log = Recording(lab, "--for", 4)
    mishaps = lab.box.mishaps

    assert log.ended.code == 0
    log.check()
    dropped = pytest.approx(mishaps["drop_every"], abs=BLOCK)
    if fault == "corrupt_every":
        assert log.arrivals["malformed_datagrams"] > 5
        assert log.lost > BLOCK * log.arrivals["malformed_datagrams"] / 2
    else:
        assert log.lost == dropped
    assert log.arrivals["duplicates"] == pytest.approx(mishaps["duplicate_every"], abs=BLOCK)
    assert (log.arrivals["reordered"] > 0) == (fault == "reorder_every")


def change_ports(lab: Lab, change: Callable[[DatagramPort, TakeDatagram], None]) -> None:
    """Change each UDP port that is opened; the change also gets what takes its datagrams."""
    opened = lab.hardware.datagrams

    def datagrams(address: Address, take: TakeDatagram) -> DatagramPort:
        port = opened(address, take)
        change(port, take)
        return port

    lab.hardware.datagrams = datagrams  # type: ignore[method-assign]


def test_datagrams_of_strangers_are_counted_and_dropped(lab: Lab) -> None:
    def disturb(port: DatagramPort, take: TakeDatagram) -> None:
        for k in range(20):
            lab.hardware.at(0.1 * k, take, bytes(36), STRANGER, lab.hardware.seconds() + 0.1 * k)

    change_ports(lab, disturb)
    log = Recording(lab, "--for", 3)

    assert log.ended.code == 0
    assert log.arrivals["foreign_datagrams"] == 20
    assert log.lost == 0
    log.check()


# What breaks the stream


def steal(lab: Lab) -> None:
    lab.box.box.request(encode_request(Request(Command.REAL_TIME)), STRANGER, lab.hardware.seconds())
    lab.box.box.request(encode_request(Request(Command.STOP)), STRANGER, lab.hardware.seconds())


class Break(NamedTuple):
    """What happens at which seconds of a recording, for how long records are lost, and how it ends."""

    acts: dict[float, Callable[[Lab], object]]
    lost_s: float
    reason: str = "the stream broke off"
    for_s: float | None = 6.0
    requests: int = 2
    first_ft_sequence: int = 500_000


SILENT, SOUND = (lambda lab: lab.loadcell_suffers(silent_after_s=0)), Lab.loadcell_suffers
BREAKS = {
    "a short silence": Break({2: SILENT, 2.5: SOUND}, 0.5, "no record came", requests=1),
    "a silence that a request ends": Break({2: SILENT, 4.5: SOUND}, 2.75),
    "a silence at the end": Break({3: SILENT}, 0.6, "silent at the end", for_s=3.6),
    "a long silence at the end": Break({3: SILENT}, 2.0, "silent at the end", for_s=5.0),
    "a silence for good": Break({2: SILENT}, 10.0, "silent at the end", for_s=None),
    "another client": Break({3: steal}, 1.1),
    "another client, often": Break({3: steal, 6: steal, 9: steal}, 3.3, for_s=12),
    "a restart": Break({2: lambda lab: lab.cut_power(1.5)}, 0.0, "the box was restarted"),  # it samples nothing
    # After a short time its new count may lie above the old one, which only the times of arrival refute.
    "a restart with a higher count": Break(
        {0.5: lambda lab: lab.cut_power(0.4)}, 0.0, "the box was restarted", first_ft_sequence=0
    ),
}


@pytest.mark.parametrize("name", BREAKS)
def test_what_breaks_the_stream_costs_a_gap_with_its_losses_and_ends_the_run_where_it_does_not_come_back(
    lab: Lab, name: str
) -> None:
    broken = BREAKS[name]
    lab.box.box._first_ft_sequence = broken.first_ft_sequence
    words = () if broken.for_s is None else ("--for", broken.for_s)
    log = Recording(lab, *words, at={at_s: partial(act, lab) for at_s, act in broken.acts.items()})
    is_failed = broken.lost_s >= 2 and broken.reason == "silent at the end"

    assert log.ended.code == (3 if is_failed else 0)
    assert log.run.header.state == ("failed" if is_failed else "complete")
    assert log.reasons == [broken.reason] * sum(act is not SOUND for act in broken.acts.values())
    assert log.lost == pytest.approx(broken.lost_s * LOADCELL_HZ, rel=0.1, abs=3 * BLOCK)
    assert broken.for_s is not None or log.took_s == pytest.approx(12, abs=0.7)
    log.check(requests=broken.requests)
    if broken.reason == "the stream broke off":
        assert log.lost == (log.rows["ft_sequence"].diff().dropna() / 10 - 1).sum()


def test_while_motors_run_a_silence_ends_the_run_in_half_a_second(lab: Lab) -> None:
    lab.hardware.at(2.0, lambda: lab.loadcell_suffers(silent_after_s=0))
    with ExitStack() as held:
        cell = ready_loadcell(box_of(lab), lab.hardware, held, say=lambda _: None, patient=False)
        run, error, _ = recorded(lab.hardware, lab.folder, cell, for_s=9)

    assert isinstance(error, DeviceError)
    assert run.header.state == "failed"
    assert lab.hardware.seconds() < 1.0 + 2.0 + 0.4 + 0.05 + 0.1  # limit, block, and the stop of the box


def test_another_client_that_takes_the_stream_is_told_by_check(lab: Lab) -> None:
    lab.box.thief = STRANGER
    checked = lab.cfid("rig", "check")

    assert checked.code == 3
    assert "another client" in checked.out


def test_a_box_that_is_held_is_told_with_who_holds_it_and_left_alone(lab: Lab) -> None:
    box = box_of(lab)
    with held_elsewhere(f"{box.address}:{box.rdt_port}") as process:
        ended, checked = lab.cfid(*LOG), lab.cfid("rig", "check")

    assert (ended.code, checked.code) == (3, 0)
    assert f"process {process} " in ended.err
    assert f"process {process} " in checked.out
    assert lab.box.client == ("", 0)


# The end


@pytest.mark.parametrize("rate_hz", [1, 100])
@pytest.mark.parametrize("lost", [1, 5])
def test_requests_to_stop_that_are_lost_are_repeated_and_a_box_that_does_not_stop_is_told(
    lab: Lab, rate_hz: int, lost: int
) -> None:
    request, stops = lab.box.request, list[float]()

    def lossy(datagram: bytes, client: Address, now_s: float) -> None:
        if decode_request(datagram) == Request(Command.STOP):
            stops.append(now_s)
            if len(stops) <= lost:
                return
        request(datagram, client, now_s)

    lab.box.request = lossy  # type: ignore[method-assign]
    words = ("--rate-hz", rate_hz, "--for", 4 if rate_hz < 700 else 0.3)
    ended = lab.cfid(*LOG, *words, streaming=lost == 5)

    assert ended.code == 0
    assert 2 <= len(stops) <= 5
    assert ("switch it off" in ended.err) == (lost == 5 and rate_hz > 1)
    assert lab.hardware.seconds() < stops[0] + 1.5
    assert "gaps" not in lab.facts("loadcell")


@pytest.mark.parametrize("name", ["SIGINT", "SIGHUP"])
def test_a_signal_ends_a_run_that_is_complete_and_stops_the_box(lab: Lab, name: str) -> None:
    log = Recording(lab, "--for", 60, at={1.0: lambda: lab.hardware.request_end(name)})

    assert log.ended.code == 0
    assert log.run.header.state == "complete"
    stopped = {"SIGINT": "stopped by Ctrl-C"}.get(name, f"ended by {name}")
    assert log.run.header.reason.startswith(f"{stopped} after")
    log.check()


def test_an_end_before_the_first_row_is_an_interruption(lab: Lab) -> None:
    lab.loadcell_suffers(udp_blocked=True)
    log = Recording(lab, at={0.5: lab.hardware.request_end})

    assert (log.ended.code, log.ended.out) == (130, "")
    assert log.run.header.state == "interrupted"


def test_ctrl_c_while_the_box_is_asked_leaves_no_run(lab: Lab) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    lab.loadcell_suffers(slow_s=2.5)
    lab.hardware.at(1.0, interrupt)

    assert lab.cfid(*LOG).code == 130
    assert lab.run_folder() is None


# What cannot be recorded


@pytest.mark.parametrize(("words", "took_s"), [((), 3.5), (("--for", 0.5), 1.0)])
def test_a_box_whose_records_never_arrive_fails_the_run_and_check_names_the_firewall(
    lab: Lab, words: tuple[object, ...], took_s: float
) -> None:
    lab.loadcell_suffers(udp_blocked=True)
    log, checked = Recording(lab, *words), lab.cfid("rig", "check")

    assert log.ended.code == checked.code == 3
    assert log.run.header.state == "failed"
    assert (len(log.rows), log.gaps) == (0, [])
    assert log.took_s < took_s
    assert "firewall" in checked.out


def test_a_box_that_is_off_is_told_by_log_and_by_check(lab: Lab) -> None:
    lab.loadcell_suffers(restart_after_s=0, restart_for_s=1e9)
    ended, checked = lab.cfid(*LOG), lab.cfid("rig", "check")

    assert ended.code == checked.code == 3
    assert "no answer" in ended.err
    assert checked.out.count("no answer") == 2  # over HTTP and TCP
    assert checked.err.endswith("cfid: not ready: loadcell.\n")
    assert lab.run_folder() is None


@contextmanager
def answering(answer: bytes) -> Iterator[int]:
    """Answer every request over TCP with the same bytes; yield the port."""

    class Answer(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            self.request.recv(4096)
            self.request.sendall(answer)

    with socketserver.TCPServer(("127.0.0.1", 0), Answer) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield server.server_address[1]
        server.shutdown()
        thread.join()


@pytest.mark.parametrize(
    ("answer", "word"),
    [
        (b"HTTP/1.0 200 OK\r\n\r\n<router><name>r</name></router>", "setcfgsel"),
        (b"SSH-2.0-OpenSSH_9.6\r\n", "does not speak HTTP"),
        (b"", "Is the box powered"),
    ],
    ids=["other XML", "no HTTP", "hung up"],
)
def test_another_device_at_the_address_is_told(answer: bytes, word: str) -> None:
    with answering(answer) as port:
        box = LoadCellBox(address="127.0.0.1", http_port=port, tcp_port=port)
        with pytest.raises(DeviceError, match=word):
            read_settings(box, Real())
        found = check_loadcell(box, Real())

    assert [answer.state for answer in found] == ["fault", "fault"]  # over HTTP and TCP


# What the status word reports


@pytest.mark.parametrize(
    ("act", "word"),
    [
        (lambda box: box.load_cell.overload(), "saturation"),
        (lambda box: setattr(box, "status", 0x80020000), "saturation"),
        (lambda box: setattr(box, "status", 0x88000000), "link to the transducer"),
    ],
    ids=["overload", "saturation", "link"],
)
def test_an_error_ends_the_run_within_100_ms_with_its_rows_kept(
    lab: Lab, act: Callable[[Any], object], word: str
) -> None:
    log = Recording(lab, at={2.0: lambda: act(lab.box.box)})

    assert log.ended.code == 3
    assert log.run.header.state == "failed"
    assert word in log.run.header.reason
    assert (log.rows["status"] == 0).sum() == pytest.approx(2 * LOADCELL_HZ, abs=60)
    assert log.took_s < 2 + 0.1 + 0.2  # the limit, and the stop of the stream
    assert lab.cfid("rig", "check").code == 3


def test_a_latched_threshold_is_a_note_and_no_fault(lab: Lab) -> None:
    lab.box.box.status = 0x80010000
    log = Recording(lab, "--for", 1)

    assert log.ended.code == 0
    assert log.ended.err.count("0x80010000") == 1
    assert log.facts["said"] == ["a threshold is latched"]
