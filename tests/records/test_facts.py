"""Facts of a rig: stated in rig.toml, noted in each run, with one rotation from the load cell to the vehicle."""

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from cfid.errors import ConfigError
from cfid.recordings.wrench import turn_about_z
from cfid.records.rig_file import NONE_STATED, LoadCellMount, RigFacts, Tachometer, WindStand, load_rig, new_rig_text
from cfid.records.run import amend_run, read_run
from tests.lab import made_run

LEAST = "[vehicle]\nmass_kg = 0.028\ncentre_of_mass_mm = [0, 0, 0]\n"
DIAGONAL = math.sqrt(0.5)


def facts_of(folder: Path, text: str) -> RigFacts:
    (folder / "rig.toml").write_text(LEAST + text)
    return load_rig(folder / "rig.toml").facts


# The frames


def test_in_the_thesis_wind_the_cells_x_axis_lies_45_degrees_left_of_the_nose() -> None:
    x, y, z = turn_about_z(np.eye(3), yaw_deg=45.0)

    assert tuple(x) == pytest.approx((DIAGONAL, DIAGONAL, 0))
    assert tuple(y) == pytest.approx((-DIAGONAL, DIAGONAL, 0))
    assert tuple(z) == (0, 0, 1)


def test_at_the_thesis_sines_motor_1_front_right_lies_on_the_cells_x_axis_and_motor_4_on_y() -> None:
    x, y, _ = turn_about_z(np.eye(3), yaw_deg=-45.0)

    assert tuple(x) == pytest.approx((DIAGONAL, -DIAGONAL, 0))
    assert tuple(y) == pytest.approx((DIAGONAL, DIAGONAL, 0))


# rig.toml


def test_the_preset_states_both_mounts_of_the_thesis(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(new_rig_text())
    facts = load_rig(tmp_path / "rig.toml").facts

    assert (facts.loadcell.yaw_deg, facts.yaw_in_wind_deg) == (-45.0, 45.0)
    assert facts.wind.azimuth_deg == pytest.approx(math.degrees(0.4967), abs=0.005)
    assert (facts.loadcell.arm_mm, facts.loadcell.flip_fz, facts.tachometer.markers) == (46.0, False, 2)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("[loadcell]\nyaw_deg = nan", "loadcell.yaw_deg"),
        ("[loadcell]\nflip_fz = 1", "loadcell.flip_fz"),
        ("[tachometer]\nmarkers = 1.5", "tachometer.markers"),
        ("[wind]\nazimuth_rad = 0.4967", "wind.azimuth_rad"),
    ],
)
def test_an_invalid_fact_is_named(tmp_path: Path, text: str, key: str) -> None:
    with pytest.raises(ConfigError, match=key):
        facts_of(tmp_path, text)


# Runs


def test_a_run_keeps_the_stated_facts_through_its_end_and_later_notes(tmp_path: Path) -> None:
    stated = RigFacts(loadcell=LoadCellMount(yaw_deg=0.0, flip_fz=False), wind=WindStand(azimuth_deg=-10.5))
    run = made_run(tmp_path, "thrust", {"commands": {"t": [], "m1": []}}, facts=stated)
    amend_run(run, note="windy")

    assert read_run(run.folder).header.rig == run.header.rig == stated
    noted = tomllib.loads((run.folder / "run.toml").read_text())["rig"]
    assert noted == {"loadcell": {"yaw_deg": 0.0, "flip_fz": False}, "wind": {"azimuth_deg": -10.5}}


def test_stated_facts_replace_others_one_by_one() -> None:
    noted = RigFacts(loadcell=LoadCellMount(yaw_deg=30.0, arm_mm=46.0), tachometer=Tachometer(markers=2))
    given = RigFacts(loadcell=LoadCellMount(yaw_deg=0.0), wind=WindStand(azimuth_deg=5.0))

    assert given.over(noted) == RigFacts(
        loadcell=LoadCellMount(yaw_deg=0.0, arm_mm=46.0),
        tachometer=Tachometer(markers=2),
        wind=WindStand(azimuth_deg=5.0),
    )
    assert NONE_STATED.over(noted) == noted
