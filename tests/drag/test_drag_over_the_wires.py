"""Wind from end to end: settings are recorded one by one over real wires from a simulated vehicle, then fitted."""

import json
import math
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cfid.records.files import RUNS_FOLDER
from cfid.sim.propulsion import RotorTruth, WindTruth
from tests.flying_in_a_folder import Pilot, bench_in

pytestmark = pytest.mark.usefixtures("in_time")

Cfid = Callable[..., subprocess.CompletedProcess[str]]

COMMANDS = (20000, 40000)
QUICK = ("--commands", "20000,40000", "--hold", 1.5, "--rest", 0.8, "--yes")
# The true wind, and the lowest and highest wind speed read.
WINDS = (
    ({"angle_deg": 0.0, "speed_mps": 3.1}, (3.0, 3.2)),
    ({"angle_deg": 48.4, "speed_mps": 2.9}, (2.85, 3.1)),
    ({"angle_deg": 77.9, "speed_mps": 3.6}, (3.4, 3.7)),
)


def shown_rpm(command: int) -> float:
    """Return the reading in rpm of a tachometer that sees two markers on a rotor."""
    return float(2 * 60 / math.tau * RotorTruth().steady_rad_per_s(np.array(command), volts=3.7))


def blow(folder: Path, *words: object, typed: str = "", wind: dict[str, float] | None = None) -> Pilot:
    """Run `cfid log wind` in a simulated wind until it ends."""
    with bench_in(folder, wind=wind or {}) as bench:
        pilot = bench.start("log", "wind", *words, stdin=subprocess.PIPE)
        pilot.process.communicate(typed.encode(), timeout=60)
        assert not any(bench.motors)
        return pilot


def told(pilot: Pilot) -> str:
    return f"{pilot.out}{pilot.err}"


@pytest.mark.slow
def test_winds_recorded_one_after_the_other_give_the_coefficients_that_act(tmp_path: Path, cfid: Cfid) -> None:
    pilot = blow(tmp_path, "--wind", 0, *QUICK)
    assert pilot.process.returncode == 0, told(pilot)
    typed = "".join(f"{shown_rpm(command):.0f}\n" for command in COMMANDS)
    for wind, (low, high) in WINDS:
        words = ("--angle", wind["angle_deg"], "--fan-voltage", 8, "--wind", f"{low},{high}")
        pilot = blow(tmp_path, *words, *QUICK, typed=typed, wind=wind)
        assert pilot.process.returncode == 0, told(pilot)
    assert "of the thesis' 112 runs 8 are recorded" in pilot.out

    ended = cfid("fit", "drag", *sorted(path.name for path in (tmp_path / RUNS_FOLDER).iterdir()), "--json")

    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)["parameters"]["drag.simple_kg_per_rad"]
    true = np.array(WindTruth().kg_per_rad)
    print(found, (np.array(found["value"]) - true) / np.array(found["std"]))
    assert np.all(np.abs(np.array(found["value"]) - true) < 3 * np.array(found["std"]))
    assert np.all(np.array(found["std"]) < 0.12 * np.abs(true))
