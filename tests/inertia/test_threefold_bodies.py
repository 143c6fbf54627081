"""A body with a threefold axis swings alike about three horizontal mounts, and its matrix is accepted."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cfid.records.rig_file import thesis_rig
from tests.campaigns import Cfid

TRUTH = np.diag([16.6e-6, 16.6e-6, 29.2e-6])
MASS_KG, DISTANCE_M, G = 0.028, 0.0229, 9.81
HORIZONTAL = {
    name: np.array([np.cos(a), np.sin(a), 0.0]) for name, a in zip("abc", np.radians([0, 60, 120]), strict=True)
}
DIRECTIONS = {
    **HORIZONTAL,
    "d": np.array([0.0, 0.0, 1.0]),
    "e": np.array([1.0, 0.0, 1.0]),
    "f": np.array([0.0, 1.0, 1.0]),
}


def write_swing(path: Path, inertia_kg_m2: float, seed: int) -> None:
    moment, t_s = MASS_KG * G * DISTANCE_M, np.arange(0, 20, 0.004)
    swing = solve_ivp(
        lambda _, y: [y[1], (-moment * np.sin(y[0]) - 3e-7 * y[1]) / inertia_kg_m2],
        (0, 20),
        [0.8, 0],
        t_eval=t_s,
        rtol=1e-10,
    )
    angle = np.concatenate([np.zeros(200), np.linspace(0, 0.8, 150), np.full(150, 0.8), swing.y[0]])
    angle += np.random.default_rng(seed).normal(0, 2e-4, len(angle))
    rows = np.column_stack([0.004 * np.arange(len(angle)), angle])
    np.savetxt(path, rows, fmt="%.7g", delimiter=",", header="t_s,angle_rad", comments="")


def test_three_alike_mounts_of_a_body_with_a_threefold_axis_are_accepted(cfid: Cfid, tmp_path: Path) -> None:
    assert cfid("new", "lab").returncode == 0
    lab, centre_m = tmp_path / "lab", 1e-3 * np.array(thesis_rig().vehicle.centre_of_mass_mm)
    rig = (lab / "rig.toml").read_text().replace('platform = "cf2"', 'platform = "other"')
    words = []
    for seed, (name, direction) in enumerate(DIRECTIONS.items()):
        unit = direction / np.linalg.norm(direction)
        aside = np.cross(unit, [0.3, 0.5, 0.1])
        point_mm = 1e3 * (centre_m + DISTANCE_M * aside / np.linalg.norm(aside))
        rig += f"\n[mounts.{name}]\npoint_mm = {point_mm.tolist()}\ndirection = {direction.tolist()}\n"
        write_swing(lab / f"{name}.csv", float(unit @ TRUTH @ unit) + MASS_KG * DISTANCE_M**2, seed)
        words.append(f"{name}={name}.csv")
    (lab / "rig.toml").write_text(rig)

    ended = cfid("fit", "inertia", *words, "--json", folder=lab)
    assert ended.returncode == 0
    found = json.loads(ended.stdout)["parameters"]["inertia.matrix_kg_m2"]
    assert np.array(found["value"]) == pytest.approx(TRUTH, abs=3e-8)
