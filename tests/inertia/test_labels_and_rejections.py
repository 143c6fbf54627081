"""Labels keep bodies apart, rejections apply to every method, and a command that fails keeps nothing."""

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.records.campaign import open_campaign
from tests.swing.integrated import encoded, frequency_on, motion, written

Cfid = Callable[..., subprocess.CompletedProcess[str]]


def run_named(bodies: Path, ending: str) -> Path:
    return next((bodies / "runs").glob(f"*_{ending}"))


def rejections(result: dict[str, Any]) -> set[str]:
    return {finding["code"] for finding in result["findings"] if finding["severity"] == "rejection"}


def shaken() -> str:
    """Return the text of a recording of a swing with a second motion on top."""
    time_s = np.arange(0, 8, 0.001)
    angle = 0.8 * np.exp(-0.3 * time_s) * np.cos(14 * time_s) + 0.03 * np.sin(45 * time_s)
    return "t,theta_rad\n" + "".join(f"{t:.6f},{a:.7f}\n" for t, a in zip(time_s, angle, strict=True))


def test_a_swing_of_the_test_body_is_not_taken_for_the_vehicles(cfid: Cfid, bodies: Path) -> None:
    ended = cfid("fit", "inertia", run_named(bodies, "swing_testbody_x"), "--campaign", bodies, "--json")

    assert ended.returncode == 2
    assert "labelled as a swing of the testbody, not of the crazyflie" in ended.stderr


def test_a_run_labelled_as_the_fixture_is_the_fixture(cfid: Cfid, bodies: Path, tmp_path: Path) -> None:
    copy = tmp_path / "fixture_swing"
    shutil.copytree(run_named(bodies, "swing_y"), copy)
    header = copy / "run.toml"
    header.write_text(header.read_text().replace('body = "crazyflie"', 'body = "fixture"'))
    ended = cfid("fit", "inertia", copy, "x=3.1e-5", "--campaign", bodies, "--json")

    assert ended.returncode == 2
    assert "[fixture]" in ended.stderr


def test_the_thesis_method_is_rejected_where_no_pendulum_is(cfid: Cfid, tmp_path: Path) -> None:
    path = tmp_path / "shaken.csv"
    path.write_text(shaken())
    fitted = cfid("fit", "swing", path, "--method", "thesis", "--json")

    assert fitted.returncode == 5
    assert json.loads(fitted.stdout)["parameters"] == {}
    printed = cfid("fit", "swing", path, "--method", "thesis", "--no-figures").stdout
    assert "1/s^2" not in printed


def test_a_command_that_cannot_draw_keeps_no_parameters(cfid: Cfid, bodies: Path, tmp_path: Path) -> None:
    campaign = bodies
    words = ("fit", "swing", run_named(campaign, "swing_z"), "--campaign", campaign)
    assert cfid(*words, "--no-figures").returncode == 0
    before = (campaign / "parameters.toml").read_bytes()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "encoder_swing.png").write_bytes(b"mine")
    ended = cfid(*words, "--out", tmp_path / "out")

    assert ended.returncode == 2
    assert (campaign / "parameters.toml").read_bytes() == before


def test_swings_are_kept_by_axis_with_paths_from_the_campaign_on(cfid: Cfid, bodies: Path) -> None:
    campaign = bodies
    for axis in "xz":
        run = run_named(campaign, f"swing_{axis}")
        assert cfid("fit", "swing", run, "--no-figures", "--campaign", campaign).returncode == 0
    kept = open_campaign(campaign).values().sections()
    assert {"swing x", "swing z"} <= set(kept)
    assert kept["swing z"].sources[0].path == f"runs/{run.name}/encoder.csv"


def test_a_run_whose_name_has_an_equals_sign_is_no_label_and_file(cfid: Cfid, bodies: Path) -> None:
    plain = [cfid("fit", what, "--campaign", bodies, "--json").stdout for what in ("inertia", "friction")]
    for ending in ("swing_z", "drop_20g"):
        run = run_named(bodies, ending)
        run.rename(run.with_name(f"{run.name}_m=28g"))
    renamed = [cfid("fit", what, "--campaign", bodies, "--json") for what in ("inertia", "friction")]

    assert [one.returncode for one in renamed] == [0, 0], renamed[0].stderr + renamed[1].stderr
    for before, after in zip(plain, renamed, strict=True):
        assert json.loads(after.stdout)["parameters"] == json.loads(before)["parameters"]


@pytest.mark.parametrize("peaks", ["q=9", "x=9,q=9", "x=3,y=9", "9,10", "x=a"])
def test_peaks_that_mean_nothing_are_refused(cfid: Cfid, bodies: Path, peaks: str) -> None:
    words = [run_named(bodies, f"swing_{axis}") for axis in ("x", "y")]
    ended = cfid("fit", "inertia", *words, "--peaks", peaks, "--campaign", bodies, "--json")

    assert ended.returncode == 2
    assert "peaks" in ended.stderr


def test_one_weight_gives_its_runs_and_no_friction(cfid: Cfid, bodies: Path) -> None:
    both = sorted((bodies / "runs").glob("*_drop_30g"))
    one = cfid("fit", "friction", *both, "--json", "--campaign", bodies)
    result = json.loads(one.stdout)

    assert one.returncode == 5
    assert set(result["parameters"]) == {"friction.runs"}
    assert rejections(result) == {"friction-one-weight"}


def test_a_rejected_swing_takes_away_the_matrix_and_its_own_mount_alone(
    cfid: Cfid, bodies: Path, tmp_path: Path
) -> None:
    distorted = tmp_path / "distorted.csv"
    distorted.write_text(shaken())
    others = [f"{axis}={run_named(bodies, f'swing_{axis}')}" for axis in ("x", "y", "xy", "xz", "yz")]
    six = cfid("fit", "inertia", *others, f"z={distorted}", "--json", "--campaign", bodies)
    result = json.loads(six.stdout)

    assert six.returncode == 5
    assert set(result["parameters"]) == {
        f"inertia.{kind}_kg_m2.{axis}" for kind in ("axis", "centre") for axis in ("x", "y", "xy", "xz", "yz")
    }
    assert "swing-waveform-distorted" in rejections(result)
    printed = cfid("fit", "inertia", *others, f"z={distorted}", "--no-figures", "--campaign", bodies)
    assert "z: rejected" in printed.stdout
    assert "budget" not in printed.stdout


def test_a_swing_that_a_cable_pulls_is_rejected_by_every_fit_that_takes_it(cfid: Cfid, tmp_path: Path) -> None:
    inertia_kg_m2 = np.diag([16.57e-6, 16.66e-6, 29.26e-6])
    for mount in ("x", "y", "z", "xy", "xz", "yz"):
        frequency = frequency_on(mount, inertia_kg_m2)
        time_s, angle = motion(
            frequency_squared_s2=frequency,
            release_deg=60,
            seconds=15,
            viscous_per_s=0.01,
            coulomb_per_s2=0.05,
            cable=0.1,
        )
        written(tmp_path / f"{mount}.csv", time_s, encoded(angle, seed=1))
    fits = [
        ("swing", "x.csv", "--axis", "x"),
        ("inertia", *(f"{mount}={mount}.csv" for mount in ("x", "y", "z", "xy", "xz", "yz")), "--geometry", "thesis"),
        ("testbody", "x=x.csv", "z=z.csv", "--geometry", "thesis"),
    ]
    ended = [cfid("fit", *words, "--json") for words in fits]

    assert [one.returncode for one in ended] == [5, 5, 5]
    by_swing, *by_others = (rejections(json.loads(one.stdout)) for one in ended)
    assert by_swing
    assert all(by_swing <= codes for codes in by_others)
    assert "inertia.matrix_kg_m2" not in json.loads(ended[1].stdout)["parameters"]


def test_two_swings_give_their_axis_inertias_and_no_matrix(cfid: Cfid, bodies: Path) -> None:
    runs = [run_named(bodies, f"swing_{axis}") for axis in "xz"]
    two = cfid("fit", "inertia", *runs, "--json", "--campaign", bodies)
    result = json.loads(two.stdout)

    assert two.returncode == 5
    assert set(result["parameters"]) == {f"inertia.{kind}_kg_m2.{axis}" for kind in ("axis", "centre") for axis in "xz"}
    assert rejections(result) == {"inertia-axes-dependent"}
    assert "inertia" not in cfid("parameters", "--json", "--campaign", bodies).stdout
    assert open_campaign(bodies).fits()[-1].section.rejected
