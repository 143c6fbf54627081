"""The cube on the axis swings too: its edge gives its inertia where it was not swung alone."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.campaigns import Cfid

G, MASS_KG, DISTANCE_M, INERTIA_KG_M2 = 9.81, 0.028, 0.0229, 3.2e-5  # the body's, about the axis
CUBE_KG, EDGE_M, OFF_M = 1.2e-3, 0.019, 0.002
EDGE = "edge_mm = 19.0\nedge_std_mm = 0.1\n"


@pytest.fixture
def lab(cfid: Cfid, tmp_path: Path) -> Path:
    """A campaign with a swing of a body on a cube of 19 mm, whose centre is 2 mm from the axis."""
    assert cfid("new", "lab").returncode == 0
    cube = CUBE_KG * ((EDGE_M**2 + EDGE_M**2) / 12 + OFF_M**2)
    moment, inertia = G * (MASS_KG * DISTANCE_M + CUBE_KG * OFF_M), INERTIA_KG_M2 + cube
    t_s = np.arange(0, 20, 0.004)
    swing = solve_ivp(
        lambda _, y: [y[1], (-moment * np.sin(y[0]) - 3e-7 * y[1]) / inertia],
        (0, 20),
        [0.7, 0.0],
        t_eval=t_s,
        rtol=1e-10,
    )
    angle = np.concatenate([np.zeros(200), np.linspace(0, 0.7, 150), np.full(150, 0.7), swing.y[0]])
    angle += np.random.default_rng(1).normal(0, 2e-4, len(angle))
    rows = np.column_stack([0.004 * np.arange(len(angle)), angle])
    np.savetxt(tmp_path / "lab" / "swing.csv", rows, fmt="%.7g", delimiter=",", header="t_s,angle_rad", comments="")
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
