"""Runs of both devices at once that are killed or told to end: what is on the disk then, and what the devices do."""

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
once = pytest.mark.flaky(reruns=0)  # a witness takes the place of a second try

MOST_MISSING_S = 0.1
STEP_S = 0.005
ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

Array = npt.NDArray[np.float64]


class Missing(NamedTuple):
    """How long before a kill the last row of a device was taken, and for how much of that nothing was held up."""

    seconds: float
    free_s: float


@dataclass(frozen=True)
class Witness:
    """When a rig and its recorder were looked at before a kill (n,), and whether either had been held up since (n,)."""

    times_s: Array
    held_up: npt.NDArray[np.bool_]

    def free_s(self, since_s: float, until_s: float) -> float:
        """Return for how long both could run; where the witness itself was held up, two steps of that count at most."""
        later = self.times_s > since_s
        times_s = np.concatenate([[since_s], self.times_s[later], [until_s]])
        held_up = np.append(self.held_up[later], False)
        return float(np.clip(np.diff(times_s), 0, 2 * STEP_S)[~held_up].sum())


class Thread:
    """A thread as its kernel sees it."""

    def __init__(self, number: int) -> None:
        self._folder = Path(f"/proc/{number}")
        self._ran = ""

    def held_up(self) -> bool:
        """Return whether it has not run since the last call, though it was to.

        It waits for a processor, or in the kernel for the one that a terminal's bytes wait for. A thread that sleeps or
        writes to a disk meanwhile is not held up.
        """
        before, self._ran = self._ran, re.sub(r" \d+ ", " ", (self._folder / "schedstat").read_text())
        waits = (self._folder / "stat").read_text().rpartition(") ")[2].startswith("R")
        return self._ran == before and (waits or (self._folder / "wchan").read_text() == "__flush_work")


def killed_under_observation(log: Logger, rig: ServedRig) -> Witness:
    """Look at a recorder and its rig for a while and kill the recorder."""
    threads = [Thread(log.process.pid), Thread(rig.thread)]
    times_s, held_up = [time.time()], [[False, False]]
    while times_s[-1] < times_s[0] + 4 * MOST_MISSING_S:
        time.sleep(STEP_S)
        times_s.append(time.time())
        held_up.append([thread.held_up() for thread in threads])
    log.kill()
    return Witness(np.array(times_s), np.any(held_up, axis=1))


def killed_run(rig: ServedRig, after_s: float) -> dict[str, Missing]:
    """Kill a run; return what of each device is missing at its end."""
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
    """Nothing is sent any more, and the devices are free."""
    assert not rig.streaming
    assert rig.holders() == []


def check_killed_runs(folder: Path, count: int, *, seed: int, longest_s: float) -> None:
    """Kill so many runs at random times: none misses more than 100 ms at its end, of either device.

    On a computer with more to do than it has cores the rig sends late and its recorder writes late: time in which
    either was held up does not count.
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
        check = check_cut_run if read_run(log.folder).cut else check_complete_run  # on a computer that was busy
        check(log.folder)
        with logger(rig, "0.3") as after:  # finds the devices free, and the box still streaming to nobody
            assert log.end() is not None
            assert after.end() == ""
        check_complete_run(after.folder)
        check_quiet(rig)
