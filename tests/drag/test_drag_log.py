"""Recording in wind as its operator sees it: `cfid log wind`."""

import json
import re
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cfid.drag.wind.command import SweepOptions, WindOptions
from cfid.errors import ConfigError
from cfid.motors.missing_steps import missing
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text
from cfid.records.run import list_runs, read_run
from cfid.sim.loadcell import LoadCellTruth
from cfid.sim.propulsion import WindTruth
from tests.flying_in_a_folder import Bench, bench_in

pytestmark = pytest.mark.usefixtures("in_time")

Cfid = Callable[..., subprocess.CompletedProcess[str]]

QUICK = ("--commands", "0,20000,40000", "--hold", 0.6, "--rest", 0.3)
IN_WIND = ("log", "wind", "--angle", 48.4, "--fan-voltage", 8, "--wind", "2.0,3.7", *QUICK)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_in(tmp_path, wind={"angle_deg": 48.4, "speed_mps": 2.9}) as bench:
        yield bench


# Before any motor turns


def test_a_dry_run_without_a_wind_says_how_long_one_takes_and_what_is_missing(cfid: Cfid, tmp_path: Path) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    ended = cfid("log", "wind", "--dry-run")

    assert ended.returncode == 0
    begun = ended.stdout.index("of the thesis")
    assert len(ended.stdout[begun:].splitlines()) == 1 + 16


def test_a_dry_run_says_the_wind_how_long_it_takes_and_what_the_thesis_plan_lacks(cfid: Cfid, tmp_path: Path) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    ended = cfid("log", "wind", "--angle", 48.4, "--fan-voltage", 8, "--wind", "2.0,3.7", "--dry-run")

    assert ended.returncode == 0, ended.stderr
    lines = ended.stdout.splitlines()
    assert lines[0] == "wind of 2 to 3.7 m/s at 48.4 degrees, fan at 8 V"
    assert "7 commands from 0 to 50000 on motors 1, 2, 3, 4, 10 s each with 3 s of pause: 1:34 min" in lines[1]
    assert lines[2] == "and as long as it takes to read a tachometer 6 times"
    assert lines[3] == "of the thesis' 112 runs 0 are recorded, missing are:"
    assert len(lines) == 4 + 16
    assert lines[4].split() == ["no", "wind", "all", "commands"]


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({}, "give --wind MIN,MAX"),
        ({"wind": "3,2"}, "--wind 3,2: should be the lowest and the highest speed"),
        ({"wind": "-1,2"}, "--wind -1,2: should be"),
        ({"wind": "calm"}, "--wind calm: should be"),
        ({"wind": "1,2,3"}, "--wind 1,2,3: should be"),
        ({"wind": "nan"}, "--wind nan: should be"),
        ({"wind": "2000,3700"}, "--wind 2000,3700: should be"),
        ({"wind": "2,3"}, "--wind 2,3: give --angle DEG too"),
        ({"wind": "2,3", "angle": 200.0}, "--angle 200: has to be from 0, straight above"),
        ({"wind": "2,3", "angle": 10.0, "azimuth_rad": float("nan")}, "--azimuth-rad nan: has to be a number"),
        ({"wind": "2,3", "angle": 10.0, "fan_voltage": -5.0}, "--fan-voltage -5: has to be above zero"),
        ({"wind": "2,3", "angle": 10.0, "fan_voltage": 1e9}, "--fan-voltage 1e+09: has to be 1000 at most"),
    ],
)
def test_a_wind_that_is_not_whole_is_told(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(sentence)):
        WindOptions(**given).setting()


def test_one_reading_of_the_wind_is_both_and_references_have_no_angle() -> None:
    assert WindOptions(wind="2.25", angle=0.0).setting().to_run()["wind_min_mps"] == 2.25
    assert "angle_deg" not in WindOptions(wind="0", angle=48.4).setting().to_run()


@pytest.mark.parametrize("commands", ["", "0", "70000", "10000,x", "-1"])
def test_commands_that_are_none_are_told(commands: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(f"--commands {commands}")):
        SweepOptions(commands=commands).staircase()


def test_without_a_confirmation_nothing_turns(bench: Bench) -> None:
    pilot = bench.start(*IN_WIND, stdin=subprocess.PIPE)
    pilot.process.communicate(b"n\n")

    assert pilot.process.returncode == 2
    lasting = r"for \d:\d\d min \(about \d+ MB; [\d.]+ GB are free\)"
    battery = r"battery \d\.\d\d V: .* at this plan's currents"
    turning = rf"motors 1, 2, 3, 4 will turn at commands up to 40000, {lasting}; {battery}\."
    question = rf"{turning} Is the vehicle fastened and everyone"
    assert re.search(question, pilot.err)
    assert "not confirmed: no motor was started." in pilot.err
    assert len(bench.history) == 1


# Recording


def test_the_operator_confirms_types_the_tachometer_and_reads_what_is_missing(bench: Bench) -> None:
    pilot = bench.start(*IN_WIND, "--json", stdin=subprocess.PIPE)
    pilot.process.communicate(b"y\n22000\n\n", timeout=30)

    assert pilot.process.returncode == 0, pilot.err
    assert not any(bench.motors)
    content, run = json.loads(pilot.out), bench.run()
    assert content["parameters"]["wind.missing_runs"]["value"] == 112 - 3
    requested = run.header.requested
    assert (requested["angle_deg"], requested["fan_v"], requested["wind_min_mps"], requested["wind_max_mps"]) == (
        48.4,
        8.0,
        2.0,
        3.7,
    )
    typed = pd.read_csv(run.device_file("readings"))
    assert typed[["command", "rpm"]].to_numpy().tolist() == [[20000, 22000]]
    commands = pd.read_csv(run.device_file("commands"))[["m1", "m2", "m3", "m4"]].to_numpy()
    assert {tuple(row) for row in commands.tolist()} == {(command,) * 4 for command in (0, 20000, 40000)}


def test_what_the_wind_does_to_the_body_is_in_the_tare(tmp_path: Path) -> None:
    wind = {"angle_deg": 48.4, "speed_mps": 2.9, "body_kg_per_m": -3e-3}
    with bench_in(tmp_path, wind=wind) as bench:
        pilot = bench.start("log", "wind", "--wind", 0, *QUICK, "--yes")
        assert pilot.end() == 0, pilot.err
        force = pd.read_csv(bench.run().device_file("loadcell"))[["Fx", "Fy"]].to_numpy() / 1e6

    body = WindTruth.model_validate(wind).body_n[:2]
    assert np.linalg.norm(body) > 0.015
    assert force[:150].mean(axis=0) - LoadCellTruth().bias[:2] == pytest.approx(body, abs=0.004)


@pytest.mark.parametrize("named", [(), pytest.param(("--tachometer", "none"), marks=pytest.mark.slow)])
def test_an_interrupted_wind_is_resumed_in_its_own_wind(bench: Bench, named: tuple[str, ...]) -> None:
    first = bench.start(*IN_WIND, "--tachometer", "none", "--yes")
    bench.wait_until(lambda: 40000 in bench.motors or first.process.poll() is not None, first)
    time.sleep(0.2)
    first.send(signal.SIGINT)
    assert first.end() == 0, first.err
    assert not any(bench.motors)
    assert bench.run().header.state == "interrupted"

    refused = bench.start("log", "wind", "--wind", 0, "--resume", bench.run().folder, "--yes")
    assert refused.end() == 2
    assert "leave out its options" in refused.err

    second = bench.start("log", "wind", "--resume", bench.run().folder, *named, "--yes")
    assert second.end() == 0, second.err
    runs = list_runs(bench.folder / "runs")
    resumed = [read_run(run.folder).header for run in runs if not isinstance(run, Exception)][-1]
    assert resumed.requested["steps"] == [40000]
    assert resumed.requested["angle_deg"] == 48.4
    assert "readings" not in resumed.devices
    assert "48.4 deg, 8 V   10000, 30000, 37300, 50000" in second.out


def test_a_command_whose_reading_was_not_typed_is_done_again(bench: Bench) -> None:
    pilot = bench.start(*IN_WIND, "--yes", stdin=subprocess.PIPE)
    assert pilot.process.stdin is not None
    pilot.process.stdin.write(b"22000\n")
    pilot.process.stdin.flush()
    bench.wait_until(lambda: 40000 in bench.motors or pilot.process.poll() is not None, pilot)
    time.sleep(0.9)  # until the command has been held to its end
    pilot.send(signal.SIGINT)
    assert pilot.end() == 0, pilot.err

    assert 40000 in missing(bench.run().folder, kind="wind").steps
    assert 20000 not in missing(bench.run().folder, kind="wind").steps


def test_nonsense_typed_for_a_reading_ends_the_run_and_stops_the_motors(bench: Bench) -> None:
    pilot = bench.start(*IN_WIND, "--yes", stdin=subprocess.PIPE)
    pilot.process.communicate(b"fast\n", timeout=30)

    assert pilot.process.returncode == 2
    assert "'fast' is not a reading" in pilot.err
    assert not any(bench.motors)
