"""No row of a file is left out without a note, no column of numbers, and no figure lies among the data."""

import json
from pathlib import Path

import numpy as np
import pytest

from cfid.records.files import RUN_FILE
from tests.lab import Cfid
from tests.motors.stand_in_a_folder import climbed, write_run

STEPS = tuple(range(0, 60001, 10000))
STAND = ["cmd,thrust_n", "10000,0.01", "20000,0.03", "30000,0.05", "40000,0.08", "50000,0.11", "65535,0.16"]


def damage(path: Path) -> None:
    """Put three lines that are no rows among those of a long file."""
    lines = path.read_text().splitlines()
    lines[300:303] = ["1.2.3", "hello", lines[302].split(",")[0]]
    path.write_text("\n".join(lines) + "\n")


def test_damaged_lines_of_a_vehicles_log_are_reported_by_the_fit_that_leaves_them_out(
    cfid: Cfid, tmp_path: Path
) -> None:
    record = climbed(STEPS, hold_s=3.0)
    run = write_run(tmp_path, record, steps=STEPS, motors=[1, 3], hold_s=3.0, rest_s=1.0)
    assert len(record.tick_s) > 1500
    sound = json.loads(cfid("fit", "thrust", run.folder, "--json").stdout)["findings"]
    damage(run.device_file("crazyflie"))
    damaged = json.loads(cfid("fit", "thrust", run.folder, "--json").stdout)["findings"]

    left_out = {one["code"]: one["text"] for one in damaged if "crazyflie.csv" in str(one)}
    assert left_out.keys() == {"lines-left-out", "rows-without-number"}
    assert "line 301" in left_out["lines-left-out"] or "line 302" in left_out["lines-left-out"]
    assert not any("crazyflie.csv" in str(one) for one in sound)


@pytest.mark.parametrize("rows", [5_000, 200_000])
def test_a_column_of_numbers_is_kept_though_its_first_half_is_empty(cfid: Cfid, tmp_path: Path, rows: int) -> None:
    half = rows // 2
    late = ["" if at < half else f"{0.001 * at:.3f}" for at in range(rows)]
    lines = (f"{at / 1000},{at % 97}.25,{late[at]}" for at in range(rows))
    (tmp_path / "log.csv").write_text("\n".join(["t_s,gyro.x,late", *lines]) + "\n")
    shown = json.loads(cfid("show", tmp_path / "log.csv", "--json").stdout)["parameters"]

    assert shown["recording.samples"]["value"] == rows
    assert shown["recording.range.late"]["value"] == pytest.approx([0.001 * half, 0.001 * (rows - 1)])


def test_the_last_point_of_a_table_without_a_final_newline_is_kept(cfid: Cfid, tmp_path: Path) -> None:
    maps = []
    for name, end in (("ended", "\n"), ("unended", "")):
        (tmp_path / f"{name}.csv").write_text("\n".join(STAND) + end)
        maps.append(json.loads(cfid("fit", "thrust", "--table", tmp_path / f"{name}.csv", "--json").stdout))
    ended, unended = (found["parameters"]["motor.max_thrust_n"]["value"] for found in maps)

    assert unended == ended == pytest.approx(0.16, rel=0.05)
    assert len(maps[1]["findings"]) == len(maps[0]["findings"]) + 1  # a number that was cut may look plausible


def test_a_last_line_that_is_cut_is_no_point(cfid: Cfid, tmp_path: Path) -> None:
    found = []
    for name, end in (("without", ""), ("cut", "\n655")):
        (tmp_path / f"{name}.csv").write_text("\n".join(STAND[:-1]) + (end or "\n"))
        found.append(json.loads(cfid("fit", "thrust", "--table", tmp_path / f"{name}.csv", "--json").stdout))
    assert found[0]["parameters"] == found[1]["parameters"]


def test_a_half_written_last_row_of_a_run_that_was_cut_is_left_out(cfid: Cfid, tmp_path: Path) -> None:
    run = write_run(tmp_path, climbed(STEPS), steps=STEPS, motors=[1, 3], hold_s=2.0, rest_s=1.0)
    path = run.device_file("crazyflie")
    whole = path.read_bytes()
    path.write_bytes(whole[:-3])  # the voltage 3.9 in place of 3.912
    (run.folder / RUN_FILE).write_text((run.folder / RUN_FILE).read_text().replace('"complete"', '"recording"'))
    shown = json.loads(cfid("show", run.folder, "--json").stdout)["parameters"]

    assert shown["recording.crazyflie.samples"]["value"] == whole.count(b"\n") - 2


def test_figures_outside_a_campaign_are_drawn_on_request_into_the_current_folder(cfid: Cfid, tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    (data / "stand.csv").write_text("\n".join(STAND) + "\n")
    t = np.arange(0, 20, 0.01)
    swing = np.column_stack([t, 0.3 * np.exp(-0.02 * t) * np.cos(5 * t)])
    np.savetxt(data / "swing.csv", swing, delimiter=",", header="t_s,phi_rad", comments="", fmt="%.7f")
    before, here = sorted(data.iterdir()), sorted(tmp_path.iterdir())
    commands = (("fit", "thrust", "--table", data / "stand.csv"), ("fit", "swing", data / "swing.csv"))
    for command in commands:
        assert cfid(*command).returncode == 0
    assert sorted(data.iterdir()) == before
    assert sorted(tmp_path.iterdir()) == here

    for command in commands:
        assert cfid(*command, "--figures").returncode == 0
    assert sorted(data.iterdir()) == before
    assert len(list(tmp_path.glob("*.png"))) >= len(commands)
