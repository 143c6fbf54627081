"""Runs that are killed: what is on the disk at any moment opens as a run that was cut, with right rows alone."""

import shutil
import signal
import sys
from pathlib import Path

import pandas as pd
import pytest

from cfid.recordings.angle import angle_record
from cfid.recordings.read import read_recording
from cfid.recordings.wrench import wrench_of
from cfid.records.run import read_run
from tests.rig_in_a_folder import lab_in as served_lab_in
from tests.virtual_lab import lab_in

MOST_MISSING_S = 0.1


@pytest.mark.parametrize("device", ["encoder", "loadcell"])
def test_whenever_a_run_is_killed_it_opens_with_all_rows_but_those_of_the_last_100_ms(
    tmp_path: Path, device: str
) -> None:
    """What a killed program has written is on the disk, so that a copy of the run is what a kill leaves."""
    with lab_in(tmp_path) as lab:
        log = lab.start("log", device)
        log.wait_for_rows(20)
        for number in range(12):
            log.go_on_for(0.0137)
            folder = shutil.copytree(lab.run().folder, tmp_path / "killed" / f"{lab.run().folder.name}{number}")
            run = read_run(folder)
            text = run.device_file(device).read_text()
            assert run.cut
            assert text.endswith("\n")
            assert lab.hardware.unix_s() - float(text.splitlines()[-1].partition(",")[0]) < MOST_MISSING_S
            rows = pd.read_csv(run.device_file(device), dtype=float)
            record = angle_record(folder) if device == "encoder" else wrench_of(read_recording(folder))
            assert not rows.isna().any(axis=None)
            assert len(record.time_s) == len(rows)
            assert any("the run was cut" in note for note in record.notes)
            if device == "loadcell":
                assert set(rows["rdt_sequence"].diff()[1:]) == {1}
        log.ask_to_end()


@pytest.mark.skipif(sys.platform == "win32", reason="signals and pseudo terminals of Unix")
@pytest.mark.usefixtures("in_time")
def test_after_a_log_that_was_killed_the_next_one_is_complete_and_leaves_the_devices_quiet(tmp_path: Path) -> None:
    with served_lab_in(tmp_path) as lab:
        killed = lab.start("log", "loadcell")
        killed.wait_for_rows(100)
        killed.process.kill()
        killed.process.wait()
        cut = lab.run()
        for number in (signal.SIGTERM, signal.SIGHUP):
            log = lab.start("log", "loadcell")
            log.wait_until(lambda: lab.run_folder() != cut.folder, "a run")
            log.wait_for_rows(100)
            assert log.ask_to_end(number).code == 0  # after a check that the box does not stream any more
            folder = lab.run_folder()
            assert folder is not None
            assert read_run(folder).header.state == "complete"
    assert read_run(cut.folder).cut
