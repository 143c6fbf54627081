"""A whole simulated rig on real wires, and the file that states its true values."""

import re
from pathlib import Path

import pytest

from cfid.errors import ConfigError
from cfid.sim.truth import load_truth


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
