"""Swings of other programs' files: their units, their dates, and a frequency of known truth."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import cfid.swing
from cfid.records.rig_file import load_rig

Array = npt.NDArray[np.float64]
Cfid = Callable[..., subprocess.CompletedProcess[str]]

FREQUENCY = "swing.natural_frequency_squared_s2"
W = 60.0
EPOCH_S = 1_600_000_000.0
RIG = """
[vehicle]
name = "threads"
mass_kg = 0.03
centre_of_mass_mm = [0.0, 0.0, 0.0]

[mounts.x]
point_mm = [0.0, 32.25, 0.0]
direction = [1, 0, 0]
"""


def pendulum(rate_hz: float, *, duration_s: float = 14.0) -> tuple[Array, Array, Array]:
    """Return times, angle and speed of a pendulum at rest, held, and released from 40 degrees, by small steps."""
    step_s, angle, speed = 2e-4, np.radians(40), 0.0
    still, rows = round(1.5 * rate_hz), round(duration_s * rate_hz)
    time_s = np.arange(rows) / rate_hz
    fine = np.empty((round(duration_s / step_s) + 2, 2))
    for at in range(len(fine)):
        fine[at] = angle, speed
        speed += step_s * (-W * np.sin(angle) - 0.03 * speed)
        angle += step_s * speed
    places = np.clip(np.rint((time_s - time_s[still]) / step_s).astype(int), 0, None)
    angles, speeds = fine[places].T
    speeds[:still] = 0
    return time_s, angles, speeds


def gyro_text(rate_hz: float, head: str, per_rad: float) -> str:
    time_s, _, speed = pendulum(rate_hz)
    noise = np.radians(0.2) * np.random.default_rng(3).standard_normal((len(time_s), 3))
    rates = per_rad * (noise + np.outer(speed, (1.0, 0.0, 0.0)))
    rows = (f"{t:.5f},{x:.4f},{y:.4f},{z:.4f}" for t, (x, y, z) in zip(time_s, rates, strict=True))
    return "\n".join([head, *rows, ""])


def lab(folder: Path) -> Path:
    (folder / "lab").mkdir()
    (folder / "lab" / "rig.toml").write_text(RIG)
    return folder / "lab"


@pytest.mark.parametrize("rate_hz", [24.0, 25.0, 200.0])
@pytest.mark.parametrize(
    ("head", "per_rad"),
    [
        ("timestamp [s],gyro.x,gyro.y,gyro.z", 180 / np.pi),
        ("timestamp [s],gyro.x [rad/s],gyro.y [rad/s],gyro.z [rad/s]", 1.0),
        ("timestamp [s],gyro.x [deg/s],gyro.y [deg/s],gyro.z [deg/s]", 180 / np.pi),
    ],
)
def test_a_log_of_a_gyro_gives_the_frequency_of_its_swing(
    tmp_path: Path, rate_hz: float, head: str, per_rad: float
) -> None:
    """At 24 Hz, milliseconds of a computer look like those of a card's slow clock."""
    path = tmp_path / "swing.csv"
    path.write_text(gyro_text(rate_hz, head, per_rad))
    result = cfid.swing.fit(path, axis="x", rig=load_rig(lab(tmp_path) / "rig.toml"))
    frequency = result.quantities[FREQUENCY]
    assert result.accepted
    assert abs(frequency.value - W) < 3 * (frequency.std or 0.0) < 0.2


def test_an_imported_gyro_in_radians_is_a_swing(cfid: Cfid, tmp_path: Path) -> None:
    """Previously it was imported, and then no encoder recording."""
    (tmp_path / "swing.csv").write_text(
        gyro_text(200.0, "timestamp [s],gyro.x [rad/s],gyro.y [rad/s],gyro.z [rad/s]", 1.0)
    )
    campaign = lab(tmp_path)
    imported = cfid("import", tmp_path / "swing.csv", "--axis", "x", "--campaign", campaign)
    assert imported.returncode == 0, imported.stderr
    (run,) = (campaign / "runs").iterdir()
    fitted = cfid("fit", "swing", run, "--campaign", campaign, "--json", "--no-figures")
    assert fitted.returncode == 0, fitted.stderr
    frequency = json.loads(fitted.stdout)["parameters"][FREQUENCY]
    assert abs(frequency["value"] - W) < 3 * frequency["std"]


def test_an_imported_angle_keeps_its_date(cfid: Cfid, tmp_path: Path) -> None:
    """Previously the run was named after the time of the import, and its times began at zero."""
    time_s, angle, _ = pendulum(100.0)
    rows = "".join(f"{EPOCH_S + t:.3f},{a:.6f}\n" for t, a in zip(time_s, angle, strict=True))
    (tmp_path / "swing.csv").write_text(f"t,phi\n{rows}")
    campaign = lab(tmp_path)
    asked = cfid("import", tmp_path / "swing.csv", "--axis", "x", "--campaign", campaign)
    assert asked.returncode == 2
    assert "--unit phi=deg" in asked.stderr
    imported = cfid("import", tmp_path / "swing.csv", "--axis", "x", "--unit", "phi=rad", "--campaign", campaign)
    assert imported.returncode == 0, imported.stderr
    (run,) = (campaign / "runs").iterdir()
    assert run.name.startswith("2020-09-13")
    fitted = cfid("fit", "swing", run, "--campaign", campaign, "--json", "--no-figures")
    assert fitted.returncode == 0, fitted.stderr
    frequency = json.loads(fitted.stdout)["parameters"][FREQUENCY]
    assert abs(frequency["value"] - W) < 3 * frequency["std"]
    assert float((run / "encoder.csv").read_text().splitlines()[1].split(",")[0]) == pytest.approx(EPOCH_S)
