"""Devices that send lines, over pseudo terminals and in virtual time: whole lines are rows, all else is counted."""

import json
import os
import re
import threading
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.console.log_summary import devices_of
from cfid.errors import ConfigError, DeviceError
from cfid.recordings.angle import angle_record
from cfid.recordings.read import read_recording
from cfid.recordings.wrench import wrench_of
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import EncoderLines, LineValue, LoadCellLines, new_rig_text
from cfid.records.run import Facts, Label, Run, facts_of, gaps
from cfid.rig.check_lines import check_lines
from cfid.rig.device import Device
from cfid.rig.encoder import Receiver
from cfid.rig.lines import Lines
from cfid.rig.listening import Port
from cfid.rig.lock import DeviceLock
from cfid.rig.log import Plan, record_run
from cfid.rig.loop import Loop
from cfid.rig.ready_sensors import ready_encoder, ready_loadcell
from cfid.rig.recorder import sleep
from tests.known import known
from tests.rig.virtual import UNIX_S, Session, rows_of
from tests.rig_in_a_folder import lab_in, rig_sim

CELL = LoadCellLines(
    kind="lines",
    port="port",
    rate_hz=80,
    values=(LineValue(name="device_us"), LineValue(name="Fz", unit="g", scale=0.5)),
)
G = 9.80665e-3  # newtons per gram


class Cable:
    """A cable whose far end the test holds."""

    def __init__(self) -> None:
        self.receiver: Receiver | None = None
        self.there = True

    def listen(self, port: str, receiver: Receiver) -> Port:
        if not self.there:
            raise DeviceError(f"{port}: no such port.")
        self.receiver = receiver
        return self

    def send(self, data: bytes) -> None:
        if self.receiver is not None and self.there:
            self.receiver.received(data)

    def pull(self) -> None:
        assert self.receiver is not None
        receiver, self.receiver, self.there = self.receiver, None, False
        receiver.disconnected()

    def close(self) -> None:
        self.receiver = None


def cell(session: Session, *, patient: bool = True, device: LoadCellLines = CELL) -> tuple[Lines, Cable]:
    cable = Cable()
    instrument = Lines(
        "loadcell",
        device,
        listen=cable.listen,
        loop=session.clock,
        clock=session.host,
        say=session.said.append,
        patient=patient,
    )
    return instrument, cable


def sending(cable: Cable, line: Callable[[int], bytes], *, period_s: float = 0.0125) -> Callable[[float], None]:
    """Return a function for every step of a session, which sends lines on a grid."""
    sent = 0

    def step(now_s: float) -> None:
        nonlocal sent
        while (sent + 1) * period_s <= now_s:
            sent += 1
            cable.send(line(sent))

    return step


def line(count: int) -> bytes:
    return b"%d,%d\r\n" % ((12500 * count + 4294000000) % (1 << 32), 100 + count)


def facts(run: Run) -> dict[str, Any]:
    return dict(run.header.devices["loadcell"].model_extra or {})


# In virtual time


def test_lines_are_rows_in_newtons_with_the_devices_clock_unwrapped(session: Session) -> None:
    instrument, cable = cell(session)

    run, failure = session.record(instrument, for_s=5, also=sending(cable, line))
    rows = rows_of(run, "loadcell")

    assert failure is None
    assert list(rows.columns) == ["t", "Fz", "device_us"]
    assert rows["Fz"].to_numpy() == pytest.approx(0.5 * G * (100 + np.arange(2, len(rows) + 2)))
    assert set(np.diff(rows["device_us"])) == {12500}
    assert rows["t"].to_numpy() == pytest.approx(UNIX_S + 0.0125 * np.arange(2, len(rows) + 2), abs=0.006)
    assert set(facts(run)["losses"].values()) == {0}


def test_lines_that_do_not_match_are_counted_as_lost(session: Session) -> None:
    instrument, cable = cell(session)

    run, failure = session.record(
        instrument, for_s=5, also=sending(cable, lambda n: line(n) if n % 10 else b"\x1b]0;\x07no,%d\r\n" % n)
    )

    assert failure is None
    assert run.header.devices["loadcell"].lost == facts(run)["losses"]["lines_that_do_not_match"]
    assert run.header.devices["loadcell"].lost == pytest.approx(40, abs=1)


def torn(whole: Callable[[int], bytes], *, share: float = 0.05) -> Callable[[int], bytes]:
    """Return lines of which a share is cut anywhere, so that the next line joins them; the first and last are whole."""
    rng = np.random.default_rng(3)
    cut = {n: rng.random() for n in range(10, 460) if rng.random() < share}
    return lambda n: whole(n)[: int(cut[n] * len(whole(n)))] if n in cut else whole(n)


def ticking(count: int) -> bytes:
    return b"%d,%d\r\n" % (3_000_000 + 12500 * count, 43000 + 7 * count)


def test_lines_that_run_into_one_are_rows_or_lost(session: Session) -> None:
    """One line in twenty is cut: once, 36 of 46 were missing without a report, and 30 rows had clocks up to 2e9 us."""
    instrument, cable = cell(session)
    run, _ = session.record(instrument, for_s=6, also=sending(cable, torn(ticking)))
    rows, losses = rows_of(run, "loadcell"), facts(run)["losses"]

    places = (rows["device_us"].to_numpy() - 3_000_000) / 12500
    assert rows["Fz"].to_numpy() / (0.5 * G) == pytest.approx(43000 + 7 * places)
    assert run.header.devices["loadcell"].lost == sum(losses.values())
    assert len(rows) + sum(losses.values()) == places[-1] - places[0] + 1
    assert min(losses.values()) > 4
    (text,) = session.said
    assert text.startswith(
        f"{losses['lines_with_a_false_clock']} lines of the loadcell left out, lost: device_us jumps"
    )


@pytest.mark.parametrize("false", [[2], [3], [2, 3], [2, 4]])
def test_lines_whose_clock_is_false_at_the_begin_are_lost_as_later_ones_are(
    session: Session, false: Sequence[int]
) -> None:
    """The first line was once a row, with a clock off by up to 2e9 us: no earlier line could refute its time.

    Now it is a row once the next line continues its clock, and so is a line after one that jumped.
    """
    instrument, cable = cell(session)
    jumping = sending(cable, lambda n: b"%d,7\r\n" % (3_000_000_000 - n) if n in false else ticking(n))
    run, _ = session.record(instrument, for_s=5, also=jumping)
    rows, losses = rows_of(run, "loadcell"), facts(run)["losses"]

    places = (rows["device_us"].to_numpy() - 3_000_000) / 12500
    begin = next(count for count in range(2, 7) if not {count, count + 1} & set(false))
    assert list(places) == list(range(begin, int(places[-1]) + 1))
    assert losses["lines_with_a_false_clock"] == begin - 2
    assert run.header.devices["loadcell"].lost == begin - 2


def test_lines_that_never_came_are_lost_though_no_silence_is_long(session: Session) -> None:
    instrument, cable = cell(session)
    run, _ = session.record(instrument, for_s=5, also=sending(cable, lambda n: line(n) if n % 20 else b""))
    assert run.header.devices["loadcell"].lost == pytest.approx(20, abs=1)
    assert facts(run)["losses"]["missing_lines"] == run.header.devices["loadcell"].lost


def test_lines_of_scales_that_run_into_one_are_counted_by_the_stated_rate(session: Session) -> None:
    slow = CELL.model_copy(update={"values": CELL.values[1:], "rate_hz": 10.0, "pattern": r"ST,(\+\d{4}\.\d) g"})
    instrument, cable = cell(session, device=slow)
    lines = torn(lambda n: b"ST,+%06.1f g\r\n" % (100 + n % 7))
    run, _ = session.record(instrument, for_s=45, also=sending(cable, lines, period_s=0.1))

    assert len(rows_of(run, "loadcell")) + known(run.header.devices["loadcell"].lost) == pytest.approx(449, abs=2)
    assert facts(run)["losses"]["missing_lines"] > 10


@pytest.mark.parametrize(
    ("ticks_us", "period_s"),
    [
        pytest.param(lambda n: 12500 * n if n < 200 else 12500 * (n - 200), 0.0125, id="restarted"),
        pytest.param(lambda n: 12500 * n + 9000 * (n % 2), 0.0125, id="uneven"),
        pytest.param(lambda n: 12500 * (n - n % 2), 0.0125, id="of every second line"),
        pytest.param(lambda n: 12500 * (n - n % 20 + 20) + 20 * (n % 20), 0.0125, id="that pauses"),
    ],
)
def test_a_clock_that_goes_otherwise_costs_no_row(
    session: Session, ticks_us: Callable[[int], int], period_s: float
) -> None:
    instrument, cable = cell(session)
    send = sending(cable, lambda n: b"%d,%d\r\n" % (ticks_us(n) % (1 << 32), n), period_s=period_s)
    run, _ = session.record(instrument, for_s=1600 * period_s, also=send)

    assert len(rows_of(run, "loadcell")) == pytest.approx(1599, abs=3)
    assert known(run.header.devices["loadcell"].lost) <= 1


def test_a_clock_in_another_unit_jumps_in_every_line_and_ends_the_run(session: Session) -> None:
    instrument, cable = cell(session)
    send = sending(cable, lambda n: b"%d,%d\r\n" % (12_500_000 * n % (1 << 32), n))
    _, failure = session.record(instrument, for_s=60, also=send)
    assert isinstance(failure, DeviceError)
    assert "clock jumps in every line" in str(failure)
    assert session.clock.seconds() < 1


def test_a_clock_in_milliseconds_that_is_coarser_than_the_lines_counts_none(session: Session) -> None:
    quick = CELL.model_copy(
        update={"values": (LineValue(name="device_ms"), LineValue(name="Fz", unit="g")), "rate_hz": 800.0}
    )
    instrument, cable = cell(session, device=quick)
    send = sending(cable, lambda n: b"%d,%d\r\n" % (1.25 * n, n), period_s=0.00125)
    run, _ = session.record(instrument, for_s=3, also=send)
    assert run.header.devices["loadcell"].lost == 0


def test_a_silence_is_a_gap_with_the_lines_that_the_rate_implies(session: Session) -> None:
    instrument, cable = cell(session)

    run, failure = session.record(instrument, for_s=6, also=sending(cable, lambda n: b"" if 80 < n <= 240 else line(n)))
    (gap,) = facts(run)["gaps"]

    assert failure is None
    assert run.header.devices["loadcell"].lost == pytest.approx(160, abs=1)
    assert gap["reason"] == "no line came"
    assert gap["to_s"] - gap["from_s"] == pytest.approx(2, abs=0.05)


def standing(session: Session, send: Callable[[float], None]) -> Callable[[float], None]:
    """Return a function that sends lines, and once suspends the recorder for 2 s."""
    stood = False

    def stand(now_s: float) -> None:
        nonlocal stood
        if now_s > 1 and not stood:
            stood = True
            session.clock.rightNow += 2.0
        send(session.clock.seconds())

    return stand


@pytest.mark.parametrize("overflown", [0, 120])
def test_lines_that_the_computer_kept_while_the_recorder_stood_are_not_lost(session: Session, overflown: int) -> None:
    instrument, cable = cell(session)
    send = sending(cable, lambda n: b"" if 80 < n <= 80 + overflown else line(n))
    run, failure = session.record(instrument, for_s=6, also=standing(session, send))
    (gap,) = facts(run)["gaps"]

    assert failure is None
    assert gap["reason"].startswith("cfid itself was suspended")
    assert run.header.devices["loadcell"].lost == pytest.approx(overflown, abs=2)
    assert len(rows_of(run, "loadcell")) == pytest.approx(6 * 80 - overflown, abs=3)


@pytest.mark.parametrize(("damaged", "lost"), [((), 0), ((150, 151, 152), 3), (range(100, 140), 40)])
def test_lines_in_bursts_are_lost_only_where_the_devices_clock_skips_some(
    session: Session, damaged: Sequence[int], lost: int
) -> None:
    instrument, cable = cell(session)
    kept, next_s = b"", 0.31

    def step(now_s: float) -> None:
        nonlocal kept, next_s
        send(now_s)
        if now_s >= next_s:
            cable.send(kept)
            kept, next_s = b"", next_s + 0.31

    def keep(count: int) -> bytes:
        nonlocal kept
        kept += b"" if count in damaged else line(count)
        return b""

    send = sending(cable, keep)
    run, failure = session.record(instrument, for_s=5, also=step)
    rows = rows_of(run, "loadcell")

    assert failure is None
    assert facts(run)["gaps"]
    assert np.sum(np.diff(rows["device_us"]) / 12500 - 1) == lost
    assert run.header.devices["loadcell"].lost == lost


@pytest.mark.parametrize(("overflown", "shown"), [(0, 0), (120, 1)])
def test_lines_that_all_came_late_are_no_gap_in_the_summary(session: Session, overflown: int, shown: int) -> None:
    """The summary of a busy computer was "13000 rows, 0 lost (2 gaps)", and nothing explained the gaps."""
    instrument, cable = cell(session)
    send = sending(cable, lambda n: b"" if 80 < n <= 80 + overflown else line(n))
    run, _ = session.record(instrument, for_s=6, also=standing(session, send))
    (gap,) = facts_of(run, "loadcell", Facts).gaps

    assert gap.lost == pytest.approx(overflown, abs=2)
    assert devices_of(run)["loadcell"]["gaps"] == shown
    assert len(gaps(facts_of(run, "loadcell", Facts))) == shown


def test_lines_of_a_burst_count_as_lost_where_nothing_tells_when_each_was_sent(session: Session) -> None:
    clockless = CELL.model_copy(update={"values": CELL.values[1:]})
    instrument, cable = cell(session, device=clockless)
    sent, stood = 0, False

    def step(now_s: float) -> None:
        nonlocal sent, stood
        if now_s > 1 and not stood:
            stood = True
            session.clock.rightNow += 2.0
        due = int(session.clock.seconds() / 0.0125)
        if due > sent:
            cable.send(b"".join(b"%d\n" % count for count in range(sent, due)))
            sent = due

    run, failure = session.record(instrument, for_s=6, also=step)
    rows = rows_of(run, "loadcell")

    assert failure is None
    assert rows["t"].to_numpy() == pytest.approx(UNIX_S + 0.0125 * (1 + rows["Fz"].to_numpy() / (0.5 * G)), abs=0.006)
    assert known(run.header.devices["loadcell"].lost) + len(rows) == pytest.approx(6 * 80, abs=3)
    assert 160 <= known(run.header.devices["loadcell"].lost) <= 190


def test_a_silence_at_the_end_is_a_gap_with_its_losses(session: Session) -> None:
    instrument, cable = cell(session)
    run, failure = session.record(instrument, for_s=4, also=sending(cable, lambda n: b"" if n > 160 else line(n)))
    (gap,) = facts(run)["gaps"]

    assert failure is None
    assert gap["reason"] == "silent at the end"
    assert run.header.devices["loadcell"].lost == pytest.approx(160, abs=2)


def test_lines_that_come_in_chunks_are_kept_after_a_gap_too(session: Session) -> None:
    """An adapter passes lines on every 16 ms, from a device that sends 1000 per second and has no clock of its own."""
    quick = CELL.model_copy(update={"values": CELL.values[1:], "rate_hz": 1000.0})
    instrument, cable = cell(session, device=quick)
    chunks = sending(cable, lambda n: b"" if 60 < n <= 180 else b"1\n" * 16, period_s=0.016)
    run, _ = session.record(instrument, for_s=6, also=chunks)

    assert run.header.devices["loadcell"].lost == pytest.approx(120 * 16, abs=40)


def test_a_silence_for_good_fails_the_run_and_shows_nothing_unprintable(session: Session) -> None:
    instrument, cable = cell(session)

    _, failure = session.record(
        instrument, for_s=None, also=sending(cable, lambda n: line(n) if n < 80 else b"\x1b[31mE%d\r\n" % n)
    )

    assert isinstance(failure, DeviceError)
    assert "sent no line for 5" in str(failure)
    assert "'?[31mE" in str(failure)
    assert str(failure).isprintable()


def test_motors_stop_as_soon_as_lines_break_off(session: Session) -> None:
    instrument, cable = cell(session, patient=False)

    _, failure = session.record(instrument, for_s=None, also=sending(cable, lambda n: line(n) if n < 80 else b""))

    assert isinstance(failure, DeviceError)
    assert session.clock.seconds() < 1.6


def test_motors_stop_when_the_plug_is_pulled(session: Session) -> None:
    instrument, cable = cell(session, patient=False)
    send = sending(cable, line)

    def step(now_s: float) -> None:
        if now_s > 1 and cable.there:
            cable.pull()
        send(now_s)

    run, failure = session.record(instrument, for_s=None, also=step)

    assert isinstance(failure, DeviceError)
    assert "while motors run" in str(failure)
    assert session.clock.seconds() < 1.2
    assert len(rows_of(run, "loadcell")) == pytest.approx(79, abs=1)


def test_a_plug_that_comes_back_is_a_gap(session: Session) -> None:
    instrument, cable = cell(session)
    send = sending(cable, line)

    def step(now_s: float) -> None:
        if 1 < now_s < 3 and cable.there:
            cable.pull()
        cable.there = cable.there or now_s >= 3
        send(now_s)

    run, failure = session.record(instrument, for_s=6, also=step)

    assert failure is None
    assert facts(run)["gaps"][0]["reason"] == "unplugged"
    assert run.header.devices["loadcell"].lost == pytest.approx(160, abs=45)  # the port is looked for twice a second
    assert "unplugged" in session.said[0]
    assert "back" in session.said[1]


def test_fewer_lines_than_the_stated_rate_implies_are_losses(session: Session) -> None:
    instrument, cable = cell(session, device=CELL.model_copy(update={"values": CELL.values[1:]}))
    run, failure = session.record(instrument, for_s=4, also=sending(cable, lambda n: b"%d\n" % n, period_s=0.025))
    assert failure is None
    assert run.header.devices["loadcell"].lost == pytest.approx(160, abs=3)
    assert session.said == []


def test_more_lines_than_the_stated_rate_allows_leave_the_losses_unknown(session: Session) -> None:
    instrument, cable = cell(session, device=CELL.model_copy(update={"rate_hz": 76.0, "values": CELL.values[1:]}))
    run, failure = session.record(instrument, for_s=10, also=sending(cable, lambda n: b"%d\n" % n))
    assert failure is None
    assert run.header.devices["loadcell"].lost is None
    assert 'lost = "unknown"' in (run.folder / "run.toml").read_text()
    assert devices_of(run)["loadcell"]["lost"] is None
    (text,) = session.said
    assert re.match(r"the loadcell sent (79|80)\S* lines a second, more than the 76 that rig.toml states", text)


def test_lines_that_are_sent_twice_leave_the_losses_unknown(session: Session) -> None:
    instrument, cable = cell(session)
    run, _ = session.record(instrument, for_s=4, also=sending(cable, lambda n: 2 * line(n)))

    assert len(rows_of(run, "loadcell")) == pytest.approx(640, abs=4)
    assert run.header.devices["loadcell"].lost is None
    (text,) = session.said
    assert re.match(r"the loadcell sent (159|160|161)\S* lines a second, more than the 80", text)


def test_the_stated_rate_is_not_commented_where_lines_do_not_match_or_a_plug_was_pulled(session: Session) -> None:
    instrument, cable = cell(session)
    send = sending(cable, lambda n: line(n) if n % 3 else b"torn\r\n")

    def step(now_s: float) -> None:
        if 1 < now_s < 2 and cable.there:
            cable.pull()
        cable.there = cable.there or now_s >= 2
        send(now_s)

    session.record(instrument, for_s=5, also=step)

    assert not any("rig.toml states" in text for text in session.said)


@pytest.mark.parametrize(
    ("ticks", "went"),
    [
        (lambda n: 12500 * n, ""),
        (lambda n: 12750 * n, "went "),
        (lambda n: 7, "went 0 s"),
        (lambda n: 12500 * n if n < 200 else 12500 * (n - 200), "anew"),
    ],
)
def test_a_clock_that_goes_otherwise_is_named_at_the_end(
    session: Session, ticks: Callable[[int], int], went: str
) -> None:
    instrument, cable = cell(session)
    _, failure = session.record(instrument, for_s=4, also=sending(cable, lambda n: b"%d,%d\r\n" % (ticks(n), n)))
    assert failure is None
    assert [text for text in session.said if "'s clock, device_us," in text and went in text] == session.said
    assert bool(session.said) is bool(went)


def test_a_clock_that_starts_anew_in_a_gap_is_named_at_the_end(session: Session) -> None:
    instrument, cable = cell(session)
    ticks = [12500 * n if n < 200 else 12500 * (n - 300) for n in range(1000)]
    send = sending(cable, lambda n: b"" if 200 <= n < 300 else b"%d,%d\r\n" % (ticks[n], n))

    run, failure = session.record(instrument, for_s=8, also=send)

    assert failure is None
    assert run.header.devices["loadcell"].lost == pytest.approx(100, abs=3)
    (text,) = session.said
    assert text.startswith("the loadcell's clock, device_us, started anew: was the dev")


def test_a_device_none_of_whose_lines_match_fails_with_what_it_sent(session: Session) -> None:
    instrument, cable = cell(session)
    _, failure = session.record(instrument, for_s=8, also=sending(cable, lambda n: b"0,301,7,8\r\n"))
    assert failure is not None
    assert "0,301,7,8" in str(failure)


def test_a_plug_that_stays_away_fails_the_run(session: Session) -> None:
    instrument, cable = cell(session)
    send = sending(cable, line)

    def step(now_s: float) -> None:
        if now_s > 1 and cable.there:
            cable.pull()
        send(now_s)

    run, failure = session.record(instrument, for_s=4, also=step)

    assert isinstance(failure, DeviceError)
    assert "not plugged in again" in str(failure)
    assert facts(run)["gaps"][0]["reason"] == "unplugged"


# Over a pseudo terminal


class Board:
    """A microcontroller on a serial port; the test holds the device's end."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.end = self._host = -1
        self.plug()

    def plug(self) -> None:
        self.end, self._host = os.openpty()
        tty.setraw(self._host)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._host))

    def unplug(self) -> None:
        self.path.unlink(missing_ok=True)
        for end in (self.end, self._host):
            if end >= 0:
                os.close(end)
        self.end = self._host = -1

    def send(self, data: bytes) -> None:
        if self.end >= 0:
            os.write(self.end, data)


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Board]:
    board = Board(tmp_path / "board")
    yield board
    board.unplug()


def recorded(folder: Path, make: Callable[[ExitStack], Device], act: Callable[[Loop], Any]) -> Run:
    """Record while the coroutine `act` sends; the run ends with it."""

    async def procedure(_: Any, loop: Loop) -> None:
        await act(loop)

    plan = Plan(runs_folder=folder, kind="loadcell", label=Label(), procedure=procedure)
    with ExitStack() as held:
        return record_run(plan, [make(held)], show=lambda _: None, begun=lambda _: None)


def device(board: Board, held: ExitStack, said: list[str]) -> Device:
    setting = CELL.model_copy(update={"port": str(board.path)})
    return ready_loadcell(setting, held, buffered=True, bias=False, say=said.append)


def test_half_lines_junk_and_bursts_over_a_port_leave_only_whole_lines(tmp_path: Path, board: Board) -> None:
    async def act(loop: Loop) -> None:
        await sleep(loop, 0.2)
        board.send(b"999,9")  # the end of a line whose beginning is missing
        board.send(b"99\r\n")
        for count in range(40):
            whole = line(count)
            board.send(whole[:4])
            await sleep(loop, 0.005)
            board.send(whole[4:])
        board.send(b"\xff\xfe\x00\x1b[2J\r\n" + b"5" * 1500 + b"\r\n")
        board.send(b"".join(line(count) for count in range(40, 140)))  # at once
        await sleep(loop, 0.1)
        board.send(line(200)[:-3])  # never ends

    said: list[str] = []
    run = recorded(tmp_path, lambda held: device(board, held, said), act)
    rows = rows_of(run, "loadcell")

    assert rows["Fz"].to_numpy() == pytest.approx(0.5 * G * (100 + np.arange(140)))
    assert run.header.devices["loadcell"].lost == 2
    assert dict(facts(run)["lines"])["values"][1] == {"name": "Fz", "unit": "g", "scale": 0.5}
    assert facts(run)["units"] == "n,nm"
    cell = wrench_of(read_recording(run.folder))
    assert cell.axes == ("Fz",)
    assert cell.force_n[:, 2] == pytest.approx(rows["Fz"].to_numpy())
    assert np.isnan(cell.torque_nm).all()


def test_an_unplugged_board_is_found_again_at_another_terminal(tmp_path: Path, board: Board) -> None:
    async def act(loop: Loop) -> None:
        for count in range(160):
            board.send(line(count))
            await sleep(loop, 0.0125)
            if count == 40:
                board.unplug()
            if count == 60:
                board.plug()

    said: list[str] = []
    run = recorded(tmp_path, lambda held: device(board, held, said), act)

    assert facts(run)["gaps"][0]["reason"] == "unplugged"
    assert any("back after" in text for text in said)
    values = rows_of(run, "loadcell")["Fz"].to_numpy() / (0.5 * G) - 100
    assert set(np.rint(values)) < set(range(160))
    assert values[-1] == pytest.approx(159, abs=1)


def test_a_port_is_locked_while_it_is_recorded(board: Board) -> None:
    with ExitStack() as held:
        device(board, held, [])
        with pytest.raises(DeviceError, match="is held by"), DeviceLock.take(os.path.realpath(board.path)):
            pass


def test_a_port_that_is_not_there_makes_no_run(board: Board) -> None:
    board.unplug()
    with ExitStack() as held, pytest.raises(DeviceError, match="no such port"):
        device(board, held, [])


def test_a_bias_and_a_rate_are_the_boxs(board: Board) -> None:
    setting = CELL.model_copy(update={"port": str(board.path)})
    with ExitStack() as held, pytest.raises(ConfigError, match="bias"):
        ready_loadcell(setting, held, buffered=True, bias=True, say=print)
    with pytest.raises(ConfigError, match="rate"):
        setting.sampled_at(100)


def test_counts_need_the_counts_of_a_turn(board: Board) -> None:
    setting = EncoderLines(kind="lines", port=str(board.path), rate_hz=500, values=(LineValue(name="phi"),))
    with ExitStack() as held, pytest.raises(ConfigError, match="counts_per_turn"):
        ready_encoder(setting, held, counts_per_turn="rls-13bit-in-22", continuous=False, say=print)


# cfid rig check


def checked(
    board: Board, lines: Callable[[int], bytes], *, rate_hz: float = 80, device: LoadCellLines = CELL
) -> dict[str, tuple[str, str, str]]:
    """Return answers by question, while a separate thread sends for the board."""
    ended = threading.Event()

    def send() -> None:
        begun_s, count = time.monotonic(), 0
        while not ended.wait(0.002):
            while count * 0.0125 <= time.monotonic() - begun_s:
                board.send(lines(count))
                count += 1

    thread = threading.Thread(target=send)
    thread.start()
    try:
        answers = check_lines("loadcell", device.model_copy(update={"port": str(board.path), "rate_hz": rate_hz}))
    finally:
        ended.set()
        thread.join()
    return {answer.asked: (answer.state, answer.answer, answer.advice) for answer in answers}


def test_check_shows_rate_and_resolution(board: Board) -> None:
    found = checked(board, line)

    assert found["port"][0] == "ok"
    assert found["lines"][0] == "ok"
    assert float(found["lines"][1].split()[0]) == pytest.approx(80, rel=0.1)
    assert "steps of 0.0049," in found["Fz"][1]


def test_check_shows_a_clock_that_is_none(board: Board) -> None:
    state, answer, advice = checked(board, lambda n: b"0,%d\r\n" % (301 + n))["device_us"]  # 0,301 is one number there

    assert (state, answer.split(" in ")[0]) == ("warning", "went 0 s")
    assert "commas" in advice
    assert checked(board, line)["device_us"][0] == "ok"


def test_check_shows_a_rate_that_is_not_the_stated_one(board: Board) -> None:
    state, _, advice = checked(board, line, rate_hz=40)["lines"]

    assert state == "warning"
    assert "40 Hz" in advice


@pytest.mark.parametrize("clocked", [True, False])
def test_check_shows_lines_that_never_came_and_advises_no_lower_rate(board: Board, clocked: bool) -> None:
    device = CELL if clocked else CELL.model_copy(update={"values": CELL.values[1:]})
    lines = line if clocked else lambda n: b"%d\n" % n
    state, answer, advice = checked(board, lambda n: lines(n) if n % 3 else b"", device=device)["lines"]

    assert state == "warning"
    match = re.search(r"(\d+) of the (\d+) expected are missing", answer)
    assert match is not None
    assert int(match[1]) / int(match[2]) == pytest.approx(1 / 3, abs=0.05)
    assert "set " not in advice
    assert "lower" not in advice


def test_check_shows_lines_that_do_not_match_without_their_control_characters(board: Board) -> None:
    state, answer, advice = checked(board, lambda n: b"\x1b[2JFz=%d\r\n" % n)["lines"]

    assert state == "fault"
    assert "?[2JFz=" in answer
    assert answer.isprintable()
    assert "pattern" in advice


def test_check_of_a_silent_port_says_so(board: Board) -> None:
    state, answer, _ = checked(board, lambda n: b"")["lines"]

    assert state == "fault"
    assert "nothing came" in answer


def test_check_of_a_port_that_is_not_there_says_which_there_are(board: Board) -> None:
    board.unplug()
    state, answer, _ = checked(board, line)["port"]

    assert state == "fault"
    assert "no such port. Available:" in answer


# The simulated rig


RIG = """
[devices.encoder]
kind = "lines"
port = "/dev/null"
rate_hz = 200
values = [{ name = "phi", unit = "deg" }, { name = "device_us" }]

[devices.loadcell]
kind = "lines"
port = "/dev/null"
rate_hz = 80
pattern = 'Fz=(\\S+)'
values = [{ name = "Fz", unit = "mN" }]
"""


def test_a_simulated_rig_serves_both_and_commands_record_them(tmp_path: Path) -> None:
    with lab_in(tmp_path) as lab:
        content = re.sub(r"(?ms)^\[devices\.\w+\].*?(?=^\[)", "", new_rig_text())
        (tmp_path / RIG_FILE).write_text(content + RIG)
        with rig_sim(lab):
            checks = json.loads(lab.cfid("rig", "check", "--json").out)["devices"]
            angle = lab.cfid("log", "encoder", "--for", 2)
            force = lab.cfid("log", "loadcell", "--for", 3)

    assert [one["asked"] for one in checks["encoder"]] == ["port", "lines", "device_us", "phi"]
    assert [one["asked"] for one in checks["loadcell"]] == ["port", "lines", "Fz"]
    assert angle.code == force.code == 0, angle.err + force.err
    of_angle, of_force = sorted((tmp_path / "runs").iterdir(), key=lambda folder: "loadcell" in folder.name)
    assert len(angle_record(of_angle).time_s) > 200
    assert wrench_of(read_recording(of_force)).force_n[:, 2].mean() == pytest.approx(1.4, abs=0.1)


@pytest.mark.usefixtures("in_time")
def test_a_force_cell_that_sends_lines_gives_a_thrust_map(tmp_path: Path) -> None:
    staircase = ("--from", 20000, "--to", 60000, "--step", 10000, "--hold", 2.5, "--rest", 1.5, "--yes")
    with lab_in(tmp_path) as lab:
        content = re.sub(r"(?ms)^\[devices\.\w+\].*?(?=^\[)", "", new_rig_text())
        (tmp_path / RIG_FILE).write_text(content + RIG)
        with rig_sim(lab):
            logged = lab.cfid("log", "thrust", *staircase)
            fitted = lab.cfid("fit", "thrust", "*_thrust", "--json", "--no-figures")

    assert logged.code == fitted.code == 0, logged.err + fitted.err
    found = json.loads(fitted.out)["parameters"]
    largest = found["motor.max_thrust_n"]
    speed = 381 + 0.0408 * 65535  # of the simulated rotors
    assert abs(largest["value"] - 1.8e-8 * speed**2) < 3 * largest["std"] < 0.01
    assert "motor.torque_poly" not in found
