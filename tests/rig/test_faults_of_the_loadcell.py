"""Each fault of the load cell or its network leads to a sentence, an exit code and correct rows."""

import signal
import socket
import socketserver
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cfid.sim.netft import BoxPorts
from cfid.wire.rdt import Command, Request, encode_request
from tests.known import known
from tests.virtual_lab import LOADCELL_HZ, Lab, lab_in, wait_until

LOG = ("log", "loadcell")
BLOCK = 14  # records per datagram
FIRST = LOADCELL_HZ // 4  # rows to wait for


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with lab_in(tmp_path) as lab:
        yield lab


def rows_of(lab: Lab) -> pd.DataFrame:
    return pd.read_csv(lab.run().device_file("loadcell"))


def check_count(lab: Lab) -> None:
    """Check that rows and losses add up to what the box sent, and that no time or number occurs twice."""
    rows = rows_of(lab)
    record = lab.run().header.devices["loadcell"]
    assert record.rows == len(rows)
    assert len(rows) + known(record.lost) == rows["rdt_sequence"].iloc[-1]
    assert np.all(np.diff(rows["rdt_sequence"]) > 0)
    assert np.all(np.diff(rows["t"]) > 0)


@contextmanager
def answering(answer: bytes) -> Iterator[int]:
    """Answer every request over TCP with the same bytes; yield the port."""

    class Answer(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            self.request.recv(4096)
            self.request.sendall(answer)

    with socketserver.TCPServer(("127.0.0.1", 0), Answer) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        yield server.server_address[1]
        server.shutdown()
        thread.join()


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


# Datagrams


def test_datagrams_that_the_network_drops_are_counted_record_by_record(lab: Lab) -> None:
    lab.loadcell_suffers(drop_every=7)

    ended = lab.cfid(*LOG, "--for", 1.5)
    lost = lab.run().header.devices["loadcell"].lost

    assert ended.code == 0
    assert f"{lost} lost ->" in ended.out
    assert lost == pytest.approx(lab.box.mishaps.dropped_records, abs=BLOCK)
    check_count(lab)


def test_doubled_and_swapped_datagrams_are_put_in_order_and_counted(lab: Lab) -> None:
    lab.loadcell_suffers(duplicate_every=5, reorder_every=9)

    ended = lab.cfid(*LOG, "--for", 1.5)
    arrivals = lab.facts("loadcell")["arrivals"]

    assert ended.code == 0
    assert "duplicates" in ended.out
    assert "reordered" in ended.out
    assert arrivals["duplicates"] == pytest.approx(lab.box.mishaps.duplicated_records, abs=BLOCK)
    assert arrivals["reordered"] > 0
    check_count(lab)


def test_garbled_datagrams_are_counted_and_no_row_is_out_of_its_place(lab: Lab) -> None:
    lab.loadcell_suffers(corrupt_every=4)

    ended = lab.cfid(*LOG, "--for", 1.5)
    rows = rows_of(lab)

    assert ended.code == 0
    assert lab.facts("loadcell")["arrivals"]["malformed_datagrams"] > 0
    assert np.all(rows["ft_sequence"] - 10 * rows["rdt_sequence"] == rows["ft_sequence"][0] - 10)
    check_count(lab)


def test_datagrams_of_strangers_are_counted_and_dropped(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for _ in range(20):
            stranger.sendto(bytes(36), lab.box.client)
    log.wait_for_rows(FIRST)
    ended = log.ask_to_end()

    assert ended.code == 0
    assert "20 foreign datagrams" in ended.out
    assert lab.facts("loadcell")["arrivals"]["foreign_datagrams"] == 20
    assert lab.run().header.devices["loadcell"].lost == 0
    check_count(lab)


# Silence


def test_a_silence_that_ends_is_a_gap_with_its_losses(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    lab.loadcell_suffers(silent_after_s=0)
    log.wait_until_said("is silent; requesting the stream again")
    lab.loadcell_suffers()
    log.wait_until_said("records again after")
    log.wait_for_rows(FIRST)
    ended = log.ask_to_end()
    (gap,) = lab.facts("loadcell")["gaps"]

    assert ended.code == 0
    assert gap["reason"] == "the stream broke off"
    assert gap["to_s"] - gap["from_s"] > 0.9
    assert lab.run().header.state == "complete"
    assert known(lab.run().header.devices["loadcell"].lost) > 0.9 * LOADCELL_HZ


def test_a_silence_for_good_fails_the_run_after_ten_seconds(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    lab.loadcell_suffers(silent_after_s=0)
    ended = log.end()
    run = lab.run()

    assert ended.code == 3
    assert "sent nothing more for" in ended.err
    assert "`cfid rig check` finds which" in ended.err
    assert run.header.state == "failed"
    assert "sent nothing more for" in run.header.reason
    assert len(rows_of(lab)) >= FIRST


def test_a_stream_that_is_silent_at_the_end_fails_the_run(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    lab.loadcell_suffers(silent_after_s=0)
    log.wait_until_said("is silent; requesting the stream again")
    ended = log.ask_to_end()

    assert ended.code == 3
    assert "sent nothing more for" in ended.err
    assert lab.run().header.state == "failed"
    assert len(rows_of(lab)) >= FIRST


def test_a_box_that_restarts_is_asked_again(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    lab.cut_power(1.5)
    log.wait_until_said("the box was restarted; records again after")
    log.wait_for_rows(FIRST)
    ended = log.ask_to_end()
    rows = rows_of(lab)

    assert ended.code == 0
    assert [gap["reason"] for gap in lab.facts("loadcell")["gaps"]] == ["the box was restarted"]
    assert rows["ft_sequence"].diff().min() < 0
    assert rows["t"].diff().min() > 0


def steal(lab: Lab) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
        thief.sendto(encode_request(Request(Command.REAL_TIME)), ("127.0.0.1", lab.ports.rdt))
        wait_until(lambda: lab.box.client == ("127.0.0.1", thief.getsockname()[1]), "the theft")


def test_another_client_that_takes_the_stream_once_costs_a_gap(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    steal(lab)
    log.wait_until_said("the stream broke off; records again after")
    ended = log.ask_to_end()

    assert ended.code == 0
    assert [gap["reason"] for gap in lab.facts("loadcell")["gaps"]] == ["the stream broke off"]
    assert known(lab.run().header.devices["loadcell"].lost) > 0


def test_another_client_that_takes_the_stream_is_told_by_check(lab: Lab) -> None:
    lab.box.thief = ("192.0.2.66", 4000)

    checked = lab.cfid("rig", "check")

    assert checked.code == 3
    assert "-> the stream broke off: another client uses the same box" in checked.out


def test_another_client_that_takes_the_stream_again_and_again_ends_the_run(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    for theft in range(1, 4):
        steal(lab)
        log.wait_until_said("requesting the stream again", times=theft)
        if theft < 3:
            log.wait_until_said("records again", times=theft)
    ended = log.end()

    assert ended.code == 3
    assert "broke off 3 times" in ended.err
    assert "another client takes it" in ended.err
    assert lab.run().header.state == "failed"
    reasons = [gap["reason"] for gap in lab.facts("loadcell")["gaps"]]
    assert reasons == ["the stream broke off", "the stream broke off", "silent at the end"]


# A box that does not answer, or another device


def test_a_firewall_that_keeps_udp_out_is_told_by_log_and_by_check(lab: Lab) -> None:
    lab.loadcell_suffers(udp_blocked=True)

    ended = lab.cfid(*LOG)
    checked = lab.cfid("rig", "check")

    assert ended.code == checked.code == 3
    assert "sent nothing, despite repeated requests" in ended.err
    assert "`cfid rig check` finds which" in ended.err
    assert "open UDP in this computer's firewall" in checked.out
    assert lab.run().header.state == "failed"
    assert lab.run().header.devices["loadcell"].rows == 0


def test_a_log_without_a_single_row_is_failed_however_short(lab: Lab) -> None:
    lab.loadcell_suffers(udp_blocked=True)

    ended = lab.cfid(*LOG, "--for", 0.5)

    assert ended.code == 3
    assert "loadcell: not one sample in 0." in ended.err
    assert lab.run().header.state == "failed"


def test_a_slow_box_is_waited_for(lab: Lab) -> None:
    lab.loadcell_suffers(slow_s=0.3)

    ended = lab.cfid(*LOG, "--for", 0.5)
    checked = lab.cfid("rig", "check")

    assert ended.code == checked.code == 0
    assert "reading, TCP    ok" in checked.out
    check_count(lab)


def test_a_box_that_takes_longer_than_three_seconds_is_given_up(lab: Lab) -> None:
    lab.loadcell_suffers(slow_s=30)

    ended = lab.cfid(*LOG)
    checked = lab.cfid("rig", "check")

    assert ended.code == checked.code == 3
    assert "no answer within 3 s. Is the box powered" in ended.err
    assert checked.out.count("no answer within 3 s") == 2  # HTTP and TCP
    assert lab.run_folder() is None


def test_a_box_that_is_off_is_told_by_log_and_by_check(lab: Lab) -> None:
    lab.point_at(BoxPorts(free_port(), free_port(), free_port()))

    ended = lab.cfid(*LOG)
    checked = lab.cfid("rig", "check")

    assert ended.code == checked.code == 3
    assert "no program listens there (connection refused). Is the box powered" in ended.err
    assert checked.out.count("no program listens there") == 2
    assert checked.err == "cfid: not ready: loadcell.\n"
    assert lab.run_folder() is None


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (b"HTTP/1.0 404 Not Found\r\n\r\n", "answers 404 Not Found, where a Net F/T has its settings: another device"),
        (b"HTTP/1.0 200 OK\r\n\r\n<router><name>r</name></router>", "<setcfgsel> is missing. Is 127.0.0.1 a Net F/T?"),
        (b"SSH-2.0-OpenSSH_9.6\r\n", "the device that answers there does not speak HTTP: it is another one"),
        (b"", "Is the box powered"),
    ],
    ids=["404", "other XML", "no HTTP", "hung up"],
)
def test_another_device_at_the_address_is_told(lab: Lab, answer: bytes, expected: str) -> None:
    with answering(answer) as port:
        lab.point_at(lab.ports._replace(http=port))
        ended = lab.cfid(*LOG)
        checked = lab.cfid("rig", "check")

    assert ended.code == checked.code == 3
    assert expected in ended.err
    assert expected in checked.out
    assert lab.run_folder() is None


@pytest.mark.parametrize("address", ["a box", "a..b", ""])
def test_an_address_that_is_none_is_told(lab: Lab, address: str) -> None:
    ended = lab.cfid(*LOG, "--address", address)

    assert ended.code == 3
    assert ended.err.startswith(f"cfid: '{address}' is no address in this network")


def test_an_address_that_is_none_is_told_by_check(lab: Lab) -> None:
    lab.point_at(lab.ports, address="a box")

    checked = lab.cfid("rig", "check")

    assert checked.code == 3
    assert "'a box' is no address in this network" in checked.out


def test_a_box_may_be_named_instead_of_numbered(lab: Lab) -> None:
    ended = lab.cfid(*LOG, "--address", "localhost", "--for", 0.5)

    assert ended.code == 0
    assert lab.facts("loadcell")["address"].startswith("127.0.0.1:")


# Settings


def test_a_box_that_refuses_settings_is_told(lab: Lab) -> None:
    lab.loadcell_suffers(refuse_settings=True)

    ended = lab.cfid(*LOG, "--rate-hz", 350)

    assert ended.code == 3
    assert "set to 350 Hz and 7 records a datagram, the box keeps 700 Hz and 14" in ended.err
    assert lab.run_folder() is None


def test_a_rate_that_the_box_does_not_have_is_told_with_one_that_it_has(lab: Lab) -> None:
    ended = lab.cfid(*LOG, "--rate-hz", 3000)

    assert ended.code == 3
    assert "the box keeps 3500 Hz" in ended.err
    assert "Its rates are 7000/n Hz: set devices.loadcell.rate_hz in rig.toml to such a rate, 3500 for" in ended.err


# What the status word reports


def test_a_load_beyond_the_range_ends_the_run_with_its_rows_kept(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    lab.in_reactor(lab.box.box.load_cell.overload)
    ended = log.end()
    checked = lab.cfid("rig", "check")

    assert ended.code == checked.code == 3
    assert "reading, TCP    fault    saturation, or the converter failed" in checked.out
    assert "saturation, or the converter failed: the readings from here on are not forces" in ended.err
    assert lab.run().header.state == "failed"
    assert "saturation" in lab.run().header.reason
    assert (rows_of(lab)["status"] == 0).sum() >= FIRST


def test_an_error_bit_ends_the_run_with_its_name(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    lab.box.box.status = 0x88000000
    ended = log.end()
    checked = lab.cfid("rig", "check")

    message = "the link to the transducer failed"
    assert ended.code == checked.code == 3
    assert f"{message}: the readings from here on are not forces" in ended.err
    assert message in lab.run().header.reason
    assert f"reading, TCP    fault    {message}" in checked.out
    assert (rows_of(lab)["status"] == 0).sum() >= FIRST


def test_a_latched_threshold_is_a_note_and_no_fault(lab: Lab) -> None:
    lab.box.box.status = 0x80010000

    ended = lab.cfid(*LOG, "--for", 0.5)

    assert ended.code == 0
    assert ended.err.count("a threshold is latched (status 0x80010000); not a fault: the recording goes on") == 1
    assert lab.facts("loadcell")["said"] == ["a threshold is latched"]


# This computer


def test_a_box_that_is_held_is_told_with_who_holds_it_and_left_alone(lab: Lab) -> None:
    log = lab.start(*LOG, anew=True)
    log.wait_for_rows(FIRST)
    second = lab.cfid(*LOG, streaming=True)
    checked = lab.cfid("rig", "check", streaming=True)
    log.wait_for_rows(FIRST)
    ended = log.ask_to_end()

    assert second.code == 3
    assert f"is held by process {log.process.pid} (cfid log loadcell). End that first." in second.err
    assert checked.code == ended.code == 0
    assert "settings, HTTP  ok" in checked.out
    assert "reading, TCP    ok" in checked.out
    assert f"RDT, UDP        ok       held by process {log.process.pid} (cfid log loadcell)" in checked.out
    assert lab.facts("loadcell")["gaps"] == []
    check_count(lab)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
def test_a_disk_that_takes_no_more_fails_the_run_and_stops_the_box(lab: Lab) -> None:
    limited = ("bash", "-c", 'ulimit -f 40; exec "$@"', "limited")  # KiB: half a second of rows
    ended = lab.start(*LOG, wrapper=limited).end()
    run = lab.run()

    assert ended.code == 4
    assert "loadcell.csv: File too large after" in ended.err
    assert "rows, which are kept" in ended.err
    assert run.header.state == "failed"
    assert run.header.devices["loadcell"].rows == len(rows_of(lab)) > 100
    assert "arrivals" in lab.facts("loadcell")


# Ends


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_ends_a_run_that_is_complete(lab: Lab, name: str) -> None:
    log = lab.start(*LOG, "--for", 60)
    log.wait_for_rows(FIRST)
    ended = log.ask_to_end(signal.Signals[name])

    assert ended.code == 0
    assert lab.run().header.state == "complete"
    assert lab.run().header.reason.startswith(f"ended by {name} after")
    assert lab.run().header.reason in ended.out
    check_count(lab)


def test_ctrl_c_before_the_first_row_is_an_interruption(lab: Lab) -> None:
    lab.loadcell_suffers(udp_blocked=True)
    log = lab.start(*LOG)
    log.wait_until_said("recording into")
    ended = log.ask_to_end()

    assert ended.code == 130
    assert ended.out == ""
    assert lab.run().header.state == "interrupted"


def test_ctrl_c_while_the_box_is_asked_leaves_no_run(lab: Lab) -> None:
    lab.loadcell_suffers(slow_s=30)
    log = lab.start(*LOG)
    log.wait_until(lambda: lab.box.contacts, "the first question")
    ended = log.ask_to_end()

    assert ended.code == 130
    assert lab.run_folder() is None


def test_a_killed_log_is_cut_and_the_next_one_takes_the_stream(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    log.process.kill()
    log.process.wait()
    assert lab.box.streaming  # nothing stopped it
    assert lab.run().cut
    ended = lab.cfid(*LOG, "--for", 0.5)

    assert ended.code == 0
    assert " 0 lost" in ended.out
