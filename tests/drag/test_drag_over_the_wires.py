"""Wind from end to end: settings are recorded one by one from a simulated vehicle, then fitted."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.records.files import RUNS_FOLDER
from cfid.sim.propulsion import RotorTruth, WindTruth
from tests.lab import run_cfid
from tests.virtual_bench import bench_in

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


def blow(folder: Path, *words: object, wind: dict[str, Any] | None = None) -> str:
    """Run `cfid log wind` in a simulated wind until it ends; return what it printed."""
    typed = "".join(f"{shown_rpm(command):.0f}\n" for command in COMMANDS)
    with bench_in(folder, wind=wind or {}) as bench:
        pilot = bench.start("log", "wind", *words, *QUICK, typed=typed if wind else "")
        assert pilot.end() == 0, pilot.err
        assert not any(bench.motors)
    return pilot.out


@pytest.mark.slow
def test_winds_recorded_one_after_the_other_give_the_coefficients_that_act(tmp_path: Path) -> None:
    blow(tmp_path, "--wind", 0)
    for wind, (low, high) in WINDS:
        out = blow(tmp_path, "--angle", wind["angle_deg"], "--fan-voltage", 8, "--wind", f"{low},{high}", wind=wind)
    assert "8 are recorded" in out

    names = sorted(path.name for path in (tmp_path / RUNS_FOLDER).iterdir())
    ended = run_cfid(["fit", "drag", *names, "--json"], tmp_path)

    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)["parameters"]["drag.simple_kg_per_rad"]
    true = np.array(WindTruth().kg_per_rad)
    assert np.all(np.abs(np.array(found["value"]) - true) < 3 * np.array(found["std"]))
    assert np.all(np.array(found["std"]) < 0.12 * np.abs(true))
