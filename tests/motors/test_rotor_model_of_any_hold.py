"""One rotor has one physical model, however long a stand held its commands, or the model is rejected."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.campaigns import Cfid

K1, K2, ROW_S, FINER = 1.3, 0.0020, 0.01, 20
KEYS = ("dynamics.rising", "dynamics.falling")


def fitted(cfid: Cfid, folder: Path, *, hold_s: float, steps: int) -> dict[str, Any]:
    """Fit a stand's table of the rotor dw/dt = k1 (c - w) + k2 (c^2 - w^2), both ways, at random commands."""
    rng = np.random.default_rng(5)
    command = np.repeat(rng.choice(np.arange(10000, 60001, 2500), steps), round(hold_s / ROW_S))
    leads_to = 300 + 0.035 * command
    now, speed = float(leads_to[0]), np.empty(len(command))
    for place, to in enumerate(leads_to):
        speed[place] = now
        for _ in range(FINER):
            now += ROW_S / FINER * (K1 * (to - now) + K2 * (to**2 - now**2))
    rpm = np.round((speed + rng.normal(0, 4, len(speed))) * 30 / np.pi)
    table = {"t": np.round(ROW_S * np.arange(len(command)), 2), "cmd": command, "rpm": rpm}
    pd.DataFrame(table).to_csv(folder / "stand.csv", index=False)
    ended = cfid("fit", "dynamics", "--table", "stand.csv", "--no-figures", "--json")
    assert ended.returncode == 0, ended.stderr
    found: dict[str, Any] = json.loads(ended.stdout)
    return found


@pytest.mark.parametrize("hold_s", [0.4, 0.6])
def test_both_coefficients_come_back_from_commands_held_for_any_time(cfid: Cfid, tmp_path: Path, hold_s: float) -> None:
    parameters = fitted(cfid, tmp_path, hold_s=hold_s, steps=40)["parameters"]
    for key in KEYS:
        for value, std, true in zip(parameters[key]["value"], parameters[key]["std"], (K1, K2), strict=True):
            assert abs(value - true) < 2 * std
        assert parameters[key]["std"][1] < 0.2 * K2


def test_commands_held_too_shortly_give_time_constants_and_no_coefficients(cfid: Cfid, tmp_path: Path) -> None:
    found = fitted(cfid, tmp_path, hold_s=0.2, steps=60)
    assert not set(KEYS) & set(found["parameters"])
    assert "dynamics.time_constant_s" in found["parameters"]
    assert "rotor-model-not-excited" in [one["code"] for one in found["findings"]]
