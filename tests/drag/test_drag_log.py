"""Recording in wind as its operator sees it: `cfid log wind`."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cfid.drag.command import wind_setting, wind_staircase
from cfid.drag.plan import THESIS_WINDS, missing_lines, missing_runs, thesis_plan
from cfid.errors import ConfigError
from cfid.motors.plan import missing
from cfid.records.run import Run, list_runs
from tests.lab import new_campaign, run_cfid
from tests.virtual_bench import Bench, bench_in

QUICK = ("--commands", "0,20000,40000", "--hold", 0.6, "--rest", 0.3)
IN_WIND = ("log", "wind", "--angle", 48.4, "--fan-voltage", 8, "--wind", "2.0,3.7", *QUICK)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_in(tmp_path, wind={"angle_deg": 48.4, "speed_mps": 2.9}) as bench:
        yield bench


def test_the_plan_is_that_of_section_4_4_2_and_missing_runs_are_a_line_a_setting() -> None:
    plan = thesis_plan()

    assert len(plan) == len(set(plan)) == 112
    assert np.mean([(wind.min_mps + wind.max_mps) / 2 for wind in THESIS_WINDS]) == pytest.approx(2.85)
    another = plan[5]._replace(command=12345)
    assert missing_runs([*plan, another, plan[0]]) == ()
    assert missing_runs([plan[5], plan[0], plan[0], another], plan[:7]) == (*plan[1:5], plan[6])
    assert missing_lines([*plan[:7], plan[8], *plan[14:]]) == [
        "106 of 112 runs of the thesis' plan are recorded. Missing:",
        "  0 deg, 5 V      0, 20000, 30000, 37300, 40000, 50000",
    ]


# Before any motor turns


@pytest.mark.parametrize(("words", "lines"), [("", 16 + 1), ("--angle 48.4 --fan-voltage 8 --wind 2.0,3.7", 16 + 4)])
def test_a_dry_run_says_the_wind_how_long_it_takes_and_what_the_thesis_plan_lacks(
    tmp_path: Path, words: str, lines: int
) -> None:
    new_campaign(tmp_path)
    ended = run_cfid(["log", "wind", *words.split(), "--dry-run"], tmp_path)

    assert ended.returncode == 0, ended.stderr
    said = ended.stdout.splitlines()
    assert sum("of the thesis" in line for line in said) == 1
    assert ("1:34 min" in ended.stdout and "48.4 degrees" in ended.stdout) == (words != "")
    assert len(said) >= lines


@pytest.mark.parametrize(
    ("given", "key"),
    [
        ({}, "--wind MIN,MAX"),
        *(({"wind": wind}, f"--wind {wind}: should be") for wind in ("3,2", "-1,2", "calm", "1,2,3", "nan")),
        ({"wind": "2000,3700"}, "--wind 2000,3700: should be"),
        ({"wind": "2,3"}, "--angle DEG"),
        ({"wind": "2,3", "angle": 200.0}, "--angle 200"),
        ({"wind": "2,3", "angle": 10.0, "azimuth_deg": float("nan")}, "--azimuth-deg nan"),
        ({"wind": "2,3", "angle": 10.0, "fan_voltage": -5.0}, "--fan-voltage -5"),
        ({"wind": "2,3", "angle": 10.0, "fan_voltage": 1e9}, "--fan-voltage 1e+09"),
    ],
)
def test_a_wind_that_is_not_whole_is_refused(given: dict[str, Any], key: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(key)):
        wind_setting(*(given.get(key) for key in ("wind", "angle", "fan_voltage", "azimuth_deg")))


@pytest.mark.parametrize("commands", ["", "0", "70000", "10000,x", "-1"])
def test_commands_that_are_none_are_refused(commands: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(f"--commands {commands}")):
        wind_staircase(commands)


def test_without_a_confirmation_nothing_turns(bench: Bench) -> None:
    pilot = bench.start(*IN_WIND, typed="n\n")

    assert pilot.end() == 2
    assert "up to 40000" in pilot.err
    assert "not confirmed" in pilot.err
    assert len(bench.history) == 1


# Recording


def test_the_operator_confirms_types_the_tachometer_and_reads_what_is_missing(bench: Bench) -> None:
    pilot = bench.start(*IN_WIND, "--json", typed="y\n22000\n\n")

    assert pilot.end() == 0, pilot.err
    assert not any(bench.motors)
    content, run = json.loads(pilot.out), bench.run()
    assert content["parameters"]["wind.missing_runs"]["value"] == 112 - 3
    requested = {"angle_deg": 48.4, "fan_v": 8.0, "wind_min_mps": 2.0, "wind_max_mps": 3.7}
    assert requested.items() <= run.header.requested.items()
    typed = pd.read_csv(run.device_file("readings"))
    assert typed[["command", "rpm"]].to_numpy().tolist() == [[20000, 22000]]
    commands = pd.read_csv(run.device_file("commands"))[["m1", "m2", "m3", "m4"]].to_numpy()
    assert {tuple(row) for row in commands.tolist()} == {(command,) * 4 for command in (0, 20000, 40000)}


@pytest.mark.parametrize("named", [(), ("--tachometer", "none")])
def test_an_interrupted_wind_is_resumed_in_its_own_wind(bench: Bench, named: tuple[str, ...]) -> None:
    first = bench.start(*IN_WIND, "--tachometer", "none", "--yes")
    first.wait_until(lambda: 40000 in bench.motors)
    first.go_on_for(0.2)
    first.request_end()
    assert first.end() == 0, first.err
    assert not any(bench.motors)
    assert bench.run().header.state == "interrupted"
    folder = bench.run().folder

    assert bench.start("log", "wind", "--wind", 0, "--resume", folder, "--yes").end() == 2
    second = bench.start("log", "wind", "--resume", folder, *named, "--yes")
    assert second.end() == 0, second.err
    resumed = [run.header for run in list_runs(bench.folder / "runs") if isinstance(run, Run)][-1]
    assert resumed.requested["steps"] == [40000]
    assert resumed.requested["angle_deg"] == 48.4
    assert "readings" not in resumed.devices


def test_a_command_whose_reading_was_not_typed_is_done_again(bench: Bench) -> None:
    pilot = bench.start(*IN_WIND, "--yes", script=True)
    pilot.type("22000\n")
    pilot.wait_until(lambda: 40000 in bench.motors)
    pilot.go_on_for(0.9)  # until the command has been held to its end
    pilot.request_end()
    assert pilot.end() == 0, pilot.err

    steps = missing(bench.run().folder, kind="wind").steps
    assert 40000 in steps
    assert 20000 not in steps


def test_nonsense_typed_for_a_reading_ends_the_run_and_stops_the_motors(bench: Bench) -> None:
    pilot = bench.start(*IN_WIND, "--yes", typed="fast\n")

    assert pilot.end() == 2
    assert not any(bench.motors)
    assert max(max(motors) for _, motors in bench.history) == 20000
