"""Results of `cfid.inertia.fit` and `fit_testbody` in a notebook."""

import json
from pathlib import Path

import numpy as np
import pytest

import cfid.inertia
from cfid.errors import ConfigError
from cfid.records.result import Result
from cfid.records.rig_file import thesis_rig
from cfid.swing.body import KnownInertia
from tests.lab import Cfid
from tests.swing.swung import swung, written

RIG = thesis_rig()
TABLE_2_3 = {"x": 3.119770e-5, "y": 3.128159e-5, "z": 7.004148e-5, "xy": 4.940333e-5, "xz": 4.600706e-5}


def codes(result: Result, severity: str) -> list[str]:
    return [finding.code for finding in result.findings if finding.severity == severity]


def known(std_kg_m2: float = 1e-8, **more: float) -> list[KnownInertia]:
    return [KnownInertia(mount, value, std_kg_m2) for mount, value in ({**TABLE_2_3, "yz": 4.713093e-5} | more).items()]


@pytest.mark.parametrize(("std_kg_m2", "noted"), [(1e-8, []), (0.0, ["x", "xy", "xz", "y", "yz", "z"])])
def test_axis_inertias_that_are_taken_as_exact_are_noted(std_kg_m2: float, noted: list[str]) -> None:
    findings = cfid.inertia.fit(known(std_kg_m2), rig=RIG).findings
    exact = [one for one in findings if "the axis inertia is taken as exact" in one.text]
    assert sorted(mount for one in exact for mount in one.where) == noted


def test_two_swings_of_a_mount_are_weighted_and_the_smaller_uncertainty_stands() -> None:
    swings = [*known(), KnownInertia("x", 3.121e-5, 2e-8)]
    result = cfid.inertia.fit(swings, rig=RIG)
    mean = result.quantities["inertia.axis_kg_m2.x"]

    assert mean.value == pytest.approx((4 * 3.119770e-5 + 3.121e-5) / 5, rel=1e-12)
    assert mean.std == pytest.approx(1e-8)


def test_axes_that_determine_no_matrix_give_their_axis_inertias() -> None:
    result = cfid.inertia.fit(known()[:5], rig=RIG)

    assert not result.accepted
    assert codes(result, "rejection") == ["inertia-axes-dependent"]
    assert result.rejected.keys() == {"inertia.matrix_kg_m2"}
    assert set(result.quantities) == {
        f"inertia.{kind}_kg_m2.{axis}" for kind in ("axis", "centre") for axis in TABLE_2_3
    }
    assert result.figures() == {}


def test_a_fixture_is_one_and_peaks_belong_to_mounts_that_swing() -> None:
    with pytest.raises(ConfigError, match="more than one swing of the empty fixture"):
        cfid.inertia.fit([*known(), KnownInertia("fixture", 1e-8), KnownInertia("fixture", 1e-8)], rig=RIG)
    with pytest.raises(ConfigError, match="no swing is about 'q'"):
        cfid.inertia.fit(known(), rig=RIG, peaks={"q": 9})
    with pytest.raises(ConfigError, match="above zero"):
        KnownInertia("x", -1e-5)


@pytest.mark.parametrize(
    ("off", "expected"),
    [(0.0, []), (5.0, ["testbody-apart"]), (-5.0, ["testbody-apart"]), (21.0, ["testbody-another-axis"])],
)
def test_a_test_body_far_off_its_drawing_is_doubtful_and_then_rejected(off: float, expected: list[str]) -> None:
    # The drawing's inertia about x is 6.410179e-06, and 3.4903e-05 about the axis of the mount (table 2.5).
    exact = cfid.inertia.fit_testbody([KnownInertia("x", 3.5e-5, 1e-8)], rig=RIG)
    calculated, measured, error = (
        exact.quantities[f"testbody.{key}.x"] for key in ("calculated_kg_m2", "measured_kg_m2", "error")
    )
    one_std = error.std * calculated.value
    at_drawing = 3.5e-5 - (measured.value - calculated.value)
    result = cfid.inertia.fit_testbody([KnownInertia("x", at_drawing + off * one_std, 1e-8)], rig=RIG)

    assert codes(result, "warning") + codes(result, "rejection") == expected
    assert result.accepted == ("testbody-another-axis" not in expected)
    assert set(result.without_rejected().quantities) >= {"testbody.calculated_kg_m2.x"}
    assert any("the drawing" in line for line in result.without_rejected().summary()) == result.accepted


G, MASS_KG, DISTANCE_M, INERTIA_KG_M2 = 9.81, 0.028, 0.0229, 3.2e-5  # the body's, about the axis
CUBE_KG, EDGE_M, OFF_M = 1.2e-3, 0.019, 0.002
EDGE = "edge_mm = 19.0\nedge_std_mm = 0.1\n"


@pytest.fixture
def lab(cfid: Cfid, tmp_path: Path) -> Path:
    """A campaign with a swing of a body on a cube of 19 mm, whose centre is 2 mm from the axis."""
    assert cfid("new", "lab", "--kind", "simulated").returncode == 0
    cube = CUBE_KG * ((EDGE_M**2 + EDGE_M**2) / 12 + OFF_M**2)
    moment, inertia = G * (MASS_KG * DISTANCE_M + CUBE_KG * OFF_M), INERTIA_KG_M2 + cube
    time_s, angle = swung(moment / inertia, release_rad=0.7, seconds=21, viscous=3e-7 / inertia, row_s=4e-3)
    written(tmp_path / "lab" / "swing.csv", time_s, angle + np.random.default_rng(1).normal(0, 2e-4, len(angle)))
    return tmp_path / "lab"


def swing_with(cfid: Cfid, lab: Path, edge: str) -> tuple[int, str, str]:
    fixture = f"\n[fixture]\nmass_kg = 0.0012\nmass_std_kg = 0.00002\ndistance_mm = 2.0\ndistance_std_mm = 0.1\n{edge}"
    (lab / "rig.toml").write_text((lab / "rig.toml").read_text() + fixture)
    body = ("--mass-kg", f"{MASS_KG}:1e-6", "--distance-m", f"{DISTANCE_M}:1e-6")
    ended = cfid("fit", "swing", "swing.csv", "--axis", "x", *body, "--gravity-mps2", "9.81", "--json", folder=lab)
    return ended.returncode, ended.stdout, ended.stderr


def test_the_inertia_of_a_cube_that_was_not_swung_alone_is_that_of_its_edge(cfid: Cfid, lab: Path) -> None:
    code, shown, _ = swing_with(cfid, lab, EDGE)
    found = json.loads(shown)["parameters"]["swing.axis_inertia_kg_m2"]

    assert code == 0
    assert found["value"] == pytest.approx(INERTIA_KG_M2, rel=5e-4)
    assert found["std"] < 1e-3 * INERTIA_KG_M2


def test_a_fixture_without_an_edge_or_a_swing_of_its_own_is_refused(cfid: Cfid, lab: Path) -> None:
    code, shown, told = swing_with(cfid, lab, "")

    assert (code, shown) == (2, "")
    assert "edge_mm" in told
