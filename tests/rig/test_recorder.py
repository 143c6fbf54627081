"""The recorder with instruments of the test: their order, their times, and the release of every device.

The last test has an encoder whose replies are held up by a stall.
"""

import subprocess
import sys
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from twisted.internet.defer import Deferred
from twisted.internet.task import Clock
from twisted.python.failure import Failure

from cfid.errors import DataError, DeviceError
from cfid.records.run import DeviceRecord, Label, Run, read_run
from cfid.records.run_writer import RunWriter, create_run
from cfid.rig.loop import Ending
from cfid.rig.progress import Progress
from cfid.rig.recorder import Block, Recorder, no_rows, sleep
from cfid.sim.faults import EncoderFaults
from cfid.wire.rls import STEPS_PER_TURN, decode_words
from tests.known import known
from tests.places import ROOT
from tests.rig.virtual import UNIX_S, Session, encoder, rows_of

STEP_S = 0.001


class Counter:
    """An instrument that counts at 1 kHz, notes the calls that it gets, and fails where the test demands it."""

    columns: tuple[str, ...] = ("t", "count")

    def __init__(self, name: str, clock: Clock, asked: list[str], fails: Mapping[str, Exception] | None = None) -> None:
        self.name = name
        self.taken_s: list[float] = []
        self.open = False
        self._clock, self._asked, self._fails = clock, asked, dict(fails or {})
        self._counted = self._began_s = 0.0

    def start(self) -> None:
        self._note("start")
        self.open = True
        self._began_s = self._clock.seconds()

    def take(self) -> Block:
        self._note("take")
        now_s = self._clock.seconds()
        self.taken_s.append(now_s)
        counts = np.arange(self._counted, round((now_s - self._began_s) * 1000))
        self._counted += len(counts)
        fault = self._fails.get("fault") if now_s > 0.2 else None
        return Block((UNIX_S + self._began_s + counts / 1000, counts), lost=1, fault=str(fault or ""))

    async def stop(self) -> None:
        self._note("stop")
        await sleep(self._clock, 0.01)
        self._note("stopped")

    def close(self) -> None:
        self._asked.append(f"{self.name}.close")
        self.open = False
        self._fail("close")

    def facts(self) -> Mapping[str, Any]:
        self._fail("facts")
        return {"counted": self._counted}

    def _note(self, what: str) -> None:
        self._asked.append(f"{self.name}.{what}")
        self._fail(what)

    def _fail(self, what: str) -> None:
        if what in self._fails and (what != "take" or self._clock.seconds() > 0.2):
            raise self._fails[what]


class Desk:
    """A clock, the calls that the instruments got, and the folder of the runs."""

    def __init__(self, folder: Path) -> None:
        self.clock = Clock()
        self.ending = Ending(self.clock)
        self.asked: list[str] = []
        self.shown = 0
        self._folder = folder

    def counter(self, name: str, **fails: Exception) -> Counter:
        return Counter(name, self.clock, self.asked, fails)

    def record(
        self,
        *instruments: Counter,
        for_s: float | None = 1.0,
        also: Callable[[float], None] = lambda now_s: None,
        show: Callable[[], None] = lambda: None,
    ) -> tuple[Run, BaseException | None, Recorder]:
        """Record until the end; return the run, the exception that was raised or None, and the recorder."""
        run = new_run(self._folder, *(instrument.name for instrument in instruments))
        recorder = Recorder(instruments, run, loop=self.clock, show=show)
        done: list[object] = []
        Deferred.fromCoroutine(recorder.record(lambda: self.ending.within(for_s))).addBoth(done.append)
        while not done:
            assert self.clock.seconds() < 60, "the recording does not end"
            self.clock.advance(STEP_S)
            also(self.clock.seconds())
        failure = done[0].value if isinstance(done[0], Failure) else None
        run.close("failed" if failure else "complete", reason=str(failure or ""))
        return read_run(run.folder), failure, recorder

    def of(self, name: str) -> list[str]:
        """Return the calls that one instrument got, with consecutive calls of `take` as one."""
        asked = [what.split(".")[1] for what in self.asked if what.startswith(f"{name}.")]
        return [what for at, what in enumerate(asked) if asked[at - 1 : at] != [what]]


def new_run(folder: Path, *names: str) -> RunWriter:
    devices = {name: DeviceRecord(file=f"{name}.csv", columns=("t", "count")) for name in names}
    started = datetime.fromtimestamp(UNIX_S, UTC)
    return create_run(folder, kind="test", label=Label(), devices=devices, started=started, cfid_version="0")


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(tmp_path)


WHOLE_LIFE = ["start", "take", "stop", "stopped", "take", "close"]


def test_all_are_started_before_any_is_taken_and_each_is_taken_from_after_it_stopped(desk: Desk) -> None:
    desk.record(desk.counter("a"), desk.counter("b"))

    assert desk.asked[:4] == ["a.start", "b.start", "a.take", "b.take"]
    assert desk.asked[-8:] == [
        *("a.stop", "a.stopped", "a.take", "a.close"),
        *("b.stop", "b.stopped", "b.take", "b.close"),
    ]
    assert desk.of("a") == desk.of("b") == WHOLE_LIFE


def test_ten_devices_at_once_keep_all_their_rows(desk: Desk) -> None:
    names = [f"device-{number}" for number in range(10)]

    run, failure, _ = desk.record(*(desk.counter(name) for name in names), for_s=2.0)

    assert failure is None
    for name in names:
        counts = pd.read_csv(run.device_file(name))["count"]
        assert counts.tolist() == list(range(len(counts)))
        assert len(counts) >= 2000
        assert desk.of(name) == WHOLE_LIFE


def test_blocks_come_every_50_ms_and_the_end_on_time(desk: Desk) -> None:
    counter = desk.counter("a")

    run, failure, recorder = desk.record(counter, for_s=2.0)

    assert failure is None
    assert counter.taken_s[:40] == pytest.approx(np.arange(40) * 0.05, abs=STEP_S)
    assert desk.clock.seconds() == pytest.approx(2.01, abs=2 * STEP_S)
    assert recorder.seconds == pytest.approx(2.01, abs=2 * STEP_S)
    rows = rows_of(run, "a")
    assert rows["count"].tolist() == list(range(len(rows)))
    assert len(rows) == pytest.approx(2010, abs=2)


def test_a_block_that_took_long_shifts_no_later_one(desk: Desk) -> None:
    counter = desk.counter("a")

    def show() -> None:
        if len(counter.taken_s) == 5:
            desk.clock.rightNow += 0.12

    desk.record(counter, show=show)
    places = np.array(counter.taken_s[:-1]) / 0.05

    assert np.abs(places - places.round()).max() < 2 * STEP_S / 0.05
    assert np.diff(places.round()).max() == 3


def test_losses_and_facts_of_all_are_in_the_run(desk: Desk) -> None:
    run, _, recorder = desk.record(desk.counter("a"), desk.counter("b"))

    for name in ("a", "b"):
        device = run.header.devices[name]
        assert device.rows == len(rows_of(run, name)) == (device.model_extra or {})["counted"]
        assert known(device.lost) == known(recorder.progress[name].lost) > 10


FAULT = DeviceError("the first one")
BUG = KeyError("a slip of this program")


@pytest.mark.parametrize("error", [FAULT, BUG])
@pytest.mark.parametrize("fails_in", ["start", "take", "stop", "close", "facts"])
@pytest.mark.parametrize("which", ["a", "b"])
def test_whatever_one_instrument_raises_all_are_stopped_and_closed(
    desk: Desk, which: str, fails_in: str, error: Exception
) -> None:
    counters = [desk.counter(name, **({fails_in: error} if name == which else {})) for name in ("a", "b")]

    run, failure, _ = desk.record(*counters)

    assert failure is error
    assert run.header.state == "failed"
    for counter in counters:
        assert not counter.open
        assert desk.asked.count(f"{counter.name}.stop") == desk.asked.count(f"{counter.name}.close") == 1
        if fails_in != "facts" or counter.name != which:
            assert "counted" in (run.header.devices[counter.name].model_extra or {})
    assert desk.clock.seconds() < (0.3 if fails_in in ("start", "take") else 1.1)


def test_the_first_failure_is_raised_and_says_which_devices_did_not_stop(desk: Desk) -> None:
    counters = [
        desk.counter("a", stop=DeviceError("a does not stop"), stopped=BUG),
        desk.counter("b", take=FAULT, stopped=DeviceError("b does not stop")),
    ]

    run, failure, _ = desk.record(*counters)

    assert isinstance(failure, type(FAULT))
    assert str(failure).splitlines() == ["the first one", "a does not stop", "b does not stop"]
    assert run.header.reason == str(failure)


def test_rows_that_came_before_a_failed_stop_are_kept(desk: Desk) -> None:
    run, failure, _ = desk.record(desk.counter("a", stopped=FAULT))

    assert failure is FAULT
    assert len(rows_of(run, "a")) == pytest.approx(1010, abs=2)


def test_a_fault_in_a_block_ends_the_run_after_its_rows(desk: Desk) -> None:
    run, failure, _ = desk.record(desk.counter("a", fault=DeviceError("overload")), desk.counter("b"))

    assert isinstance(failure, DeviceError)
    assert str(failure) == "overload"
    assert len(rows_of(run, "a")) > 200
    assert len(rows_of(run, "b")) > 200


def test_what_shows_the_recording_may_fail_and_all_are_closed(desk: Desk) -> None:
    def show() -> None:
        raise BUG

    _, failure, _ = desk.record(desk.counter("a"), show=show)

    assert failure is BUG
    assert desk.of("a") == WHOLE_LIFE


def test_an_end_asked_for_before_the_first_block_starts_and_stops_all(desk: Desk) -> None:
    desk.ending.request("SIGINT")

    run, failure, _ = desk.record(desk.counter("a"), desk.counter("b"), for_s=None)

    assert failure is None
    assert desk.of("a") == desk.of("b") == WHOLE_LIFE
    assert len(rows_of(run, "a")) < 50


def test_an_end_asked_for_comes_at_once_whatever_time_was_set(desk: Desk) -> None:
    def end(now_s: float) -> None:
        if now_s > 0.333:
            desk.ending.request("SIGTERM")
            desk.ending.request("SIGINT")

    run, failure, _ = desk.record(desk.counter("a"), for_s=30.0, also=end)

    assert failure is None
    assert desk.ending.signal == "SIGTERM"
    assert len(rows_of(run, "a")) == pytest.approx(333 + 10, abs=4)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
def test_a_full_disk_stops_and_closes_all(tmp_path: Path) -> None:
    body = """
import resource, sys
from pathlib import Path
from tests.rig.test_recorder import Desk
desk = Desk(Path(sys.argv[1]))
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
run, failure, _ = desk.record(desk.counter("a"), desk.counter("b"), for_s=None)
print(type(failure).__name__, run.header.state, *desk.of("a"), *desk.of("b"), desk.clock.seconds() < 2)
print(failure)
print(run.folder)
"""
    command = [sys.executable, "-c", body, str(tmp_path)]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=60)
    assert told.returncode == 0, told.stderr
    words, reason, folder = told.stdout.splitlines()

    assert words.split() == [DataError.__name__, "failed", *WHOLE_LIFE, *WHOLE_LIFE, "True"]
    run = read_run(Path(folder))
    assert run.header.reason == reason
    assert "File too large" in reason
    assert [len(rows_of(run, name)) for name in ("a", "b")] == [run.header.devices[name].rows for name in ("a", "b")]


# Progress


def test_progress_tells_the_rate_of_lately_and_the_latest_values() -> None:
    progress = Progress()
    assert progress.rate_hz == 0
    for number in range(100):
        rows = 10 if number < 50 else 50
        progress.add(Block((np.arange(rows), np.full(rows, number)), lost=2), now_s=0.05 * number)

    assert progress.rate_hz == pytest.approx(1000)
    assert progress.rows == 50 * 10 + 50 * 50
    assert progress.lost == 200
    assert progress.latest == (99.0,)


def test_progress_of_a_silent_instrument_falls_to_zero_and_keeps_the_last_values() -> None:
    progress = Progress()
    progress.add(Block((np.arange(3), np.arange(3))), now_s=0)
    for number in range(1, 30):
        progress.add(Block(no_rows(2)), now_s=0.05 * number)

    assert progress.rate_hz == 0
    assert progress.latest == (2.0,)


def test_progress_of_days_takes_no_more_memory_than_that_of_a_minute() -> None:
    progress = Progress()
    sizes = []
    for number in range(3000):
        progress.add(Block((np.arange(7), np.arange(7))), now_s=0.05 * number)
        sizes.append((len(progress.trace), len(progress._blocks)))

    assert sizes[100] == sizes[-1]


# An encoder's interface that stalls


def test_replies_that_a_stall_held_up_are_not_taken_for_those_of_later_polls(session: Session) -> None:
    """The reply to an abandoned poll comes after 75 ms, and the replies to later polls follow at intervals of 15 ms."""
    free_s = 0.0

    def held_s(now_s: float) -> float:
        nonlocal free_s
        if not 2 <= now_s < 2.09:
            return 0.0
        free_s = max(free_s + 0.015, now_s + 0.075 if now_s < 2.02 else now_s)
        return free_s - now_s

    instrument, _ = encoder(session, EncoderFaults(), held_s=held_s)
    run, failure = session.record(instrument, for_s=4)

    assert failure is None
    rows: pd.DataFrame = rows_of(run, "encoder")
    angle = np.unwrap(decode_words(rows["phi"].to_numpy()).position * (2 * np.pi / STEPS_PER_TURN))
    behind_s = (rows["t"].to_numpy() - UNIX_S) - angle / 0.5
    assert np.all(np.diff(rows["device_us"]) > 0)
    assert behind_s[rows["t"] > UNIX_S + 2.2].max() < behind_s[rows["t"] < UNIX_S + 2].max() + 1e-3
    assert behind_s.max() < 0.03
