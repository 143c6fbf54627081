"""Winds in another unit, a wrong marker count and a wrong yaw are never accepted; sound forces are."""

from pathlib import Path

import numpy as np
import pytest

from cfid.drag import fit, read_forces
from cfid.records.plausibility import judged
from cfid.records.result import Result
from cfid.records.rig_file import thesis_rig

HEAD = "command,angle_deg,vx_mps,vy_mps,vz_mps,speed_sum_rad_s,fx_n,fy_n,fz_n"
COMMANDS = (10000, 20000, 30000, 37300, 40000, 50000)
WINDS = [(angle, speed) for angle in (0.0, 48.4, 77.9) for speed in (1.6, 2.4, 3.0, 4.0)]
TRUE = np.diag([-9.2e-7, -9.2e-7, -10.3e-7])
MISTAKES = {
    "sound": (1.0, 1.0, 0.0),
    "km/h": (3.6, 1.0, 0.0),
    "knots": (1.944, 1.0, 0.0),
    "one marker for two": (1.0, 2.0, 0.0),
    "yaw 0 for 45": (1.0, 1.0, -45.0),
}


def result(folder: Path, mistake: str, seed: int) -> Result:
    """Return the fit of forces that this module's own plant makes, with a mistake in the typed values."""
    wind, markers, yaw_deg = MISTAKES[mistake]
    rng = np.random.default_rng(seed)
    cosine, sine = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    rows = []
    for angle_deg, speed in WINDS:
        angle, azimuth = np.radians(angle_deg), np.radians(28.46)
        velocity = speed * np.array([np.sin(angle) * np.cos(azimuth), -np.sin(angle) * np.sin(azimuth), np.cos(angle)])
        true_velocity = velocity * (1 + 0.04 * rng.standard_normal())
        for command in COMMANDS:
            total = 4 * (0.0408 * command + 381)
            force = turn @ (total * TRUE @ true_velocity + 5e-4 * rng.standard_normal(3))
            rows.append([command, angle_deg, *(wind * velocity), markers * total, *force])
    path = folder / f"forces_{seed}.csv"
    path.write_text("\n".join([HEAD, *(",".join(f"{value:.8g}" for value in row) for row in rows)]) + "\n")
    return judged(fit(read_forces(path)), thesis_rig())


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.parametrize("campaigns", [2, pytest.param(50, marks=pytest.mark.slow)])
def test_a_mistake_is_never_accepted_and_sound_forces_are(tmp_path: Path, mistake: str, campaigns: int) -> None:
    accepted = [result(tmp_path, mistake, seed).accepted for seed in range(campaigns)]
    assert sum(accepted) == (campaigns if mistake == "sound" else 0)


def test_a_wind_faster_than_any_fan_is_in_another_unit(tmp_path: Path) -> None:
    text = "\n".join(
        [HEAD, *(f"{c},77.9,{v},0,1,8000,{-8e-3 * v * c / 4e5:.6g},0,-0.001" for c in COMMANDS for v in (30, 40))]
    )
    (tmp_path / "fast.csv").write_text(text + "\n")
    found = judged(fit(read_forces(tmp_path / "fast.csv")), None)
    assert any(one.code == "implausible-input" and "40.0 m/s: km/h?" in one.text for one in found.findings)
