"""Labels keep bodies apart, rejections apply to every method, and a command that fails keeps nothing."""

import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.lab import Cfid
from tests.swing.swung import encoded, frequency_on, swung, written

MOUNTS = ("x", "y", "z", "xy", "xz", "yz")


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


def test_the_thesis_method_is_rejected_where_no_pendulum_is(cfid: Cfid, tmp_path: Path) -> None:
    path = tmp_path / "shaken.csv"
    path.write_text(shaken())
    fitted = cfid("fit", "swing", path, "--method", "thesis", "--json")

    assert fitted.returncode == 5
    assert json.loads(fitted.stdout)["parameters"] == {}


def test_a_command_that_cannot_draw_keeps_no_parameters(cfid: Cfid, bodies: Path, tmp_path: Path) -> None:
    campaign = bodies
    words = ("fit", "swing", run_named(campaign, "swing_z"), "--campaign", campaign)
    assert cfid(*words, "--no-figures").returncode == 0
    before = (campaign / "parameters.toml").read_bytes()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "encoder_swing.png").write_bytes(b"mine")
    ended = cfid(*words, "--out", tmp_path / "out")

    assert ended.returncode == 2
    assert "swing.natural_frequency_squared_s2" in ended.stdout  # a missing figure costs no result
    assert (campaign / "parameters.toml").read_bytes() == before


@pytest.mark.parametrize("peaks", ["x=9,q=9", "x=3,y=9", "9,10", "x=a"])
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


def test_a_swing_that_a_cable_pulls_is_rejected_by_every_fit_that_takes_it(cfid: Cfid, tmp_path: Path) -> None:
    for mount in MOUNTS:
        time_s, angle = swung(
            frequency_on(mount, np.diag([16.57e-6, 16.66e-6, 29.26e-6])),
            release_rad=math.radians(60),
            seconds=15,
            viscous=0.01,
            coulomb=0.05,
            cable=0.1,
        )
        written(tmp_path / f"{mount}.csv", time_s, encoded(angle, np.random.default_rng(1), noise_deg=0.02))
    fits = [
        ("swing", "x.csv", "--axis", "x"),
        ("inertia", *(f"{mount}={mount}.csv" for mount in MOUNTS), "--geometry", "thesis"),
        ("testbody", "x=x.csv", "z=z.csv", "--geometry", "thesis"),
    ]
    ended = [cfid("fit", *words, "--json") for words in fits]

    assert [one.returncode for one in ended] == [5, 5, 5]
    by_swing, *by_others = (rejections(json.loads(one.stdout)) for one in ended)
    assert by_swing
    assert all(by_swing <= codes for codes in by_others)
    assert "inertia.matrix_kg_m2" not in json.loads(ended[1].stdout)["parameters"]


def test_a_run_labelled_as_the_fixture_is_the_fixture(cfid: Cfid, bodies: Path, tmp_path: Path) -> None:
    copy = tmp_path / "fixture_swing"
    shutil.copytree(run_named(bodies, "swing_y"), copy)
    header = copy / "run.toml"
    header.write_text(header.read_text().replace('body = "crazyflie"', 'body = "fixture"'))
    ended = cfid("fit", "inertia", copy, "x=3.1e-5", "--campaign", bodies, "--json")

    assert ended.returncode == 2
    assert "[fixture]" in ended.stderr
