"""`cfid tf verify` compares a transfer function with runs from which it was not identified."""

import math
from pathlib import Path

import numpy as np
import pytest

from cfid.errors import CfidError, DataError
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text
from cfid.records.run import amend_run, read_run
from cfid.transfer import read_sines, verify
from cfid.transfer.model import TransferFunction
from tests.lab import sections_at
from tests.offline.sine_bench import SimulatedSine
from tests.transfer.sines_in_a_folder import GAIN_N, LAG_S, THESIS_MOUNT, Here, sines, write_index, write_run
from tests.transfer.test_tf_faults import refused

POLE = float(np.exp(-0.002 / LAG_S))
DELAY_S = 0.0006 - 0.028


@pytest.fixture(scope="module")
def runs() -> list[SimulatedSine]:
    return sines((1, 2, 5, 8, 10, 12, 20, 40, 60), samples=4000)


@pytest.fixture
def campaign(tmp_path: Path, runs: list[SimulatedSine]) -> Path:
    """A campaign with all runs as one series; nothing has been identified from them yet."""
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    for run in runs:
        write_run(tmp_path, run, series="bench")
    return tmp_path


FUNCTION = TransferFunction.of_coefficients([0.0, 6.07e-8], [1.0, -0.97453], delay_s=-0.0274)


def name_of(campaign: Path, l: int) -> str:  # noqa: E741
    (folder,) = (campaign / "runs").glob(f"*_sine_l{l}")
    return folder.name


def test_what_a_campaign_identified_describes_a_run_it_did_not_see(tf: Here, campaign: Path) -> None:
    seen = [name_of(campaign, l) for l in (1, 2, 5, 8, 10, 20, 40, 60)]  # noqa: E741
    assert tf("identify", *seen, "--no-figures").returncode == 0
    left_out = name_of(campaign, 12)
    content = tf.json("verify", left_out)
    parameters = content["parameters"]

    assert content["accepted"]
    assert not content["findings"]
    key = f"tf.verify.{left_out}"
    late = parameters[f"{key}.late_s"]
    assert late["value"] == pytest.approx(0, abs=3 * late["std"] + 5e-4)
    assert parameters[f"{key}.gain_ratio"]["value"] == pytest.approx(1, abs=0.03)
    assert parameters[f"{key}.fit_percent"]["value"] > 85
    assert parameters[f"{key}.residual_rms_n"]["value"] < 5e-3
    assert content["quality"]["runs"][f"1.5 Hz ({left_out})"]["off"] < 0.05
    assert "tf verify" in sections_at(campaign)


def test_a_glob_verifies_with_the_run_that_was_excluded_for_it(tf: Here, campaign: Path) -> None:
    left_out = name_of(campaign, 12)
    amend_run(read_run(campaign / "runs" / left_out), excluded="for verification")
    assert tf("identify", "--no-figures").returncode == 0

    content = tf.json("verify", "*_sine_l12", "--no-figures")

    assert f"tf.verify.{left_out}.late_s" in content["parameters"]
    assert not content["findings"]


def test_the_thesis_result_of_a_campaign_is_verified_from_the_stamps_on_average(tf: Here, campaign: Path) -> None:
    assert tf("identify", "--method", "thesis", "--no-figures").returncode == 0
    content = tf.json("verify", name_of(campaign, 12), "--force")
    late_s = content["parameters"][f"tf.verify.{name_of(campaign, 12)}.late_s"]["value"]

    assert late_s < -0.002  # the latency, which the thesis method ignores


def test_only_the_function_of_a_sine_describes_it(tmp_path: Path, runs: list[SimulatedSine]) -> None:
    sines_read = read_sines([], facts=THESIS_MOUNT, index=write_index(tmp_path, {"": runs[4:7]}))
    numerator = [0.0, GAIN_N * (1 - POLE)]
    good, shifted, wrong = (
        verify(sines_read, TransferFunction.of_coefficients(numerator, [1.0, -pole], delay_s=delay_s))
        for pole, delay_s in ((POLE, DELAY_S), (POLE, DELAY_S - 0.02), (0.9, DELAY_S))
    )

    assert [result.accepted for result in (good, shifted, wrong)] == [True, False, False]
    assert {key.split(".")[2] for key in good.quantities} == {"crossings_10", "crossings_12", "crossings_20"}


@pytest.mark.parametrize(
    ("numerator", "denominator", "delay_s"),
    [
        ([1], [2, -1], 0.0),
        ([math.nan], [1, -0.97], 0.0),
        ([0, 0], [1, -0.97], 0.0),
        ([0, 6e-8], [1, -1.5], 0.0),
        ([0, 6e-8], [1, -0.97], math.nan),
        ([0, 6e-8], [1, -0.97], -1e9),
    ],
)
def test_coefficients_of_no_motor_are_refused(numerator: list[float], denominator: list[float], delay_s: float) -> None:
    with pytest.raises(CfidError):
        TransferFunction.of_coefficients(numerator, denominator, delay_s=delay_s)


def test_nothing_to_verify_is_refused(tf: Here, tmp_path: Path, runs: list[SimulatedSine]) -> None:
    write_index(tmp_path, {"": runs[4:5]}, cells=1)
    refused(tf("verify", "--index", "index.csv"), 2)
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    refused(tf("verify", "--index", "index.csv"), 2, "has no transfer function yet: run `cfid tf identify`")


def test_a_run_without_frequency_is_left_out_and_alone_cannot_be_compared(tmp_path: Path) -> None:
    both = read_sines([], facts=THESIS_MOUNT, index=write_index(tmp_path, {"": sines((0, 10))}, cells=1))
    assert [key for key in verify(both, FUNCTION).quantities if key.endswith("late_s")] == [
        "tf.verify.crossings_10.late_s"
    ]

    alone = read_sines(
        [], facts=THESIS_MOUNT, index=write_index(tmp_path, {"": sines((0,))}, cells=1, name="alone.csv")
    )
    with pytest.raises(DataError):
        verify(alone, FUNCTION)


def test_runs_whose_files_are_called_the_same_keep_their_own_figures(tmp_path: Path) -> None:
    for folder, seed in (("one", 0), ("other", 1)):
        (tmp_path / folder).mkdir()
        write_index(tmp_path / folder, {"": sines((10,), seed=seed)}, cells=1)
    rows = [(tmp_path / folder / "index.csv").read_text().splitlines() for folder in ("one", "other")]
    lines = [row[1].replace(",c", f",{at}/c") for at, row in zip(("one", "other"), rows, strict=True)]
    (tmp_path / "both.csv").write_text("\n".join([rows[0][0], *lines]) + "\n")
    result = verify(read_sines([], facts=THESIS_MOUNT, index=tmp_path / "both.csv"), FUNCTION)

    assert len([key for key in result.quantities if key.endswith("gain_ratio")]) == 2
    assert len(result.quality["runs"]) == 2
    assert {"tf_verify_l10", "tf_verify_l10_2"} <= set(result.figures())
