"""`cfid show` of a load cell, of any device of a run, and of recordings of other programs."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.recordings.wrench import AXES
from tests.lab import STARTED_S, Cfid, made_run, new_campaign, sentences
from tests.logs.usd_bytes import FIXED, POSE, bytes_of, rows, single, written

TIMING = ("samples", "duration_s", "median_interval_s", "longest_interval_s")
WRENCH = ("mean_n", "std_n", "mean_nm", "std_nm")
TIME_S = np.arange(3500) / 7000
FORCES = np.array([100_000, -200_000, 1_500_000, 1_000, 2_000, -3_000])
COUNTS = FORCES + np.random.default_rng(1).integers(-500, 501, (len(TIME_S), 6))
HEAD = "t,Fx_counts,Fy_counts,Fz_counts,Tx_counts,Ty_counts,Tz_counts"


def recorded(folder: Path, *, angle: bool = False, forces: bool = True) -> Path:
    time_s, counts = (TIME_S, COUNTS) if forces else (TIME_S[:0], COUNTS[:0])
    columns = {"loadcell": {"t": STARTED_S + time_s, **dict(zip(AXES, counts.T, strict=True))}}
    if angle:
        columns["encoder"] = {"t": STARTED_S + TIME_S[::7], "phi": np.arange(len(TIME_S[::7]))}
    facts_of = {"loadcell": {"counts_per_n": 1e6, "counts_per_nm": 1e6}, "encoder": {"counts_per_turn": 8192.0}}
    return made_run(folder, "loadcell", columns, facts_of=facts_of, simulated=True).folder


def bare(path: Path, values: np.ndarray[Any, Any] = COUNTS, form: str = "%d") -> Path:
    rows = np.column_stack([TIME_S, values])
    np.savetxt(path, rows, fmt=["%.6f"] + [form] * 6, delimiter=",", header=HEAD, comments="")
    return path


def shown(ended: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    assert ended.returncode == 0, ended.stderr
    result: dict[str, Any] = json.loads(ended.stdout)
    return result


def test_a_load_cell_run_is_told_in_newtons(cfid: Cfid, tmp_path: Path) -> None:
    result = shown(cfid("show", recorded(tmp_path), "--json"))
    content = result["parameters"]

    assert set(content) == {f"recording.{name}" for name in (*TIMING, *WRENCH)}
    assert content["recording.samples"]["value"] == len(TIME_S)
    assert content["recording.mean_n"]["value"] == pytest.approx([0.1, -0.2, 1.5], abs=1e-4)
    assert content["recording.mean_nm"]["value"] == pytest.approx([0.001, 0.002, -0.003], abs=1e-4)
    assert content["recording.std_n"]["value"] == pytest.approx([2.89e-4] * 3, rel=0.1)
    assert len(content["recording.std_nm"]["value"]) == 3
    assert sentences(result) == ["2026-11-21_080000_loadcell: recorded on the simulated rig."]


def test_a_bare_file_is_told_from_a_swing_by_its_columns(cfid: Cfid, tmp_path: Path) -> None:
    result = shown(cfid("show", bare(tmp_path / "fts.csv"), "--json"))
    assert "recording.mean_n" in result["parameters"]
    assert result["parameters"]["recording.mean_n"]["value"] == pytest.approx([0.1, -0.2, 1.5], abs=1e-4)

    swing = tmp_path / "swing.csv"
    swing.write_text("t_s,phi_rad\n" + "".join(f"{t:.6f},{np.sin(t):.6f}\n" for t in TIME_S))
    ended = shown(cfid("show", swing, "--json"))["parameters"]
    assert set(ended) == {f"recording.{name}" for name in (*TIMING, "range_rad")}


def test_a_run_with_both_devices_shows_both_and_says_once_what_holds_for_both(cfid: Cfid, tmp_path: Path) -> None:
    run = recorded(tmp_path, angle=True)
    assert cfid("show", run, "--out", tmp_path / "out").returncode == 0
    assert {path.stem for path in (tmp_path / "out").iterdir()} == {"encoder_recording", "loadcell_recording"}

    result = shown(cfid("show", run, "--json"))
    assert set(result["parameters"]) == {
        *(f"recording.encoder.{name}" for name in (*TIMING, "range_rad")),
        *(f"recording.loadcell.{name}" for name in (*TIMING, *WRENCH)),
    }
    assert [Path(source["path"]).stem for source in result["sources"]] == ["encoder", "loadcell"]
    assert len(sentences(result)) == 1


def test_a_device_that_recorded_nothing_does_not_hide_the_other(cfid: Cfid, tmp_path: Path) -> None:
    result = shown(cfid("show", recorded(tmp_path, angle=True, forces=False), "--json"))
    assert set(result["parameters"]) == {f"recording.{name}" for name in (*TIMING, "range_rad")}
    assert "loadcell.csv: has no row" in sentences(result)[-1]

    nothing = cfid("show", recorded(tmp_path / "other", forces=False), "--json")
    assert (nothing.returncode, nothing.stdout) == (4, "")
    assert "no row" in nothing.stderr


# Other devices


T = 1.7e9 + np.arange(5.0)
DEVICES = {
    "commands": {"m1": np.array([0, 9000, 0, 20000, 0]), "m2": np.zeros(5, int)},
    "crazyflie": {"vehicle_ms": 1000 * np.arange(5), "pm.vbat": np.linspace(4.1, 3.9, 5)},
    "crossings": {"thrust_rec": np.array([50000, 30000, 30001, 29999, 0])},
    "pings": {"rtt_s": np.array([0.05, 0.06, 0.07, 0.05, 0.06])},
}


def run_of(folder: Path, *devices: str) -> Path:
    columns = {name: {"t": T, **DEVICES[name]} for name in devices}
    return made_run(folder, "thrust", columns, simulated=True).folder


def test_devices_of_one_run_have_a_figure_and_numbers_each(cfid: Cfid, tmp_path: Path) -> None:
    run = run_of(tmp_path, "commands", "crazyflie")
    assert cfid("show", run).returncode == 0
    assert {path.name for path in run.glob("*.png")} == {"commands_recording.png", "crazyflie_recording.png"}

    numbers = json.loads(cfid("show", run, "--json").stdout)["parameters"]
    assert numbers["recording.crazyflie.mean.pm.vbat"]["value"] == pytest.approx(4.0)
    assert numbers["recording.commands.duration_s"]["value"] == 4


# Recordings of other programs


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
