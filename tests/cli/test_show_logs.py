"""`cfid show` of recordings of other programs: what was understood, and units, ranges and rates of the columns."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from tests.lab import Cfid, new_campaign
from tests.logs.usd_bytes import FIXED, POSE, bytes_of, rows, single, written

STAND = "Time (s),ESC signal (µs),Thrust (gf),Motor Optical Speed (RPM),Voltage (V)\n"


def test_a_log_of_the_sd_card_shows_its_columns_with_units_ranges_and_rate(cfid: Cfid, tmp_path: Path) -> None:
    path = written(tmp_path, single(1000))
    shown = cfid("show", path)
    assert shown.returncode == 0, shown.stderr
    assert "uSD-card log, version 2" in shown.stdout
    assert "acc.z in g" in shown.stdout
    assert (tmp_path / "LOG00_recording.png").is_file()

    numbers = json.loads(cfid("show", path, "--json").stdout)["parameters"]
    assert numbers["recording.samples"]["value"] == 1000
    assert numbers["recording.median_interval_s"]["value"] == pytest.approx(1e-3)
    assert numbers["recording.range.gyro.x"] == {
        "value": [0, pytest.approx(np.radians(999 / 8))],
        "std": None,
        "unit": "rad/s",
    }
    assert numbers["recording.range.acc.z"]["value"] == pytest.approx([-1.5 * 9.81] * 2)


def test_every_series_of_a_log_has_a_view(cfid: Cfid, tmp_path: Path) -> None:
    poses = [(3, 5_000_000 + 10_000 * at, (1, 0.5, at, -1, 2)) for at in range(20)]
    path = written(tmp_path, bytes_of([FIXED, POSE], [*rows(100), *poses]))
    numbers = json.loads(cfid("show", path, "--json").stdout)["parameters"]
    assert numbers["recording.fixedFrequency.samples"]["value"] == 100
    assert numbers["recording.estPosition.range.count"]["value"] == [0, 19]


def test_events_without_variables_are_shown_by_their_times_in_a_log_and_in_the_run_made_of_it(
    cfid: Cfid, tmp_path: Path
) -> None:
    path = written(tmp_path, bytes_of([FIXED, (7, "landed", ())], [*rows(400), (7, 5_100_500, ())]))
    campaign = new_campaign(tmp_path / "campaign").folder
    cfid("import", path, "--campaign", campaign)
    (run,) = (campaign / "runs").iterdir()
    of_run = cfid("show", run, "--campaign", campaign, "--json")
    assert of_run.returncode == 0, of_run.stderr
    for made in (cfid("show", path, "--json"), of_run):
        assert json.loads(made.stdout)["parameters"]["recording.landed.samples"]["value"] == 1


def test_a_log_as_a_table_and_a_matlab_file_are_recognised(cfid: Cfid, tmp_path: Path) -> None:
    client = tmp_path / "client.csv"
    client.write_text("Timestamp,pm.vbat\n" + "".join(f"{10 * at},{4 - at / 100}\n" for at in range(50)))
    shown = cfid("show", client)
    assert "CSV log of the Crazyflie client" in shown.stdout
    assert "pm.vbat in V" in shown.stdout

    other = tmp_path / "other.csv"
    other.write_text(",timestamp_us,u0\n" + "".join(f"{at},{10000 * at},{at / 4}\n" for at in range(50)))
    shown = cfid("show", other)
    assert "100 Hz" in shown.stdout
    assert "u0" in shown.stdout

    swing = tmp_path / "swing.mat"
    time_s = np.arange(300) / 100
    savemat(swing, {"t": time_s, "theta_rad": np.cos(5 * time_s)})
    shown = cfid("show", swing)
    assert shown.returncode == 0, shown.stderr


def test_a_table_of_a_stand_shows_commands_and_si_units(cfid: Cfid, tmp_path: Path) -> None:
    path = tmp_path / "stand.csv"
    path.write_text(STAND + "".join(f"{at / 10},{1000 + at},{at},{100 * at},12\n" for at in range(100)), "utf-8")
    shown = cfid("show", path)
    assert shown.returncode == 0, shown.stderr
    assert (tmp_path / "stand_recording.png").is_file()

    numbers = json.loads(cfid("show", path, "--json").stdout)["parameters"]
    assert numbers["recording.range.cmd"]["value"] == [0, pytest.approx(65535 * 99 / 1000, abs=1)]
    assert numbers["recording.range.thrust_n"]["value"] == [0, pytest.approx(99 * 9.80665e-3)]
    assert numbers["recording.range.thrust_n"]["unit"] == "N"
