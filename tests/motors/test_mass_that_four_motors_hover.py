"""The mass that four motors hover, from two that ran on a battery: four draw its voltage further down."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from tests.lab import Cfid

Array = npt.NDArray[np.float64]

OHM, EFFICIENCY, NEWTON_PER_V2, WATT_PER_N15 = 0.15, 0.5, 0.0125, 45.0
UP = np.arange(4000.0, 64001.0, 4000.0)


def steady(command: Array, *, motors: int, open_v: Array) -> tuple[Array, Array]:
    """Return one motor's thrust and the battery's voltage: its inner resistance carries the current of all motors."""
    volts = open_v + 0 * command
    for _ in range(300):
        thrust = NEWTON_PER_V2 * (command / 65535 * volts) ** 2
        amperes = motors * WATT_PER_N15 * thrust**1.5 / EFFICIENCY / volts
        volts = 0.5 * volts + 0.5 * (open_v - OHM * amperes)
    return thrust, volts


def fitted(
    cfid: Cfid, folder: Path, command: Array, open_v: Array, *, motors: int, volts: bool = True, noise: float = 0.002
) -> Any:
    """Fit a table of the thrust of `motors` motors together, with relative errors of `noise`."""
    thrust, vbat = steady(command, motors=motors, open_v=open_v)
    noisy = motors * thrust * (1 + noise * np.random.default_rng(1).standard_normal(len(command)))
    columns = {"command": command, "thrust [N]": noisy, "vbat [V]": vbat}
    pd.DataFrame(columns if volts else {name: columns[name] for name in list(columns)[:2]}).to_csv(
        folder / "stand.csv", index=False
    )
    ended = cfid("fit", "thrust", "--table", "stand.csv", "--motors", motors, "--no-figures", "--json")
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout)


@pytest.mark.parametrize("motors", [1, 2, 4])
def test_the_hover_mass_is_that_of_four_motors_however_many_ran(cfid: Cfid, tmp_path: Path, motors: int) -> None:
    """Up, down and up again while the battery empties: at the voltage under two motors it would be a fifth more."""
    command = np.concatenate([UP, UP[::-1], UP])
    open_v = np.linspace(4.1, 3.8, len(command))
    (true_n,), _ = steady(np.array([65535.0]), motors=4, open_v=np.array([3.95]))
    found = fitted(cfid, tmp_path, command, open_v, motors=motors)["parameters"]
    mass, most = found["motor.hover_mass_kg"], found["motor.max_thrust_n"]

    assert mass["value"] == pytest.approx(4 * true_n / 9.81, rel=0.03)
    assert abs(mass["value"] - 4 * true_n / 9.81) < 2 * mass["std"]
    assert mass["value"] == pytest.approx(4 * most["value"] / 9.81, rel=1e-3)


def test_where_command_and_voltage_explain_thrust_alike_the_uncertainty_spans_both(cfid: Cfid, tmp_path: Path) -> None:
    """On the way up alone, the voltage is a function of the command."""
    true_n, _ = steady(np.array([65535.0]), motors=4, open_v=np.array([3.95]))
    by_command_n, _ = steady(np.array([65535.0]), motors=2, open_v=np.array([3.95]))
    found = fitted(cfid, tmp_path, UP, np.full(len(UP), 3.95), motors=2, noise=0.01)
    mass = found["parameters"]["motor.hover_mass_kg"]

    for newton in (true_n[0], by_command_n[0]):
        assert abs(mass["value"] - 4 * newton / 9.81) < 2 * mass["std"]


@pytest.mark.parametrize(("motors", "volts", "noted"), [(2, False, True), (4, False, False), (2, True, False)])
def test_without_a_voltage_a_note_states_under_how_many_motors_the_maximum_holds(
    cfid: Cfid, tmp_path: Path, motors: int, volts: bool, noted: bool
) -> None:
    found = fitted(cfid, tmp_path, UP, np.full(len(UP), 3.95), motors=motors, volts=volts)
    assert ("maximum-of-fewer-motors" in [one["code"] for one in found["findings"]]) == noted
