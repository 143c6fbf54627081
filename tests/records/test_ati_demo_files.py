"""Files of ATI's demo program state the scale and the rate of their counts above the columns, and are read by them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.campaigns import Cfid

LOAD = np.array([0.047, -0.09, -0.49, 1.1e-4, -2.2e-4, 5e-5])  # N and N m
LBF_N, INCH_M = 4.4482216152605, 0.0254
SCALES = {  # units, and how many N and N m one is
    ("N", "Nm"): (1.0, 1.0),
    ("lbf", "lbf-in"): (LBF_N, LBF_N * INCH_M),
    ("lbf", "lbf-ft"): (LBF_N, LBF_N * INCH_M * 12),
    ("N", "Nmm"): (1.0, 1e-3),
    ("kgf", "kgf-cm"): (9.80665, 0.0980665),
}


def written(folder: Path, force: str, torque: str, per_force: object, per_torque: object, counts: Any) -> Path:
    """Write 500 rows at 500 Hz with a noise of one count, as the manual of the box (9620-05, table 5.1) shows them."""
    rng = np.random.default_rng(2)
    rows = np.rint(counts + rng.normal(0, 1, (500, 6))).astype(int)
    head = [
        "Start Time: 3/15/21 3:04 PM",
        "RDT Sample Rate: 500",
        '"PLEASE NOTE: The sample rate is read from the Net F/T when the program starts."',
        f"Force Units: {force}",
        f"Counts per Unit Force: {per_force}",
        f"Torque Units: {torque}",
        f"Counts per Unit Torque: {per_torque}",
        "Status (hex), RDT Sequence, F/T Sequence, Fx, Fy, Fz, Tx, Ty, Tz, Time",
    ]
    lines = [
        ",".join(f'"{value}"' for value in ("0", at + 1, 5000000 + at, *row, "Mar 15, 2021 3:04:05 PM"))
        for at, row in enumerate(rows.tolist())
    ]
    path = folder / "demo.csv"
    path.write_bytes("\r\n".join([*head, *lines, ""]).encode())
    return path


def shown(cfid: Cfid, path: Path, *options: object) -> tuple[np.ndarray[Any, Any], float]:
    answer = cfid("show", path, "--json", "--no-figures", *options)
    assert answer.returncode == 0, answer.stderr
    parameters = json.loads(answer.stdout)["parameters"]
    load = [*parameters["recording.mean_n"]["value"], *parameters["recording.mean_nm"]["value"]]
    return np.array(load), parameters["recording.median_interval_s"]["value"]


@pytest.mark.parametrize("units", SCALES)
def test_counts_are_read_in_the_units_and_at_the_rate_that_the_file_states(
    cfid: Cfid, tmp_path: Path, units: tuple[str, str]
) -> None:
    unit = np.repeat(SCALES[units], 3)
    per_unit = np.repeat([1e5, 1e6], 3)
    path = written(tmp_path, *units, 100000.0, 1000000.0, LOAD / unit * per_unit)
    load, interval_s = shown(cfid, path)
    np.testing.assert_allclose(load, LOAD, rtol=0, atol=0.2 * float(np.max(unit / per_unit)))
    assert interval_s == pytest.approx(0.002, rel=1e-9)


@pytest.mark.parametrize(
    ("force", "torque", "per_force", "per_torque", "option"),
    [
        ("stone", "Nm", 1000.0, 1000.0, "--counts-per-n"),
        ("N", "stone-ft", 1000.0, 1000.0, "--counts-per-nm"),
        ("", "Nm", 1000.0, 1000.0, "--counts-per-n"),
        ("N", "Nm", "n/a", 1000.0, "--counts-per-n"),
        ("N", "Nm", 1000.0, 0, "--counts-per-nm"),
    ],
)
def test_a_unit_or_scale_that_is_not_known_is_a_question_that_an_option_answers(
    cfid: Cfid, tmp_path: Path, force: str, torque: str, per_force: object, per_torque: object, option: str
) -> None:
    path = written(tmp_path, force, torque, per_force, per_torque, 1000 * np.arange(1, 7))
    asked = cfid("show", path)
    assert asked.returncode == 2
    assert f"give {option}." in " ".join(asked.stderr.split())
