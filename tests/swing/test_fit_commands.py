"""The fits as scripts see them: JSON as specified, exit codes, and the files that a campaign keeps."""

import json
import math
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cfid.records.rig_file import load_rig
from cfid.sim.plants import Pendulum
from cfid.sim.swing import draw_truth, pendulum
from cfid.sim.truth import INERTIA_KG_M2
from tests.campaigns import RECORDINGS_SEED, sentences
from tests.kept import sections_at

Cfid = Callable[..., subprocess.CompletedProcess[str]]

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


def test_json_has_the_keys_of_the_contract(cfid: Cfid, files: Path) -> None:
    result = found(cfid("fit", "inertia", *swings(files), "--geometry", files / "geometry.toml", "--json"))

    assert set(result) == {"command", "parameters", "accepted", "in_force", "findings", "quality", "sources", "version"}
    assert result["command"] == "fit inertia"
    assert result["accepted"] is True
    assert set(result["parameters"]) == {
        "inertia.matrix_kg_m2",
        *(f"inertia.{kind}_kg_m2.{axis}" for kind in ("axis", "centre") for axis in AXES),
    }
    for parameter in result["parameters"].values():
        assert set(parameter) == {"value", "std", "unit"}
        assert np.shape(parameter["value"]) == np.shape(parameter["std"])
    assert [Path(source["path"]).stem for source in result["sources"]] == list(AXES)
    assert all(len(source["sha256"]) == 64 for source in result["sources"])


def test_six_recordings_give_the_simulated_matrix(
    cfid: Cfid, files: Path, truth: np.ndarray[tuple[int, int], np.dtype[np.float64]]
) -> None:
    result = found(cfid("fit", "inertia", *swings(files), "--geometry", files / "geometry.toml", "--json"))
    matrix = result["parameters"]["inertia.matrix_kg_m2"]

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


def test_numbers_with_a_standard_uncertainty_and_files_mix(cfid: Cfid, files: Path) -> None:
    words = [*swings(files, *AXES[1:]), "x=3.11e-05:4e-08", "--geometry", files / "geometry.toml", "--json"]
    result = found(cfid("fit", "inertia", *words))

    assert result["parameters"]["inertia.axis_kg_m2.x"] == {
        "value": 3.11e-05,
        "std": pytest.approx(4e-08),
        "unit": "kg m^2",
    }


def test_peaks_can_be_given_per_axis(cfid: Cfid, files: Path) -> None:
    words = [*swings(files), "--peaks", "x=8,z=9", "--geometry", files / "geometry.toml", "--json"]
    used = {swing["axis"]: swing["peaks_used"] for swing in found(cfid("fit", "inertia", *words))["quality"]["swings"]}

    assert (used["x"], used["z"]) == (8, 9)
    assert used["xz"] > 9


def test_a_swing_with_mass_and_distance_gives_inertia_and_damping(cfid: Cfid, files: Path) -> None:
    words = ["fit", "swing", files / "x.csv", "--mass-kg", "0.028", "--distance-m", "0.022855", "--json"]
    parameters = found(cfid(*words))["parameters"]
    inertia = parameters["swing.axis_inertia_kg_m2"]
    true = simulated(files / "geometry.toml", "x")
    given_moment = 0.028 * 9.81 * 0.022855

    assert abs(inertia["value"] - given_moment / true.gravity_moment_nm * true.axis_inertia_kg_m2) < 3 * inertia["std"]
    assert set(parameters) == {
        "swing.natural_frequency_squared_s2",
        "swing.axis_inertia_kg_m2",
        "swing.viscous_nms_per_rad",
        "swing.coulomb_nm",
        "swing.quadratic_nms2_per_rad2",
        "swing.start_angle_rad",
        "swing.start_speed_rad_per_s",
        "swing.zero_rad",
        "swing.peaks_used",
    }


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
    assert any("sin(phi)" in warning for warning in sentences(theirs))


def test_the_test_body_agrees_with_its_drawing(cfid: Cfid, files: Path) -> None:
    words = [f"x={files / 'tb_x.csv'}", f"z={files / 'tb_z.csv'}", "--geometry", files / "geometry.toml", "--json"]
    parameters = found(cfid("fit", "testbody", *words))["parameters"]

    for axis in "xz":
        assert abs(parameters[f"testbody.error.{axis}"]["value"]) < 0.03
        measured, calculated = (parameters[f"testbody.{k}_kg_m2.{axis}"] for k in ("measured", "calculated"))
        assert abs(measured["value"] - calculated["value"]) < 3 * math.hypot(measured["std"], calculated["std"])


def test_a_campaign_keeps_what_a_fit_found_and_another_fit_leaves_it(cfid: Cfid, files: Path, tmp_path: Path) -> None:
    campaign = tmp_path / "campaign"
    assert cfid("new", campaign).returncode == 0
    inertia = found(cfid("fit", "inertia", *swings(files), "--json", folder=campaign))
    found(cfid("fit", "testbody", f"x={files / 'tb_x.csv'}", "--json", folder=campaign))
    kept = sections_at(campaign)

    assert set(kept) == {"inertia", "testbody"}
    matrix = kept["inertia"].parameters["inertia.matrix_kg_m2"]
    assert matrix.value == inertia["parameters"]["inertia.matrix_kg_m2"]["value"]
    assert matrix.unit == "kg m^2"
    assert [Path(source.path).stem for source in kept["inertia"].sources] == list(AXES)


@pytest.mark.parametrize("jump_s", [20, 600])
def test_a_clock_that_was_set_within_a_swing_ends_in_a_sentence(
    cfid: Cfid, files: Path, tmp_path: Path, jump_s: float
) -> None:
    frame = pd.read_csv(files / "x.csv")
    frame.iloc[len(frame) // 2 :, 0] += jump_s
    frame.to_csv(tmp_path / "set.csv", index=False)

    refused = cfid("fit", "swing", tmp_path / "set.csv", "--no-figures")

    assert refused.returncode in (4, 5)
    assert "Traceback" not in refused.stderr


def test_a_fit_made_with_another_rig_toml_is_stale_and_exported_no_more(
    cfid: Cfid, files: Path, tmp_path: Path
) -> None:
    cfid("new", "lab")
    rig = tmp_path / "lab" / "rig.toml"
    assert cfid("fit", "inertia", *swings(files), "--campaign", tmp_path / "lab", "--no-figures").returncode == 0
    text = rig.read_text()

    def after(old: str, new: str) -> str:
        assert old in text
        rig.write_text(text.replace(old, new, 1))
        return " ".join(cfid("status", "--campaign", tmp_path / "lab", "--kind", "inertia").stdout.split())

    assert "fit again" not in after("[site]", "# where the rig stands\n[site]")
    said = after("mass_kg = 0.0280", "mass_kg = 0.03")
    assert "Made with another rig.toml: vehicle.mass_kg was 0.028, is 0.03: fit again." in said
    refused = cfid("export", "firmware", "--campaign", tmp_path / "lab")
    assert refused.returncode == 4
    assert "inertia.matrix_kg_m2 is outdated. Made with another rig.toml" in refused.stderr
    assert "mounts.x has changed: fit again" in after("point_mm = [0.0, 32.25", "point_mm = [0.0, 32.35")


def test_figures_lie_where_they_are_asked_for_and_replace_only_themselves(
    cfid: Cfid, files: Path, tmp_path: Path
) -> None:
    out = tmp_path / "figures"
    words = ["fit", "swing", files / "y.csv", "--out", out]
    assert cfid(*words).returncode == 0
    assert {path.name for path in out.iterdir()} == {"y_swing.png", "y_swing.svg"}
    assert cfid(*words).returncode == 0

    (out / "y_swing.png").write_bytes(b"somebody's own picture")
    refused = cfid(*words)
    assert refused.returncode == 2
    assert "--force" in refused.stderr
    assert "swing.natural_frequency_squared_s2" in refused.stdout  # a missing figure costs no result
    assert (out / "y_swing.png").read_bytes() == b"somebody's own picture"


def test_a_run_folder_brings_its_axis_along(cfid: Cfid, bodies: Path) -> None:
    run = next((bodies / "runs").glob("*_swing_z"))
    by_name = found(cfid("fit", "swing", run.name, "--json", folder=bodies))
    by_path = found(cfid("fit", "swing", run, "--json", "--campaign", bodies))

    assert by_name["parameters"] == by_path["parameters"]
    inertia = by_name["parameters"]["swing.axis_inertia_kg_m2"]
    true = simulated(bodies / "rig.toml", "z")
    assert abs(inertia["value"] - true.axis_inertia_kg_m2) < 3 * inertia["std"]

    again = cfid("demo", bodies)
    assert again.returncode == 2
    assert "delete it" in again.stderr

    listed = cfid("runs", "--json", "--campaign", bodies)
    states = {row["state"] for row in json.loads(listed.stdout)["runs"]}
    assert states == {"complete"}

    toml = run / "run.toml"
    toml.write_text(toml.read_text().replace('"complete"', '"recording"'))
    for file in run.glob("*.csv"):
        os.utime(file)
    assert "still being recorded" in sentences(found(cfid("fit", "swing", run, "--json")))[0]
    for file in run.glob("*.csv"):
        os.utime(file, (0, 0))
    assert "cut" in cfid("runs", "--campaign", bodies).stdout


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

    assert right.returncode == 0
    assert contradicting.returncode == 2
    assert "axis 'x' contradicts the run's own label, axis 'z'" in contradicting.stderr
    assert exchanged.returncode == 5
    assert "standard uncertainties apart (limit 4). Check which axis was swung" in exchanged.stderr
