"""Runs of both devices that are killed or asked to end: what remains on the disk, and what the devices do."""

import re
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from cfid.records.run import read_run
from tests.rig.streaming_rig import (
    DEVICES,
    Logger,
    ServedRig,
    check_complete_run,
    check_cut_run,
    logger,
    served_rig,
)

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and pseudo terminals of Unix")
once = pytest.mark.flaky(reruns=0)  # a witness replaces the second try

MOST_MISSING_S = 0.1
STEP_S = 0.005
ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

Array = npt.NDArray[np.float64]


class Missing(NamedTuple):
    """How long before a kill the last row of a device was taken, and for how much of that time nothing was held up."""

    seconds: float
    free_s: float


@dataclass(frozen=True)
class Witness:
    """Times of looks at a rig and its recorder before a kill (n,), and whether either was held up since (n,)."""

    times_s: Array
    held_up: npt.NDArray[np.bool_]

    def free_s(self, since_s: float, until_s: float) -> float:
        """Return for how long both could run; time between looks counts as two steps at most, even if it was longer."""
        later = self.times_s > since_s
        times_s = np.concatenate([[since_s], self.times_s[later], [until_s]])
        held_up = np.append(self.held_up[later], False)
        return float(np.clip(np.diff(times_s), 0, 2 * STEP_S)[~held_up].sum())


class Thread:
    """A thread as the kernel reports it."""

    def __init__(self, number: int) -> None:
        self._folder = Path(f"/proc/{number}")
        self._ran = ""

    def held_up(self) -> bool:
        """Return whether the thread was ready to run since the last call but did not run.

        It waits for a processor, or in the kernel for the processor that handles the bytes of a terminal. A thread that
        sleeps or writes to a disk meanwhile is not held up.
        """
        before, self._ran = self._ran, re.sub(r" \d+ ", " ", (self._folder / "schedstat").read_text())
        waits = (self._folder / "stat").read_text().rpartition(") ")[2].startswith("R")
        return self._ran == before and (waits or (self._folder / "wchan").read_text() == "__flush_work")


def killed_under_observation(log: Logger, rig: ServedRig) -> Witness:
    """Observe a recorder and its rig for a while, then kill the recorder."""
    threads = [Thread(log.process.pid), Thread(rig.thread)]
    times_s, held_up = [time.time()], [[False, False]]
    while times_s[-1] < times_s[0] + 4 * MOST_MISSING_S:
        time.sleep(STEP_S)
        times_s.append(time.time())
        held_up.append([thread.held_up() for thread in threads])
    log.kill()
    return Witness(np.array(times_s), np.any(held_up, axis=1))


def killed_run(rig: ServedRig, after_s: float) -> dict[str, Missing]:
    """Kill a run; return what is missing at its end, for each device."""
    with logger(rig) as log:
        log.wait_for_rows()
        time.sleep(after_s)
        witness = killed_under_observation(log, rig)
    rows = check_cut_run(log.folder)
    last_s = {name: float(rows[name]["t"].iloc[-1]) for name in DEVICES}
    return {name: Missing(log.killed_s - last_s[name], witness.free_s(last_s[name], log.killed_s)) for name in DEVICES}


def ended_run(rig: ServedRig, ending: signal.Signals, after_s: float) -> None:
    with logger(rig) as log:
        log.wait_for_rows()
        time.sleep(after_s)
        assert log.end(ending) == ""
    check_complete_run(log.folder)
    check_quiet(rig)


def check_quiet(rig: ServedRig) -> None:
    """Check that nothing is sent any more, and that the devices are free."""
    assert not rig.streaming
    assert rig.holders() == []


def check_killed_runs(folder: Path, count: int, *, seed: int, longest_s: float) -> None:
    """Kill `count` runs at random times, and check that no device misses more than 100 ms at the end of any.

    On a computer with more tasks than cores, the rig sends late and its recorder writes late: time in which either was
    held up does not count.
    """
    rng = np.random.default_rng(seed)
    with served_rig(folder, seed=seed) as rig:
        missing = [killed_run(rig, rng.uniform(0, longest_s)) for _ in range(count)]
    for name in DEVICES:
        each_ms = 1e3 * np.array([each[name] for each in missing])
        print(
            f"{name}: {count} kills, median {np.median(each_ms[:, 0]):.0f} ms, largest {each_ms[:, 0].max():.0f} ms, "
            f"without hold-ups {each_ms[:, 1].max():.0f} ms"
        )
    for each in missing:
        assert max(device.free_s for device in each.values()) < MOST_MISSING_S, missing


@once
def test_killed_runs_open_and_miss_the_last_100_ms_at_most(tmp_path: Path) -> None:
    check_killed_runs(tmp_path, 6, seed=1, longest_s=0.6)


@once
@pytest.mark.slow
@pytest.mark.parametrize("seed", range(11, 15))
def test_two_hundred_killed_runs_open_and_miss_the_last_100_ms_at_most(tmp_path: Path, seed: int) -> None:
    check_killed_runs(tmp_path, 50, seed=seed, longest_s=1.5)


def test_runs_that_are_told_to_end_are_complete_and_leave_the_devices_quiet(tmp_path: Path) -> None:
    with served_rig(tmp_path) as rig:
        for ending in ENDINGS:
            ended_run(rig, ending, 0.2)


@pytest.mark.slow
def test_fifty_runs_that_are_told_to_end_are_complete_and_leave_the_devices_quiet(tmp_path: Path) -> None:
    rng = np.random.default_rng(21)
    with served_rig(tmp_path) as rig:
        for number in range(50):
            ended_run(rig, ENDINGS[number % len(ENDINGS)], rng.uniform(0, 1.5))


@pytest.mark.parametrize("pause_s", [0.0, 0.03])
def test_a_second_signal_does_not_break_the_closing(tmp_path: Path, pause_s: float) -> None:
    with served_rig(tmp_path) as rig:
        with logger(rig) as log:
            log.wait_for_rows()
            log.end(signal.SIGINT, signal.SIGINT, pause_s=pause_s)
        check_complete_run(log.folder)
        check_quiet(rig)


def test_a_process_killed_while_it_closes_leaves_a_run_that_opens(tmp_path: Path) -> None:
    with served_rig(tmp_path) as rig:
        with logger(rig) as log:
            log.wait_for_rows()
            log.process.send_signal(signal.SIGTERM)
            time.sleep(0.02)  # the stream takes 60 ms to stop
            log.kill()
        check = check_cut_run if read_run(log.folder).cut else check_complete_run  # complete if the computer was busy
        check(log.folder)
        with logger(rig, "0.3") as after:  # the devices are free, and the box still streams to nobody
            assert log.end() is not None
            assert after.end() == ""
        check_complete_run(after.folder)
        check_quiet(rig)
