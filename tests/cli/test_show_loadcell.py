"""`cfid show` of a load cell, of a bare file of either kind, and of a run with both devices."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.recordings.wrench import AXES
from tests.lab import STARTED_S, Cfid, made_run, sentences

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

    terminal = cfid("show", run, "--terminal").stdout
    assert terminal.index("angle, degrees") < terminal.index("Fz, N")


def test_a_device_that_recorded_nothing_does_not_hide_the_other(cfid: Cfid, tmp_path: Path) -> None:
    result = shown(cfid("show", recorded(tmp_path, angle=True, forces=False), "--json"))
    assert set(result["parameters"]) == {f"recording.{name}" for name in (*TIMING, "range_rad")}
    assert "loadcell.csv: has no row" in sentences(result)[-1]

    nothing = cfid("show", recorded(tmp_path / "other", forces=False), "--json")
    assert (nothing.returncode, nothing.stdout) == (4, "")
    assert "no row" in nothing.stderr
