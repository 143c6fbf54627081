"""The simulated rig is mounted as its truth file states or, where that is silent, as rig.toml states."""

import math
from pathlib import Path

import numpy as np
import pytest

from cfid.records.rig_file import LoadCellMount, Rig, Tachometer, WindStand, load_rig, new_rig_text
from cfid.sim.propulsion import RotorTruth, SimulatedRotors
from cfid.sim.truth import SimTruth, as_mounted

STEADY = RotorTruth(unbalance=(0.0,) * 6, blade_pass=(0.0,) * 6)


@pytest.fixture
def preset(tmp_path: Path) -> Rig:
    (tmp_path / "rig.toml").write_text(new_rig_text())
    return load_rig(tmp_path / "rig.toml")


def torque_of_motor_1(yaw_deg: float) -> float:
    """Return motor 1's direction in degrees, from the cell's x axis to the left, by the torque of its thrust."""
    rotors = SimulatedRotors(STEADY, np.random.default_rng(1), yaw_deg=yaw_deg)
    rotors.advance(np.array([0.0]), np.zeros(4))
    wrench = rotors.advance(np.array([2.0]), np.array([30000.0, 0, 0, 0]))[-1]
    return math.degrees(math.atan2(wrench[3], -wrench[4]))


def test_what_rig_toml_states_is_simulated_unless_the_truth_states_it(preset: Rig) -> None:
    rig = preset.model_copy(
        update={
            "loadcell": LoadCellMount(yaw_deg=10.0, arm_mm=50.0, flip_fz=True),
            "tachometer": Tachometer(markers=3),
            "wind": WindStand(azimuth_deg=-20.0),
        }
    )
    truth = SimTruth.model_validate({"wind": {"azimuth_deg": 5.0}, "rotors": {"markers": 1}})
    mounted = as_mounted(truth, rig)

    assert (mounted.loadcell.yaw_deg, mounted.loadcell.flip_fz, mounted.rotors.arm_m) == (10.0, True, 0.05)
    assert (mounted.wind.yaw_deg, mounted.wind.azimuth_deg, mounted.rotors.markers) == (10.0, 5.0, 1)


@pytest.mark.parametrize(("yaw_deg", "lies_deg"), [(0.0, -45.0), (-45.0, 0.0), (45.0, -90.0)])
def test_motor_1_lies_front_right_of_a_cell_that_is_turned_to_the_left(yaw_deg: float, lies_deg: float) -> None:
    assert torque_of_motor_1(yaw_deg) == pytest.approx(lies_deg)
