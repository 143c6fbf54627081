"""Sines in the Python interface: selected by kind for any l, and read from their run folders."""

from pathlib import Path

import pytest

import cfid
from cfid.errors import DataError
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text
from cfid.transfer.data import read_sines
from cfid.transfer.record import verdict
from cfid.transfer.result import fit
from tests.few_axes import with_axes
from tests.transfer.sines_in_a_folder import sines, write_run

PERIODS = (2, 10, 40)


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    for run in sines(PERIODS):
        write_run(tmp_path, run)
    return tmp_path


def test_sines_are_runs_of_one_kind_and_each_has_its_own(campaign: Path) -> None:
    opened = cfid.open_campaign(campaign)

    assert [run.header.requested["l"] for run in opened.runs(kind="sine")] == list(PERIODS)
    assert [run.header.requested["l"] for run in opened.runs(kind="sine_l10")] == [10]
    assert opened.run("last sine").header.requested["l"] == 40
    assert opened.runs(kind="sin") == []


def test_a_sine_that_the_fit_leaves_out_is_judged_as_that(tmp_path: Path) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    for run in sines((*PERIODS, 60)):
        write_run(tmp_path, run)
    runs = cfid.open_campaign(tmp_path).runs(kind="sine")
    (left_out,) = [one.text for one in fit(runs).findings if one.code == "sine-too-fast"]
    said = [verdict(run) for run in runs]

    assert left_out == "motor1: l = 60 above the cut-off of 12.5 Hz left out."
    assert said[-1].endswith(
        "Above the cut-off of 12.5 Hz: `cfid tf identify` leaves it out unless `cutoff_hz` is raised."
    )
    assert not any("cut-off" in one for one in said[:-1])


def test_sines_of_one_axis_are_read_by_its_channel_and_refused_by_another(campaign: Path) -> None:
    runs = [with_axes(run, "Fz") for run in cfid.open_campaign(campaign).runs(kind="sine")]

    assert "times the noise there" in verdict(runs[0])
    assert len(read_sines(runs, channel="Fz").runs) == len(PERIODS)
    with pytest.raises(DataError, match="measured Fz alone, and thrust by the channel arm needs Tx, Ty"):
        read_sines(runs)


def test_a_fit_of_sines_keeps_the_arm_by_which_torques_became_thrust(campaign: Path) -> None:
    runs = cfid.open_campaign(campaign).runs(kind="sine")

    assert fit(runs).facts == {"loadcell.arm_mm": 46.0}
    assert fit(read_sines(runs, arm_m=0.04)).facts == {"loadcell.arm_mm": 40.0}
