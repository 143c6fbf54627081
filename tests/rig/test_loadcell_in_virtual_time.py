"""A load cell recorded for minutes on a clock that the test advances: losses, delays, duplicates, gaps and returns."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cfid.errors import DeviceError
from cfid.records.run import Run
from cfid.sim.faults import LoadCellFaults
from cfid.wire.rdt import Command, Request, decode_request, encode_request
from tests.known import known
from tests.rig.virtual import STEP_S, UNIX_S, RdtWire, Session, loadcell, rows_of

SOUND = LoadCellFaults()
STRANGER = ("192.0.2.66", 4000)


def facts(run: Run) -> dict[str, Any]:
    return dict(run.header.devices["loadcell"].model_extra or {})


@pytest.mark.parametrize("for_s", [120, pytest.param(600, marks=pytest.mark.slow)])
@pytest.mark.parametrize("buffered", [True, False])
def test_minutes_are_recorded_without_a_gap(session: Session, buffered: bool, for_s: int) -> None:
    instrument, box, wire = loadcell(session, SOUND, buffered=buffered)

    run, failure = session.record(instrument, for_s=for_s)
    rows = rows_of(run, "loadcell")

    assert failure is None
    assert run.header.devices["loadcell"].lost == 0
    assert len(rows) == pytest.approx(for_s * 700, abs=30)
    assert np.all(np.diff(rows["rdt_sequence"]) == 1)
    assert np.all(np.diff(rows["ft_sequence"]) == 10)
    assert not box.streaming
    assert wire.closed


def test_the_wrap_of_the_boxes_count_is_no_gap(session: Session) -> None:
    instrument, _, _ = loadcell(session, SOUND, first_ft=2**32 - 20_000)

    run, failure = session.record(instrument, for_s=10)
    rows = rows_of(run, "loadcell")

    assert failure is None
    assert rows["ft_sequence"].min() < 10 < 2**32 - 10_000 < rows["ft_sequence"].max()
    assert run.header.devices["loadcell"].lost == 0
    assert np.allclose(np.diff(rows["t"]), 1 / 700, atol=2e-6)


def test_what_the_network_drops_is_counted_record_by_record(session: Session) -> None:
    instrument, box, _ = loadcell(session, LoadCellFaults(drop_every=7))

    run, _ = session.record(instrument, for_s=20)
    rows = rows_of(run, "loadcell")
    sent = int(rows["rdt_sequence"].iloc[-1])

    assert run.header.devices["loadcell"].lost == sent - len(rows)
    assert sent - len(rows) == pytest.approx(box.mishaps.dropped_records, abs=14)


@pytest.mark.parametrize("numbers", [(0, 1_000_000), (100_000, 1_000_000), (0, -50_000)])
def test_a_count_that_jumps_is_a_break_and_no_time(session: Session, numbers: tuple[int, int]) -> None:
    instrument, _, wire = loadcell(session, SOUND)
    take_in, came = wire.inbox.add, list[float]()

    def jump(data: bytes, source: tuple[str, int], arrival_s: float) -> None:
        """Add to the numbers of each record from the third second on."""
        came.append(arrival_s)
        words = np.frombuffer(data, ">u4").reshape(-1, 9).copy()
        if len(came) > 150:  # datagrams of 14 records at 700 Hz
            words[:, :2] = (words[:, :2].astype(np.int64) + numbers) % 2**32
        take_in(words.tobytes(), source, arrival_s)

    wire.deliver = jump
    run, failure = session.record(instrument, for_s=5)
    rows = rows_of(run, "loadcell")

    assert failure is None
    assert rows["t"].iloc[-1] - rows["t"].iloc[0] == pytest.approx(5, abs=0.2)
    assert np.all(np.diff(rows["t"]) > 0)
    assert [gap["reason"] for gap in facts(run)["gaps"]] == ["the box' count jumped"]
    assert known(run.header.devices["loadcell"].lost) < 50


def test_doubled_and_swapped_datagrams_leave_no_trace_but_a_count(session: Session) -> None:
    instrument, box, _ = loadcell(session, LoadCellFaults(duplicate_every=5, reorder_every=9))

    run, _ = session.record(instrument, for_s=20)
    rows = rows_of(run, "loadcell")
    arrivals = facts(run)["arrivals"]

    assert np.all(np.diff(rows["rdt_sequence"]) > 0)
    assert np.all(np.diff(rows["t"]) > 0)
    assert arrivals["duplicates"] == pytest.approx(box.mishaps.duplicated_records, abs=14)
    assert arrivals["reordered"] > 0
    assert len(rows) + known(run.header.devices["loadcell"].lost) == rows["rdt_sequence"].iloc[-1]


def test_garbled_datagrams_are_never_rows_with_a_wrong_number(session: Session) -> None:
    instrument, _, wire = loadcell(session, SOUND, buffered=False)
    take_in, rng = wire.inbox.add, np.random.default_rng(6)
    harmed = {"cut": 0, "flipped": 0}

    def harm(data: bytes, source: tuple[str, int], arrival_s: float) -> None:
        """Cut about one datagram in twelve, and flip a bit of the numbers in about another."""
        fate = rng.integers(12)
        garbled = bytearray(data)
        if fate == 0:
            garbled = garbled[: rng.integers(1, 36)]
            harmed["cut"] += 1
        elif fate == 1:
            garbled[rng.integers(8)] ^= 1 << rng.integers(8)
            harmed["flipped"] += 1
        take_in(bytes(garbled), source, arrival_s)

    wire.deliver = harm
    run, failure = session.record(instrument, for_s=60)
    rows = rows_of(run, "loadcell")

    assert failure is None
    assert np.all(rows["ft_sequence"] - 10 * rows["rdt_sequence"] == rows["ft_sequence"][0] - 10)
    assert facts(run)["arrivals"]["malformed_datagrams"] == harmed["cut"]
    assert facts(run)["arrivals"]["rejected"] == harmed["flipped"]
    assert len(rows) + known(run.header.devices["loadcell"].lost) == rows["rdt_sequence"].iloc[-1]


def test_a_silence_is_bridged_by_asking_again_and_noted_as_a_gap(session: Session) -> None:
    instrument, _, _ = loadcell(session, LoadCellFaults(silent_after_s=5, silent_for_s=4))

    run, failure = session.record(instrument, for_s=15)
    rows = rows_of(run, "loadcell")
    (gap,) = facts(run)["gaps"]
    missing = (rows["ft_sequence"].diff().dropna() / 10 - 1).sum()

    assert failure is None
    assert gap["to_s"] - gap["from_s"] == pytest.approx(4, abs=1.2)
    assert run.header.devices["loadcell"].lost == missing
    assert missing == pytest.approx(4 * 700, rel=0.3)
    assert any("silent" in sentence for sentence in session.said)
    assert rows["t"].diff().max() == pytest.approx((missing + 1) / 700, abs=STEP_S)


def test_a_box_that_restarts_is_asked_again_and_time_never_goes_back(session: Session) -> None:
    instrument, _, _ = loadcell(session, LoadCellFaults(restart_after_s=5, restart_for_s=1.5), first_ft=500_000)

    run, failure = session.record(instrument, for_s=12)
    rows = rows_of(run, "loadcell")
    (gap,) = facts(run)["gaps"]

    assert failure is None
    assert gap["reason"] == "the box was restarted"
    assert rows["ft_sequence"].diff().min() < 0
    assert rows["t"].diff().min() > 0
    assert rows["t"].iloc[-1] - rows["t"].iloc[0] == pytest.approx(12, abs=0.1)


def test_a_restart_after_which_the_box_counts_on_from_above_is_seen_by_when_its_records_come(
    session: Session,
) -> None:
    instrument, _, _ = loadcell(session, LoadCellFaults(restart_after_s=0.3, restart_for_s=0.4), first_ft=0)

    run, failure = session.record(instrument, for_s=5)
    rows = rows_of(run, "loadcell")
    (gap,) = facts(run)["gaps"]

    assert failure is None
    assert rows["ft_sequence"].diff().min() > 0
    assert gap["reason"] == "the box was restarted"
    assert rows["t"].iloc[-1] == pytest.approx(UNIX_S + 5, abs=0.03)
    assert rows["t"].diff().min() > 0
    assert run.header.devices["loadcell"].lost == 0  # records that a box without power would have sampled are not lost


def test_a_silence_at_the_end_is_a_gap_with_its_losses(session: Session) -> None:
    instrument, box, _ = loadcell(session, LoadCellFaults(silent_after_s=3))

    run, failure = session.record(instrument, for_s=3.6)
    (gap,) = facts(run)["gaps"]

    assert failure is None
    assert gap["reason"] == "silent at the end"
    assert gap["to_s"] - gap["from_s"] == pytest.approx(0.6, abs=0.06)
    assert run.header.devices["loadcell"].lost == pytest.approx(0.6 * 700, abs=0.06 * 700)
    assert facts(run)["arrivals"]["lost"] == run.header.devices["loadcell"].lost
    assert not box.streaming


def test_another_client_that_takes_the_stream_again_and_again_ends_the_run(session: Session) -> None:
    instrument, box, _ = loadcell(session, SOUND)
    thefts = [0]

    def steal(now_s: float) -> None:
        if now_s > 3 * (thefts[0] + 1):
            thefts[0] += 1
            box.box.request(encode_request(Request(Command.REAL_TIME)), STRANGER, now_s)
            box.box.request(encode_request(Request(Command.STOP)), STRANGER, now_s)

    run, failure = session.record(instrument, for_s=120, also=steal)

    assert isinstance(failure, DeviceError)
    assert "another client" in str(failure)
    assert run.header.state == "failed"
    assert len(rows_of(run, "loadcell")) > 5 * 700


def test_a_box_that_never_sends_is_given_up_after_three_seconds(session: Session) -> None:
    instrument, _, _ = loadcell(session, LoadCellFaults(udp_blocked=True))

    run, failure = session.record(instrument, for_s=None)

    assert isinstance(failure, DeviceError)
    assert "sent nothing" in str(failure)
    assert session.clock.seconds() < 4
    assert len(rows_of(run, "loadcell")) == 0


def test_a_box_that_stays_silent_is_given_up_with_its_rows_kept(session: Session) -> None:
    instrument, _, _ = loadcell(session, LoadCellFaults(silent_after_s=5))

    run, failure = session.record(instrument, for_s=None)

    assert isinstance(failure, DeviceError)
    assert "sent nothing more" in str(failure)
    assert len(rows_of(run, "loadcell")) == pytest.approx(5 * 700, abs=50)


@pytest.mark.parametrize(("status", "word"), [(0x80020000, "saturation"), (0x80000004, "its own temperature is wrong")])
def test_an_error_bit_ends_the_run_within_100_ms(session: Session, status: int, word: str) -> None:
    instrument, box, _ = loadcell(session, LoadCellFaults(status_after_s=3, status=status))

    run, failure = session.record(instrument, for_s=60)
    rows = rows_of(run, "loadcell")

    assert isinstance(failure, DeviceError)
    assert word in str(failure)
    assert session.clock.seconds() < 3 + 0.1 + 0.2  # the fault, the limit, and the stop of the stream
    assert not box.streaming
    assert (rows["status"] == status).any()


def test_a_load_beyond_the_range_ends_the_run(session: Session) -> None:
    instrument, _, _ = loadcell(session, LoadCellFaults(saturate_after_s=2))

    _, failure = session.record(instrument, for_s=60)

    assert isinstance(failure, DeviceError)
    assert "saturation" in str(failure)


@pytest.mark.parametrize("bit", [16, 17, 31])
def test_a_status_bit_that_was_flipped_on_the_way_ends_no_run(session: Session, bit: int) -> None:
    instrument, _, wire = loadcell(session, SOUND)
    take_in, rng = wire.inbox.add, np.random.default_rng(7)

    def harm(data: bytes, source: tuple[str, int], arrival_s: float) -> None:
        """Flip the bit in one record of about every other datagram."""
        garbled = bytearray(data)
        if rng.integers(2):
            garbled[36 * rng.integers(1, 13) + 8 + (31 - bit) // 8] ^= 1 << bit % 8
        take_in(bytes(garbled), source, arrival_s)

    wire.deliver = harm
    run, failure = session.record(instrument, for_s=10)

    assert failure is None
    assert session.said == []
    assert (rows_of(run, "loadcell")["status"] == 1 << bit).sum() > 100  # the bit stays in its row


# The end


def without(wire: RdtWire, lost: Callable[[int], bool]) -> list[float]:
    """Lose those requests to stop whose number, from 1, `lost` selects; return the times at which they were sent."""
    send, stops = wire.send, []

    def sometimes(datagram: bytes) -> None:
        if decode_request(datagram) == Request(Command.STOP):
            stops.append(wire.clock.seconds())
            if lost(len(stops)):
                return
        send(datagram)

    wire.send = sometimes  # type: ignore[method-assign]
    return stops


@pytest.mark.parametrize("rate_hz", [1, 2, 7, 33, 100, 700, 7000])
def test_a_request_to_stop_that_is_lost_leaves_no_stream(session: Session, rate_hz: int) -> None:
    instrument, box, wire = loadcell(session, SOUND, buffered=False, rate_hz=rate_hz)
    stops = without(wire, lambda number: number == 1)

    run, failure = session.record(instrument, for_s=4)

    assert failure is None
    assert not box.streaming
    assert len(stops) >= 2
    assert session.clock.seconds() < stops[0] + 1.5
    assert session.said == []
    assert facts(run)["gaps"] == []


@pytest.mark.parametrize("rate_hz", [7, 700])
def test_a_box_that_does_not_stop_is_said(session: Session, rate_hz: int) -> None:
    instrument, box, wire = loadcell(session, SOUND, buffered=False, rate_hz=rate_hz)
    stops = without(wire, lambda number: True)

    _, failure = session.record(instrument, for_s=4)

    assert failure is None
    assert box.streaming
    assert len(stops) == 5
    assert session.clock.seconds() < stops[0] + 1.5
    assert session.said == ["box keeps streaming after 5 requests to stop: switch it off and on."]


def test_a_latched_threshold_is_only_said_once(session: Session) -> None:
    instrument, _, _ = loadcell(session, LoadCellFaults(status_after_s=1, status=0x80010000))

    run, failure = session.record(instrument, for_s=5)

    assert failure is None
    assert sum("threshold is latched" in sentence for sentence in session.said) == 1
    assert facts(run)["said"] == ["a threshold is latched"]


def test_datagrams_from_elsewhere_are_dropped_and_counted(session: Session) -> None:
    instrument, _, wire = loadcell(session, SOUND)

    def disturb(now_s: float) -> None:
        wire.inbox.add(bytes(36), STRANGER, now_s)

    run, failure = session.record(instrument, for_s=3, also=disturb)

    assert failure is None
    assert facts(run)["arrivals"]["foreign_datagrams"] == pytest.approx(600, abs=20)
    assert run.header.devices["loadcell"].lost == 0


def test_a_smaller_receive_buffer_is_said(session: Session) -> None:
    instrument, _, wire = loadcell(session, SOUND)
    wire.buffer_bytes = 212_992

    run, _ = session.record(instrument, for_s=1)

    assert any("caps the receive buffer at 208 KiB" in sentence for sentence in session.said)
    assert facts(run)["receive_buffer_bytes"] == 212_992


def test_an_end_asked_for_stops_the_box(session: Session) -> None:
    instrument, box, _ = loadcell(session, SOUND)

    def end(now_s: float) -> None:
        if now_s > 2:
            session.ending.request("SIGTERM")

    run, failure = session.record(instrument, for_s=None, also=end)

    assert failure is None
    assert not box.streaming
    assert len(rows_of(run, "loadcell")) == pytest.approx(2 * 700, abs=50)
