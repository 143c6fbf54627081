"""`transfer.fit`, `verify` and `read_sines`, called as in a notebook, turn runs into quantities with findings."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cfid
from cfid import transfer
from cfid.errors import DataError, FitError
from cfid.records.run import Run
from cfid.transfer.alignment import align
from cfid.transfer.data import read_sines
from cfid.transfer.estimation import identify
from cfid.transfer.model import TransferFunction
from cfid.transfer.record import verdict
from cfid.transfer.result import fit
from cfid.transfer.verification import verify_run
from tests.lab import new_campaign, with_axes
from tests.offline.sine_bench import SimulatedSine
from tests.transfer.sine_recordings import GAIN_N as PLANT_GAIN_N
from tests.transfer.sine_recordings import LAG_S as PLANT_LAG_S
from tests.transfer.sine_recordings import exact, recorded
from tests.transfer.sine_recordings import simulated as sine_simulated
from tests.transfer.sines_in_a_folder import GAIN_N, LAG_S, sines, write_run

B0, A1 = 6.0705967e-8, 0.9745210


@pytest.fixture(scope="module")
def simulated() -> list[SimulatedSine]:
    return sines((2, 5, 10, 20, 40), samples=2000)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory, simulated: list[SimulatedSine]) -> list[Run]:
    folder = tmp_path_factory.mktemp("campaign")
    return [write_run(folder, run, series="bench") for run in simulated]


def test_the_covariance_of_the_numbers_has_their_uncertainties_on_its_diagonal(runs: list[Run]) -> None:
    result = transfer.fit(runs)
    (covariance,) = result.covariances
    stated = [std for key in covariance.of for std in np.atleast_1d(result.quantities[key].std).tolist()]

    assert np.sqrt(np.diag(covariance.matrix)) == pytest.approx(stated)


def test_a_run_that_differs_from_the_simulation_takes_away_its_own_quantities(
    tmp_path: Path, simulated: list[SimulatedSine]
) -> None:
    weak = replace(simulated[3], counts=simulated[3].counts * 0.5)
    good, bad = write_run(tmp_path, simulated[2]), write_run(tmp_path, weak)
    pole = float(np.exp(-0.002 / LAG_S))
    function = TransferFunction.of_coefficients([0, GAIN_N * (1 - pole)], [1, -pole], delay_s=-0.0274)
    given = transfer.verify([good, bad], function).without_rejected()

    assert not given.accepted
    assert {key.split(".")[2] for key in given.quantities} == {good.folder.name}
    assert len(given.summary()) == 1


def test_sines_above_the_cut_off_and_without_frequency_are_left_out() -> None:
    runs = exact(B0, A1, periods=[0, 4, 8, 40, 100, 101], samples=4000)
    found = identify({"first": runs})

    assert [run.sine.periods for run in found.used["first"]] == [4, 8, 40, 100]
    assert (found.findings[0].code, found.findings[0].severity) == ("sine-too-fast", "note")
    with pytest.raises(FitError, match="no sine run is left up to"):
        identify({"first": [runs[0], runs[-1]]})


def test_a_series_that_is_too_short_for_itself_leaves_the_joint_function() -> None:
    first, second = exact(B0, A1, periods=[4, 8, 40, 80], samples=4000), exact(B0, A1, periods=[20], samples=4000)
    found = identify({"first": first, "second": second})

    assert set(found.each) == {"first"}
    (finding,) = [one for one in found.findings if one.code == "series-not-fitted"]
    assert finding.quantities == ("tf.series.second.*",)


PERIODS = (2, 10, 40)


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    new_campaign(tmp_path)
    for run in sines(PERIODS):
        write_run(tmp_path, run)
    return tmp_path


def test_sines_are_runs_of_one_kind_and_each_has_its_own(campaign: Path) -> None:
    opened = cfid.open_campaign(campaign)

    assert [run.header.requested["l"] for run in opened.runs(kind="sine")] == list(PERIODS)
    assert [run.header.requested["l"] for run in opened.runs(kind="sine_l10")] == [10]
    assert opened.run("last sine").header.requested["l"] == 40
    assert opened.runs(kind="sin") == []


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


def test_a_delay_left_out_is_the_shift_that_figure_3_16_shows_and_a_short_run_is_refused() -> None:
    run = align(recorded(sine_simulated((3, 25, 9)))).runs[1]
    held = TransferFunction.of_lags(PLANT_GAIN_N, [PLANT_LAG_S])
    found = verify_run(run, held, after_quickest_s=0.0)

    assert found.late_s == pytest.approx(0.0006 - 0.012, abs=3e-3)
    assert found.fit_percent < 85
    short = replace(run, sine=replace(run.sine, samples=400))
    with pytest.raises(DataError, match="too short"):
        verify_run(short, held, after_quickest_s=0.0)
