"""The fits as scripts see them: JSON as specified, exit codes, and the files that a campaign keeps."""

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cfid.records.rig_file import load_rig
from cfid.sim.plants import Pendulum
from cfid.sim.swing import draw_truth, pendulum
from cfid.sim.truth import INERTIA_KG_M2
from tests.campaigns import RECORDINGS_SEED
from tests.lab import Cfid

AXES = ("x", "y", "z", "xy", "xz", "yz")
C_1_4 = {
    "x": "3.119770273213515e-05",
    "y": "3.128159434626518e-05",
    "z": "7.004148241971259e-05",
    "xy": "4.940332984711082e-05",
    "xz": "4.600706365028182e-05",
    "yz": "4.713092929680177e-05",
}


def found(ended: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    assert ended.returncode == 0, ended.stderr
    result: dict[str, Any] = json.loads(ended.stdout)
    return result


def simulated(rig_file: Path, axis: str) -> Pendulum:
    """Return the simulated pendulum of the vehicle on a mount."""
    truth = draw_truth(load_rig(rig_file), inertia_kg_m2=INERTIA_KG_M2, rng=np.random.default_rng(RECORDINGS_SEED))
    return pendulum(truth, axis)


def swings(files: Path, *axes: str) -> list[str]:
    return [f"{axis}={files / axis}.csv" for axis in axes or AXES]


def test_six_recordings_give_the_simulated_matrix_as_json_with_the_keys_of_the_contract(
    cfid: Cfid, files: Path, truth: np.ndarray[tuple[int, int], np.dtype[np.float64]]
) -> None:
    result = found(cfid("fit", "inertia", *swings(files), "--geometry", files / "geometry.toml", "--json"))
    matrix = result["parameters"]["inertia.matrix_kg_m2"]

    assert set(result) == {"command", "parameters", "accepted", "in_force", "findings", "quality", "sources", "version"}
    assert (result["command"], result["accepted"]) == ("fit inertia", True)
    assert set(result["parameters"]) == {
        "inertia.matrix_kg_m2",
        *(f"inertia.{kind}_kg_m2.{axis}" for kind in ("axis", "centre") for axis in AXES),
    }
    for parameter in result["parameters"].values():
        assert set(parameter) == {"value", "std", "unit"}
        assert np.shape(parameter["value"]) == np.shape(parameter["std"])
    assert [Path(source["path"]).stem for source in result["sources"]] == list(AXES)
    assert all(len(source["sha256"]) == 64 for source in result["sources"])
    assert np.all(np.abs(np.array(matrix["value"]) - truth) < 3 * np.array(matrix["std"]))
    assert max(np.array(matrix["std"]).ravel()) < 2e-7


def test_the_thesis_matrix_comes_out_with_its_geometry_and_without_a_rig_the_fit_asks(cfid: Cfid) -> None:
    words = ["fit", "inertia", *(f"{axis}={value}" for axis, value in C_1_4.items()), "--json"]
    asked = cfid(*words)
    result = found(cfid(*words, "--geometry", "thesis"))
    matrix = 1e6 * np.array(result["parameters"]["inertia.matrix_kg_m2"]["value"])

    assert np.round(matrix, 6).tolist() == [
        [16.571710, 0.830806, 0.718277],
        [0.830806, 16.655602, 1.800197],
        [0.718277, 1.800197, 29.261652],
    ]
    assert asked.returncode == 2
    assert "--geometry thesis" in asked.stderr


def test_numbers_with_a_standard_uncertainty_and_files_mix_and_peaks_are_given_per_axis(
    cfid: Cfid, files: Path
) -> None:
    words = [*swings(files, *AXES[1:]), "x=3.11e-05:4e-08", "--peaks", "y=8,z=9"]
    result = found(cfid("fit", "inertia", *words, "--geometry", files / "geometry.toml", "--json"))
    of_x, used = result["parameters"]["inertia.axis_kg_m2.x"], result["quality"]["swings"]

    assert of_x == {"value": 3.11e-05, "std": pytest.approx(4e-08), "unit": "kg m^2"}
    peaks = {swing["axis"]: swing.get("peaks_used", 0) for swing in used}
    assert (peaks["y"], peaks["z"], peaks["xz"] > 9) == (8, 9, True)


def test_the_thesis_method_gives_too_large_an_inertia_with_the_reason(cfid: Cfid, files: Path) -> None:
    words = ["fit", "swing", files / "z.csv", "--mass-kg", "0.028", "--distance-m", "0.038163", "--json"]
    ours, theirs = found(cfid(*words)), found(cfid(*words, "--method", "thesis"))
    true = simulated(files / "geometry.toml", "z")
    frequency = true.gravity_moment_nm / true.axis_inertia_kg_m2
    by_default, by_thesis = (r["parameters"]["swing.natural_frequency_squared_s2"] for r in (ours, theirs))
    excess = frequency / by_thesis["value"] - 1

    assert abs(by_default["value"] - frequency) < 3 * by_default["std"]
    assert excess > 0.005
    assert ours["quality"]["damped_cosine"]["relative_inertia_excess"] == pytest.approx(
        excess, abs=3 * by_default["std"] / frequency
    )
    assert "swing-thesis-bias" in {finding["code"] for finding in theirs["findings"]}


@pytest.mark.parametrize("jump_s", [20, 600])
def test_a_clock_that_was_set_within_a_swing_gives_no_number(
    cfid: Cfid, files: Path, tmp_path: Path, jump_s: float
) -> None:
    frame = pd.read_csv(files / "x.csv")
    frame.iloc[len(frame) // 2 :, 0] += jump_s
    frame.to_csv(tmp_path / "set.csv", index=False)

    assert cfid("fit", "swing", tmp_path / "set.csv", "--no-figures").returncode in (4, 5)


def test_a_fit_made_with_another_rig_toml_is_stale_and_exported_no_more(
    cfid: Cfid, files: Path, tmp_path: Path
) -> None:
    cfid("new", "lab", "--kind", "simulated")
    rig = tmp_path / "lab" / "rig.toml"
    assert cfid("fit", "inertia", *swings(files), "--campaign", tmp_path / "lab", "--no-figures").returncode == 0
    text = rig.read_text()

    def after(old: str, new: str) -> str:
        assert old in text
        rig.write_text(text.replace(old, new, 1))
        return " ".join(cfid("status", "--campaign", tmp_path / "lab", "--kind", "inertia").stdout.split())

    assert "fit again" not in after("[site]", "# where the rig stands\n[site]")
    assert "vehicle.mass_kg was 0.028, is 0.03: fit again." in after("mass_kg = 0.0280", "mass_kg = 0.03")
    assert cfid("export", "firmware", "--campaign", tmp_path / "lab").returncode == 4
    assert "mounts.x has changed: fit again" in after("point_mm = [0.0, 32.25", "point_mm = [0.0, 32.35")


def test_a_run_folder_brings_its_axis_along(cfid: Cfid, bodies: Path) -> None:
    run = next((bodies / "runs").glob("*_swing_z"))
    by_name = found(cfid("fit", "swing", run.name, "--json", folder=bodies))
    by_path = found(cfid("fit", "swing", run, "--json", "--campaign", bodies))

    assert by_name["parameters"] == by_path["parameters"]
    inertia = by_name["parameters"]["swing.axis_inertia_kg_m2"]
    true = simulated(bodies / "rig.toml", "z")
    assert abs(inertia["value"] - true.axis_inertia_kg_m2) < 3 * inertia["std"]


def test_swings_about_exchanged_axes_are_no_test_body(cfid: Cfid, bodies: Path, tmp_path: Path) -> None:
    x, z = (next((bodies / "runs").glob(f"*_swing_testbody_{axis}")) for axis in "xz")
    right = cfid("fit", "testbody", f"x={x}", f"z={z}", "--campaign", bodies, "--no-figures")
    contradicting = cfid("fit", "testbody", f"x={z}", f"z={x}", "--campaign", bodies, "--no-figures")
    for run, axis in ((x, "z"), (z, "x")):  # labelled wrongly from the start
        there = shutil.copytree(run, tmp_path / axis) / "run.toml"
        there.write_text(there.read_text().replace(f'axis = "{run.name[-1]}"', f'axis = "{axis}"'))
    exchanged = cfid(
        "fit", "testbody", f"x={tmp_path / 'x'}", f"z={tmp_path / 'z'}", "--campaign", bodies, "--no-figures"
    )

    assert [ended.returncode for ended in (right, contradicting, exchanged)] == [0, 2, 5]
