"""No row of a file is left out without a note, no column of numbers, and no figure lies among the data."""

import json
from pathlib import Path
from typing import Any

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


def test_a_last_point_without_a_newline_is_kept_and_a_cut_line_is_no_point(cfid: Cfid, tmp_path: Path) -> None:
    def fitted(text: str) -> Any:
        (tmp_path / "stand.csv").write_text(text)
        return json.loads(cfid("fit", "thrust", "--table", tmp_path / "stand.csv", "--json").stdout)

    whole, unended = fitted("\n".join([*STAND, ""])), fitted("\n".join(STAND))
    shorter, cut = fitted("\n".join([*STAND[:-1], ""])), fitted("\n".join([*STAND[:-1], "655"]))

    assert whole["parameters"] == unended["parameters"]
    assert len(unended["findings"]) == len(whole["findings"]) + 1  # a number that was cut may look plausible
    assert shorter["parameters"] == cut["parameters"]


def test_a_half_written_last_row_of_a_run_that_was_cut_is_left_out(cfid: Cfid, tmp_path: Path) -> None:
    run = write_run(tmp_path, climbed(STEPS), steps=STEPS, motors=[1, 3], hold_s=2.0, rest_s=1.0)
    path = run.device_file("crazyflie")
    whole = path.read_bytes()
    path.write_bytes(whole[:-3])  # the voltage 3.9 in place of 3.912
    (run.folder / RUN_FILE).write_text((run.folder / RUN_FILE).read_text().replace('"complete"', '"recording"'))
    shown = json.loads(cfid("show", run.folder, "--json").stdout)["parameters"]

    assert shown["recording.crazyflie.samples"]["value"] == whole.count(b"\n") - 2
