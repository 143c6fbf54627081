"""Exchanged files of two commands, and arguments that contradict a run's own label."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from cfid.errors import ConfigError
from cfid.motors.maps.checks import exchange_findings
from cfid.records.run import DeviceRecord, Label, read_run, refuse_contradiction, run_holding
from cfid.records.run_writer import create_run

COMMAND = np.arange(2000.0, 66000.0, 2000.0)
THRUST = 2.13e-11 * COMMAND**2 + 1.03e-6 * COMMAND + 5e-4


def found(thrust: np.ndarray, command: np.ndarray = COMMAND) -> tuple[str, ...]:
    return tuple(one.text for one in exchange_findings(command, thrust, order=2, quantities=("motor.thrust_poly",)))


def test_two_exchanged_commands_are_named_and_sound_ones_pass() -> None:
    for seed in range(50):
        rng = np.random.default_rng(seed)
        sound = THRUST * (1 + 0.003 * rng.standard_normal(len(THRUST)))
        low, high = np.sort(rng.choice(len(THRUST), 2, replace=False))
        exchanged = sound.copy()
        exchanged[[low, high]] = sound[[high, low]]
        assert found(sound) == ()
        (text,) = found(exchanged)
        assert f"command {COMMAND[low]:.0f} has" in text
        assert f"command {COMMAND[high]:.0f} only" in text


def test_scatter_alone_is_no_exchange() -> None:
    for seed in range(200):
        rng = np.random.default_rng(seed)
        few = slice(None, None, 4)
        assert found(THRUST[few] * (1 + 0.05 * rng.standard_normal(8)), COMMAND[few]) == ()


def test_the_run_of_a_file_states_what_an_argument_may_say(tmp_path: Path) -> None:
    device = DeviceRecord(file="loadcell.csv", columns=("t", "Fz"))
    requested = {"steps": [10000, 20000], "motors": [1, 3]}
    writer = create_run(
        tmp_path,
        kind="thrust",
        label=Label(),
        devices={"loadcell": device},
        started=datetime(2026, 11, 21, tzinfo=UTC),
        cfid_version="0.2.0",
        requested=requested,
    )
    writer.close("complete")
    run = run_holding(writer.folder / "loadcell.csv")
    assert run is not None
    assert run == read_run(writer.folder) == run_holding(writer.folder)
    assert run_holding(tmp_path / "elsewhere.csv") is None
    refuse_contradiction("2=x", {"command": 10000, "angle_deg": 3.0}, {"command": run.header.requested["steps"]})
    with pytest.raises(ConfigError, match="command 30000 contradicts the run's own label, command 10000, 20000"):
        refuse_contradiction("2=x", {"command": 30000}, {"command": run.header.requested["steps"]})
