"""`cfid show` of recordings other than angles and forces: commands, battery, crossings, pings, readings."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.lab import Cfid, made_run

T = 1.7e9 + np.arange(5.0)
DEVICES = {
    "commands": {"m1": np.array([0, 9000, 0, 20000, 0]), "m2": np.zeros(5, int)},
    "crazyflie": {"vehicle_ms": 1000 * np.arange(5), "pm.vbat": np.linspace(4.1, 3.9, 5)},
    "crossings": {"thrust_rec": np.array([50000, 30000, 30001, 29999, 0])},
    "pings": {"rtt_s": np.array([0.05, 0.06, 0.07, 0.05, 0.06])},
}


def recorded(folder: Path, *devices: str) -> Path:
    columns = {name: {"t": T, **DEVICES[name]} for name in devices}
    return made_run(folder, "thrust", columns, simulated=True).folder


@pytest.mark.parametrize("device", ["crossings", "pings"])
def test_any_device_is_shown_alone(cfid: Cfid, tmp_path: Path, device: str) -> None:
    run = recorded(tmp_path, device)
    ended = cfid("show", run, "--no-figures")

    assert ended.returncode == 0, ended.stderr
    assert "recording.samples" in ended.stdout


def test_devices_of_one_run_have_a_figure_and_numbers_each(cfid: Cfid, tmp_path: Path) -> None:
    run = recorded(tmp_path, "commands", "crazyflie")
    assert cfid("show", run).returncode == 0
    assert {path.name for path in run.glob("*.png")} == {"commands_recording.png", "crazyflie_recording.png"}

    numbers = json.loads(cfid("show", run, "--json").stdout)["parameters"]
    assert numbers["recording.crazyflie.mean.pm.vbat"]["value"] == pytest.approx(4.0)
    assert numbers["recording.commands.duration_s"]["value"] == 4
