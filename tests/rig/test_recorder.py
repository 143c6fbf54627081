"""The recorder: the order of its instruments, their blocks, and the release of every device whatever ends the run."""

import resource
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cfid.errors import DeviceError, StopError
from cfid.records.run import DeviceRecord, Run
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Block, Instrument
from cfid.rig.progress import Progress
from tests.lab import known
from tests.virtual_lab import UNIX_S, Lab, recorded


class Counter(Instrument):
    """An instrument that counts at 1 kHz, notes the calls that it gets, and fails where the test demands it."""

    def __init__(self, desk: "Desk", name: str, fails: Mapping[str, Exception]) -> None:
        self.name = name
        self.record = DeviceRecord(file=f"{name}.csv", columns=("t", "count"))
        self.taken_s: list[float] = []
        self.open = False
        self._desk, self._fails = desk, fails
        self._counted = 0
        self._fails_from_s = desk.hardware.seconds() + 0.2

    def start(self, hardware: Hardware) -> None:
        self._note("start")
        self.open, self._begun_s = True, hardware.seconds()

    def take(self) -> Block:
        self._note("take")
        now_s = self._desk.hardware.seconds()
        self.taken_s.append(now_s - self._begun_s)
        counts = np.arange(self._counted, round((now_s - self._begun_s) * 1000))
        self._counted += len(counts)
        fault = self._fails.get("fault") if now_s > self._fails_from_s else None
        return Block((UNIX_S + self._begun_s + counts / 1000, counts), lost=1, fault=str(fault or ""))

    async def stop(self) -> None:
        self._note("stop")
        await self._desk.hardware.sleep(0.01)
        self._note("stopped")

    def close(self) -> None:
        self.open = False
        self._note("close")

    def facts(self) -> Mapping[str, Any]:
        if "facts" in self._fails:
            raise self._fails["facts"]
        return {"counted": self._counted}

    def _note(self, call: str) -> None:
        self._desk.calls.append(f"{self.name}.{call}")
        if call in self._fails and (call != "take" or self._desk.hardware.seconds() > self._fails_from_s):
            raise self._fails[call]


class Desk:
    """A virtual computer, and the calls that the instruments got."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.hardware = folder, Lab(folder).hardware
        self.calls: list[str] = []

    def counter(self, name: str, **fails: Exception) -> Counter:
        return Counter(self, name, fails)

    def record(
        self, *instruments: Counter, for_s: float | None = 1.0, at: Mapping[float, Callable[[], object]] | None = None
    ) -> tuple[Run, Any, float]:
        """Record until the end; return the run, the exception that was raised or None, and how long it took."""
        for seconds, act in (at or {}).items():
            self.hardware.at(seconds, act)
        begun_s = self.hardware.seconds()
        run, error, _ = recorded(self.hardware, self.folder, *instruments, for_s=for_s)
        return run, error, self.hardware.seconds() - begun_s

    def of(self, name: str) -> list[str]:
        """Return the calls that one instrument got, with consecutive calls of `take` as one."""
        calls = [call.split(".")[1] for call in self.calls if call.startswith(f"{name}.")]
        return [call for place, call in enumerate(calls) if calls[place - 1 : place] != [call]]


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(tmp_path)


def counts_of(run: Run, name: str) -> list[int]:
    return list(pd.read_csv(run.device_file(name))["count"])


WHOLE_LIFE = ["start", "take", "stop", "stopped", "take", "close"]


def test_ten_devices_at_once_keep_all_their_rows_losses_and_facts(desk: Desk) -> None:
    names = [f"device-{number}" for number in range(10)]
    run, error, _ = desk.record(*(desk.counter(name) for name in names), for_s=2.0)

    assert error is None
    for name in names:
        counts, device = counts_of(run, name), run.header.devices[name]
        assert counts == list(range(len(counts)))
        assert len(counts) == device.rows == (device.model_extra or {})["counted"] >= 2000
        assert known(device.lost) == 41  # one a block
        assert desk.of(name) == WHOLE_LIFE


def test_blocks_come_every_50_ms_and_one_that_took_long_shifts_no_later_one(desk: Desk) -> None:
    counter = desk.counter("a")
    _, error, took_s = desk.record(counter, for_s=2.0, at={0.26: lambda: desk.hardware.stand_still(0.12)})
    places = np.array(counter.taken_s[:-1]) / 0.05

    assert error is None
    assert took_s == pytest.approx(2.01, abs=0.002)
    assert np.abs(places - places.round())[[*range(6), *range(7, len(places))]].max() < 0.01
    assert np.diff(places.round()).max() <= 3
    assert len(places) == pytest.approx(38, abs=1)


FAULT = DeviceError("the first one")
BUG = KeyError("a slip of this program")


@pytest.mark.parametrize("error", [FAULT, BUG])
@pytest.mark.parametrize("fails_in", ["start", "take", "stop", "stopped", "close", "facts"])
@pytest.mark.parametrize("which", ["a", "b"])
def test_whatever_one_instrument_raises_all_that_started_are_stopped_and_closed(
    desk: Desk, which: str, fails_in: str, error: Exception
) -> None:
    counters = [desk.counter(name, **({fails_in: error} if name == which else {})) for name in ("a", "b")]
    run, raised, took_s = desk.record(*counters)

    assert raised is error
    assert run.header.state == "failed"
    for counter in counters:
        started = fails_in != "start" or (which == "b" and counter.name == "a")
        assert not counter.open
        assert desk.calls.count(f"{counter.name}.stop") == desk.calls.count(f"{counter.name}.close") == started
        has_facts = started and (fails_in != "facts" or counter.name != which)
        assert ("counted" in (run.header.devices[counter.name].model_extra or {})) == has_facts
        assert run.header.devices[counter.name].rows == (len(counts_of(run, counter.name)) if started else 0)
        assert started or run.header.devices[counter.name].lost == 0
    assert took_s < (0.3 if fails_in in ("start", "take") else 1.1)


def test_the_first_failure_is_raised_and_names_the_others_but_motors_that_may_run_come_first(desk: Desk) -> None:
    doubt = DeviceError("a does not stop")
    run, raised, _ = desk.record(desk.counter("a", stop=doubt), desk.counter("b", take=FAULT, stopped=BUG))
    _, of_motors, _ = desk.record(desk.counter("a", take=FAULT), desk.counter("b", stop=StopError("motors")))

    assert type(raised) is DeviceError
    assert str(raised).splitlines() == ["the first one", "a does not stop"]
    assert run.header.reason == str(raised)
    assert type(of_motors) is StopError
    assert str(of_motors).splitlines() == ["motors", "the first one"]


def test_a_fault_in_a_block_ends_the_run_after_its_rows(desk: Desk) -> None:
    run, raised, _ = desk.record(desk.counter("a", fault=DeviceError("overload")), desk.counter("b"))

    assert str(raised) == "overload"
    assert min(len(counts_of(run, name)) for name in ("a", "b")) > 200


@pytest.mark.parametrize("fails_in", ["take", "fault"])
def test_a_procedure_is_not_begun_where_the_first_block_fails(desk: Desk, fails_in: str) -> None:
    """So no motor turns beside a load cell that is broken from the beginning."""
    begun: list[str] = []

    async def procedure(*_: object) -> None:
        begun.append("it")

    counter = desk.counter("a", **{fails_in: FAULT})
    counter._fails_from_s = 0.0
    _, error, _ = recorded(desk.hardware, desk.folder, counter, procedure=procedure)

    assert str(error) == str(FAULT)
    assert begun == []
    assert desk.of("a") == WHOLE_LIFE


@pytest.mark.parametrize(("at_s", "rows"), [(0.0, 10), (0.333, 343)])
def test_an_end_asked_for_comes_at_once_whatever_time_was_set(desk: Desk, at_s: float, rows: int) -> None:
    def end() -> None:
        desk.hardware.request_end("SIGTERM")
        desk.hardware.request_end("SIGINT")

    run, error, _ = desk.record(desk.counter("a"), desk.counter("b"), for_s=30.0, at={at_s: end})

    assert error is None
    assert run.header.state == "complete"
    assert "SIGTERM" in run.header.reason
    assert len(counts_of(run, "a")) == pytest.approx(rows, abs=4)
    assert desk.of("a") == desk.of("b") == WHOLE_LIFE


def test_a_computer_that_was_suspended_ends_the_run_with_its_rows_kept(desk: Desk) -> None:
    run, error, took_s = desk.record(desk.counter("a"), at={0.5: lambda: setattr(desk.hardware, "slept_s", 2.0)})

    assert isinstance(error, DeviceError)
    assert took_s < 0.6
    assert len(counts_of(run, "a")) == pytest.approx(510, abs=60)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
@pytest.mark.parametrize("device", ["encoder", "loadcell"])
def test_a_full_disk_fails_the_run_stops_the_device_and_keeps_whole_rows(tmp_path: Path, device: str) -> None:
    lab, limits = Lab(tmp_path), resource.getrlimit(resource.RLIMIT_FSIZE)
    log = lab.start("log", device)
    log.wait_for_rows(20)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        code = log.end().code
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    run = lab.run()

    assert (code, lab.box.streaming, lab.hardware.ports[lab.port].receiver) == (4, False, None)
    assert lab.hardware.seconds() < 10
    assert run.header.state == "failed"
    assert "File too large" in run.header.reason
    assert len(pd.read_csv(run.device_file(device))) == known(run.header.devices[device].rows) > 100
    assert "gaps" not in (run.header.devices[device].model_extra or {})


# Progress


def test_progress_tells_the_rate_of_lately_and_the_latest_values_in_bounded_memory() -> None:
    progress = Progress()
    assert progress.rate_hz == 0
    for number in range(3000):
        rows = 10 if number < 50 else 50
        progress.add(Block((np.arange(rows), np.full(rows, number)), lost=2), now_s=0.05 * number)

    assert progress.rate_hz == pytest.approx(1000)
    assert (progress.rows, progress.lost) == (50 * 10 + 2950 * 50, 6000)
    assert progress.latest == (2999.0,)
    assert max(len(progress.trace), len(progress._blocks)) < 100
