"""An owner without a rig gets from a new folder to an exported file, and is asked for no other instrument."""

import re
from pathlib import Path

import numpy as np
import pytest

from cfid.guide.status import status_of
from cfid.records.campaign import open_campaign
from cfid.records.run import Label
from tests.lab import Cfid, made_run
from tests.virtual_bench import bench_in

MATRIX = "16.6e-6:1e-7,16.7e-6:1e-7,29.3e-6:2e-7,0.8e-6:1e-7,0.7e-6:1e-7,1.8e-6:1e-7"


def fill_in(folder: Path) -> None:
    """Write what an owner measured in place of what is missing."""
    rig = folder / "rig.toml"
    measured = {"mass_g": "34.1", "arm_mm": "46.0", "above_mm": "65.0", "below_mm": "65.0", "length_mm": "400.0"}
    rig.write_text(re.sub(r'(\w+) = "\?', lambda key: f'{key[1]} = "{measured[key[1]]}', rig.read_text()))


@pytest.fixture
def owner(cfid: Cfid, tmp_path: Path) -> Path:
    folder = tmp_path / "mine"
    assert cfid("new", folder, "--kind", "owner").returncode == 0
    return folder


def test_what_has_to_be_measured_is_missing_until_it_is_stated(cfid: Cfid, owner: Path) -> None:
    missing = cfid("status", folder=owner)
    assert (missing.returncode, "vehicle.mass_g" in missing.stderr) == (2, True)
    fill_in(owner)
    assert cfid("status", folder=owner).returncode == 0


def test_the_plan_needs_threads_and_kitchen_scales_alone(owner: Path) -> None:
    fill_in(owner)
    first, thrust = (each.task for each in status_of(open_campaign(owner)).tasks)

    assert {recording.words[:2] for recording in first.recordings} == {("log", "gyro")}
    assert [recording.words for recording in thrust.recordings] == [("log", "scales", "--motor", "1,2,3,4")]


def test_the_check_looks_for_the_vehicle_alone(owner: Path) -> None:
    fill_in(owner)
    (owner.parent / "bench").mkdir()
    with bench_in(owner.parent / "bench") as bench:
        (bench.folder / "rig.toml").write_text((owner / "rig.toml").read_text())
        checked = bench.start("rig", "check", "--json")
        assert checked.end() == 0, checked.err
        assert re.findall(r'^    "(\w+)": \[', checked.out, re.MULTILINE) == ["crazyflie"]


def test_scales_and_swings_end_at_a_header_for_the_firmware(cfid: Cfid, owner: Path) -> None:
    fill_in(owner)
    steps = np.array([0, *range(8000, 64001, 8000), *range(56000, 7999, -8000)])
    grams = np.where(steps == 0, 180.0, np.round(180.0 - 4e3 * (3e-11 * steps**2 + 5.6e-7 * steps + 2.6e-3) / 9.81, 1))
    columns = {"t": 1.7e9 + 8.0 * np.arange(len(steps)), "command": steps, "grams": grams}
    requested = {"steps": steps.tolist(), "motors": [1, 2, 3, 4], "hold_s": 5.0, "rest_s": 3.0}
    made_run(owner, "scales", {"readings": columns}, label=Label(), requested=requested)
    assert cfid("fit", "thrust", "--no-figures", folder=owner).returncode == 0
    assert cfid("set", "inertia.matrix_kg_m2", MATRIX, folder=owner).returncode == 0

    ended = cfid("export", "firmware", "--out", "-", folder=owner)
    assert ended.returncode == 0, ended.stderr
    largest = re.search(r"^#define THRUST_MAX ([\d.]+)f", ended.stdout, re.MULTILINE)
    assert largest is not None
    assert float(largest[1]) == pytest.approx(3e-11 * 65535**2 + 5.6e-7 * 65535 + 2.6e-3, rel=0.01)
