"""Runs of both devices that are killed or asked to end: what remains on the disk, and what the devices do."""

import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from cfid.records.run import read_run
from tests.rig.streaming_rig import CampaignRig, check_complete_run, check_cut_run, logger, served_rig
from tests.virtual_lab import lab_in

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and pseudo terminals of Unix")

MOST_MISSING_S = 0.1


def check_quiet(rig: CampaignRig) -> None:
    """Check that nothing is sent any more, and that the devices are free."""
    assert not rig.streaming
    assert rig.holders() == []


@pytest.mark.parametrize("device", ["encoder", "loadcell"])
def test_no_row_is_further_than_100_ms_from_the_disk_at_any_moment(tmp_path: Path, device: str) -> None:
    with lab_in(tmp_path) as lab:
        log = lab.start("log", device)
        log.wait_for_rows(1)
        for _ in range(50):
            log.go_on_for(0.0137)
            text = (lab.run().device_file(device)).read_text()
            assert text.endswith("\n")
            assert lab.hardware.unix_s() - float(text.splitlines()[-1].partition(",")[0]) < MOST_MISSING_S
        log.ask_to_end()


def check_killed_runs(folder: Path, count: int) -> None:
    """Kill runs at random times, also while they close, and check that each opens with right rows alone."""
    rng = np.random.default_rng(1)
    with served_rig(folder) as rig:
        for number in range(count):
            with logger(rig) as log:
                log.wait_for_rows()
                time.sleep(rng.uniform(0, 0.3))
                if number % 3 == 2:
                    log.process.send_signal(signal.SIGTERM)
                    time.sleep(0.02)  # the stream takes 60 ms to stop
                log.kill()
            check = check_cut_run if read_run(log.folder).cut else check_complete_run
            check(log.folder)


def test_killed_runs_open_and_have_no_wrong_row(tmp_path: Path) -> None:
    check_killed_runs(tmp_path, 3)


@pytest.mark.slow
def test_a_hundred_killed_runs_open_and_have_no_wrong_row(tmp_path: Path) -> None:
    check_killed_runs(tmp_path, 100)


def test_runs_that_are_told_to_end_are_complete_and_leave_the_devices_quiet(tmp_path: Path) -> None:
    with served_rig(tmp_path) as rig:
        with logger(rig) as log:  # whose box streams to nobody afterwards
            log.wait_for_rows()
            log.kill()
        for signals in ((signal.SIGINT, signal.SIGINT), (signal.SIGTERM,), (signal.SIGHUP,)):
            with logger(rig) as log:
                log.wait_for_rows()
                assert log.end(*signals) == ""
            check_complete_run(log.folder)
            check_quiet(rig)
