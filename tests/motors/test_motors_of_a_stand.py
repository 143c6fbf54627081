"""A stand's file is of n motors, by Bitcraze's header or by --motors, and that divides thrust and torque alike."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.lab import Cfid

COMMANDS = np.arange(5000, 65001, 2500)
THRUST_N = 2.2e-11 * COMMANDS**2 + 6e-7 * COMMANDS  # of one motor; 0.132 N at 65000
ARM_M = 0.007  # torque over thrust
RPM = np.sqrt(THRUST_N / 2e-8) * 30 / np.pi


def table(
    folder: Path, thrust: str, torque: str, *, motors: int, rotors: int, pwm: str = "pwm", arm: float = 1
) -> Path:
    """Write a table of the sums of `motors` motors, with the speeds of `rotors` rotors."""
    speeds = [f"rpm{rotor + 1}" for rotor in range(rotors)]
    grams = 1 / 9.81e-3 if thrust.strip("])").endswith("g") else 1.0
    columns = [COMMANDS, motors * THRUST_N * grams, motors * arm * ARM_M * THRUST_N, *[RPM] * rotors]
    rows = (",".join(f"{value:.9g}" for value in row) for row in zip(*columns, strict=True))
    path = folder / "stand.csv"
    path.write_text("\n".join([",".join([pwm, thrust, torque, *speeds]), *rows, ""]))
    return path


def fitted(cfid: Cfid, what: str, path: Path, *options: object) -> dict[str, Any]:
    answer = cfid("fit", what, "--table", path, "--json", "--no-figures", *options)
    assert answer.returncode == 0, answer.stderr
    parameters: dict[str, Any] = json.loads(answer.stdout)["parameters"]
    return parameters


def assert_one_motors(cfid: Cfid, path: Path, *options: object) -> None:
    torque = fitted(cfid, "torque", path, *options)["motor.torque_poly"]["value"]
    assert torque[0] == pytest.approx(ARM_M, rel=1e-4)
    largest = fitted(cfid, "thrust", path, *options)["motor.max_thrust_n"]["value"]
    assert largest == pytest.approx(2.2e-11 * 65535**2 + 6e-7 * 65535, rel=1e-3)


@pytest.mark.parametrize("torque", ["torque_z[N]", "torque_nm"])
def test_the_table_of_bitcraze_s_stand_gives_one_motor_s_maps(cfid: Cfid, tmp_path: Path, torque: str) -> None:
    assert_one_motors(cfid, table(tmp_path, "thrust[N]", torque, motors=4, rotors=4))


def test_thrust_and_torque_without_a_command_give_the_slope_between_them(cfid: Cfid, tmp_path: Path) -> None:
    path = tmp_path / "pairs.csv"
    rows = "".join(f"{thrust:.9g},{ARM_M * thrust:.9g}\n" for thrust in THRUST_N)
    path.write_text(f"thrust_n,torque_nm\n{rows}")
    assert fitted(cfid, "torque", path)["motor.torque_poly"]["value"][0] == pytest.approx(ARM_M, rel=1e-6)


def test_the_speeds_of_other_rotors_are_a_question_for_thrust_and_for_torque(cfid: Cfid, tmp_path: Path) -> None:
    path = table(tmp_path, "Thrust (N)", "Torque (Nm)", motors=4, rotors=4)
    for what in ("torque", "thrust"):
        asked = cfid("fit", what, "--table", path, "--no-figures")
        assert asked.returncode == 2
        assert "--motors" in asked.stderr
    assert_one_motors(cfid, path, "--motors", 4)


def test_a_torque_of_four_motors_beside_the_thrust_of_one_reaches_no_firmware(cfid: Cfid, tmp_path: Path) -> None:
    assert cfid("new", tmp_path / "campaign").returncode == 0
    path, header = table(tmp_path, "thrust_n", "torque_nm", motors=1, rotors=0, arm=4), tmp_path / "motors.h"
    rejected = cfid("fit", "torque", "--table", path, "--no-figures", "--campaign", tmp_path / "campaign")
    assert rejected.returncode == 5
    assert "0.028" in rejected.stderr
    assert "0.003 to 0.012" in rejected.stderr

    kept = cfid("fit", "torque", "--table", path, "--no-figures", "--force", "--campaign", tmp_path / "campaign")
    assert kept.returncode == 0
    export = ("export", "firmware", "--out", header, "--campaign", tmp_path / "campaign")
    refused = cfid(*export)
    assert refused.returncode == 4
    assert not header.exists()
    assert "0.003 to 0.012" in " ".join(refused.stderr.split())
    assert cfid(*export, "--force").returncode == 0
    assert "THRUST2TORQUE 0.028" in header.read_text()
