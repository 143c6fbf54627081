"""What a truth file, rig.toml and words of faults state is simulated, and what cannot be meant is refused."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from cfid.errors import ConfigError
from cfid.records.rig_file import LoadCellMount, Rig, Tachometer, WindStand, load_rig, new_rig_text
from cfid.sim.faults import (
    SOUND_CRAZYFLIE,
    SOUND_ENCODER,
    SOUND_LOADCELL,
    CrazyflieFaults,
    EncoderFaults,
    LoadCellFaults,
    parse_faults,
)
from cfid.sim.propulsion import RotorTruth, SimulatedRotors
from cfid.sim.truth import SimTruth, as_mounted, load_truth


def test_a_truth_says_what_it_says(tmp_path: Path) -> None:
    (tmp_path / "truth.toml").write_text(
        "[vehicle]\ninertia_kg_m2 = [[2e-5, 0, 0], [0, 2e-5, 0], [0, 0, 3e-5]]\n"
        "[axis]\ncoulomb_nm = 1e-4\n[rotors]\ntime_constant_s = 0.1\n[loadcell]\nbias = [0, 0, 0, 0, 0, 0]\n"
        "[crazyflie]\nfirmware = 'stock'\nrpm_deck = true\nclock_skew = -0.01\n[battery]\nkind = 'lipo'\ncharge = 0.5\n"
        "[radio]\nlatency_s = 0.028\njitter_s = 0.008\nloss = 0.01\n"
    )
    truth = load_truth(tmp_path / "truth.toml")
    assert truth.vehicle.inertia_kg_m2[2] == (0, 0, 3e-5)
    assert truth.axis.coulomb_nm == 1e-4
    assert truth.rotors.time_constant_s == 0.1
    assert truth.loadcell.bias == (0,) * 6
    assert truth.loadcell.counts_per_n == 1e6
    assert (truth.crazyflie.firmware, truth.crazyflie.rpm_deck, truth.crazyflie.clock_skew) == ("stock", True, -0.01)
    assert (truth.battery.kind, truth.battery.charge) == ("lipo", 0.5)
    assert (truth.radio.latency_s, truth.radio.jitter_s, truth.radio.loss) == (0.028, 0.008, 0.01)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[rotors]\ntime_constant = 0.1", "rotors.time_constant"),
        ("[rotors]\ntime_constant_s = '0.1'", "rotors.time_constant_s"),
        ("[loadcell]\nbias = [0, 0]", "loadcell.bias"),
        ("[motors]", "motors"),
        ("[crazyflie]\nfirmware = 'new'", "crazyflie.firmware"),
        ("[battery]\nkind = 'lead'", "battery.kind"),
        ("[radio]\nlatency_s = 0.001\njitter_s = 0.002", "before it was sent"),
        ("[vehicle]\ninertia_kg_m2 = [[1, 1, 0], [0, 1, 0], [0, 0, 1]]", "symmetric"),
        ("[vehicle]\ninertia_kg_m2 = [[1, 0, 0], [0, 1, 0], [0, 0, 3]]", "no body"),
        ("nonsense", "TOML"),
        (None, "no such file"),
    ],
)
def test_a_wrong_truth_names_file_and_key(tmp_path: Path, text: str | None, expected: str) -> None:
    path = tmp_path / "truth.toml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError, match=re.escape(expected)) as caught:
        load_truth(path)
    assert str(path) in str(caught.value)


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


def test_words_name_faults_of_all_devices() -> None:
    encoder, loadcell, crazyflie = parse_faults(
        [
            "loadcell.drop_every=100",
            "encoder.split=true",
            "crazyflie.busy=true",
            "loadcell.status=0x80020000",
            "loadcell.silent_after_s=2.5",
            "crazyflie.tumble_after_s=3",
        ]
    )
    assert encoder == EncoderFaults(split=True)
    assert loadcell == LoadCellFaults(drop_every=100, status=0x80020000, silent_after_s=2.5)
    assert crazyflie == CrazyflieFaults(busy=True, tumble_after_s=3.0)
    assert parse_faults([]) == (SOUND_ENCODER, SOUND_LOADCELL, SOUND_CRAZYFLIE)


@pytest.mark.parametrize(
    "word",
    [
        "loadcell.dorp_every=3",
        "drop_every=3",
        "loadcell.drop_every=x",
        "loadcell.drop_every=1.5",
        "loadcell.drop_every=-1",
        "loadcell.slow_s=nan",
        "loadcell.slow_s=inf",
        "loadcell.status=0x1_0000_0000",
        "encoder.split=maybe",
        "encoder.split",
        "encoder.wrong_width=33",
        "crazyflie.tumble_deg=181",
    ],
)
def test_a_fault_that_cannot_be_is_told(word: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(word.partition("=")[0])):
        parse_faults([word])
