"""Runs of both devices at once that are killed or told to end: what is on the disk then, and what the devices do."""

import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from cfid.records.run import read_run
from tests.rig.streaming_rig import (
    DEVICES,
    ServedRig,
    check_complete_run,
    check_cut_run,
    logger,
    served_rig,
)

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and pseudo terminals of Unix")

MOST_MISSING_S = 0.1
STEP_S = 0.005
ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Witness(threading.Thread):
    """Wakes up every few milliseconds beside the simulated rig, and sees for how long it was given no time."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.held_up_s = 0.0
        self.done = threading.Event()

    def run(self) -> None:
        while not self.done.is_set():
            begin_s = time.monotonic()
            time.sleep(STEP_S)
            self.held_up_s = max(self.held_up_s, time.monotonic() - begin_s - STEP_S)


def killed_run(rig: ServedRig, after_s: float) -> dict[str, float]:
    """Kill a run; return how long before that the last row of each device was taken, and what held up the rig."""
    witness = Witness()
    with logger(rig) as log:
        log.wait_for_rows()
        time.sleep(after_s)
        witness.start()
        time.sleep(3 * MOST_MISSING_S)
        log.kill()
    witness.done.set()
    rows = check_cut_run(log.folder)
    return {"held up": witness.held_up_s} | {name: log.killed_s - rows[name]["t"].iloc[-1] for name in DEVICES}


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

    On a computer with more to do than it has cores the rig itself sends late, by what its witness saw.
    """
    rng = np.random.default_rng(seed)
    with served_rig(folder, seed=seed) as rig:
        missing = [killed_run(rig, rng.uniform(0, longest_s)) for _ in range(count)]
    for name in missing[0]:
        each_ms = 1e3 * np.array([each[name] for each in missing])
        print(f"{name}: {count} kills, median {np.median(each_ms):.0f} ms, largest {each_ms.max():.0f} ms")
    for each in missing:
        assert max(each[name] for name in DEVICES) < MOST_MISSING_S + each["held up"], missing


def test_killed_runs_open_and_miss_the_last_100_ms_at_most(tmp_path: Path) -> None:
    check_killed_runs(tmp_path, 6, seed=1, longest_s=0.6)


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
