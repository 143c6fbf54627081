"""Commands lie where they lay among forces that a load cell's own clock times, however late its first rows arrived."""

from datetime import UTC, datetime

import numpy as np
import pytest

from cfid.motors.data import reduce_run
from cfid.motors.rotor.data import followed
from cfid.recordings.read import read_recording
from cfid.recordings.wrench import AXES, wrench_of
from cfid.records.run import DeviceRecord, Label, Run, read_run
from cfid.records.run_writer import create_run
from tests.motors.stand_in_a_folder import BEGIN_S, climbed
from tests.offline.stand import StandRecord


@pytest.fixture(scope="module")
def record() -> StandRecord:
    return climbed([20000, 40000], motors=(1,), rate_hz=4000, spikes_per_s=0)


@pytest.fixture(scope="module")
def run(record: StandRecord, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Write a run of a load cell whose first 800 rows arrive in one burst, 0.2 s after the first was taken."""
    devices = {
        "commands": DeviceRecord(file="commands.csv", columns=("t", "m1", "m2", "m3", "m4")),
        "loadcell": DeviceRecord.model_validate(
            {"file": "loadcell.csv", "columns": ("t", *AXES, "device_us"), "units": "n,nm"}
        ),
    }
    folder, started = tmp_path_factory.mktemp("cell"), datetime(2026, 11, 21, tzinfo=UTC)
    with create_run(folder, kind="thrust", label=Label(), devices=devices, started=started, cfid_version="0") as run:
        arrived_s = BEGIN_S + np.maximum(record.time_s, 0.2)
        run.append("loadcell", (arrived_s, *record.wrench.T, np.rint(1e6 * record.time_s).astype(np.int64)))
        run.append("commands", (BEGIN_S + record.command_time_s, *record.commands.astype(np.int64).T))
    return read_run(run.folder)


def test_steps_of_force_are_not_late_by_the_delay_of_the_first_row(run: Run) -> None:
    assert reduce_run(wrench_of(read_recording(run.folder))).began_s == pytest.approx(BEGIN_S, abs=2e-3)


def test_speeds_from_vibration_are_not_late_by_the_delay_of_the_first_row(run: Run, record: StandRecord) -> None:
    rotor = followed(run).rotors[0]
    changes_s = rotor.begin_s[1:][np.diff(rotor.command) != 0]
    driven_s = record.command_time_s[1:][np.diff(record.commands.max(axis=1)) != 0]
    np.testing.assert_allclose(changes_s, driven_s, atol=2e-3)
