"""`transfer.fit`, `verify` and `read_sines`, called as in a notebook, turn runs into quantities with findings."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cfid import transfer
from cfid.errors import FitError
from cfid.records.run import Run
from cfid.transfer.estimation import identify
from cfid.transfer.model import TransferFunction
from tests.offline.sine_bench import SimulatedSine
from tests.transfer.sine_recordings import exact
from tests.transfer.sines_in_a_folder import GAIN_N, LAG_S, sines, write_run

B0, A1 = 6.0705967e-8, 0.9745210


@pytest.fixture(scope="module")
def simulated() -> list[SimulatedSine]:
    return sines((2, 5, 10, 20, 40), samples=2000)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory, simulated: list[SimulatedSine]) -> list[Run]:
    folder = tmp_path_factory.mktemp("campaign")
    return [write_run(folder, run, series="bench") for run in simulated]


def test_runs_give_a_transfer_function_and_folders_the_same(runs: list[Run]) -> None:
    result = transfer.fit(runs)
    lag, gain = (result.quantities[f"tf.{name}"] for name in ("time_constant_s", "static_gain_n"))

    assert result.accepted
    assert abs(lag.value - LAG_S) < 3 * lag.std < 0.075 * LAG_S
    assert abs(gain.value - GAIN_N) < 3 * gain.std < 0.075 * GAIN_N
    assert transfer.fit([run.folder for run in runs]).quantities["tf.time_constant_s"] == lag
    assert set(result.figures()) == {"tf_bode", "tf_step", "tf_run_bench"}


def test_the_covariance_of_the_numbers_has_their_uncertainties_on_its_diagonal(runs: list[Run]) -> None:
    result = transfer.fit(runs)
    (covariance,) = result.covariances
    stated = [std for key in covariance.of for std in np.atleast_1d(result.quantities[key].std).tolist()]

    assert np.sqrt(np.diag(covariance.matrix)) == pytest.approx(stated)


def test_a_result_is_verified_against_a_run_that_was_left_out(runs: list[Run]) -> None:
    *used, left_out = [runs[0], runs[1], runs[3], runs[4], runs[2]]
    verified = transfer.verify([left_out], transfer.fit(used))
    again = transfer.verify(used[:1], transfer.fit(used))

    assert verified.accepted
    assert verified.quantities[f"tf.verify.{left_out.folder.name}.gain_ratio"].value == pytest.approx(1, abs=0.05)
    assert "verification-reuses-run" not in {one.code for one in verified.findings}
    assert "verification-reuses-run" in {one.code for one in again.findings}


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
        identify({"first": runs}, cutoff_hz=0.4)


def test_a_series_that_is_too_short_for_itself_leaves_the_joint_function() -> None:
    first, second = exact(B0, A1, periods=[4, 8, 40, 80], samples=4000), exact(B0, A1, periods=[20], samples=4000)
    found = identify({"first": first, "second": second})

    assert set(found.each) == {"first"}
    (finding,) = [one for one in found.findings if one.code == "series-not-fitted"]
    assert finding.quantities == ("tf.series.second.*",)
