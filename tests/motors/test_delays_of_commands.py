"""The delay of a rotor behind its command: from exact times of commands, and from rows that show them late."""

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import create_run
from tests.campaigns import Cfid
from tests.motors.rotor_logs import RPM, following

Array = npt.NDArray[np.float64]

DELAY_S = 0.015


def recorded(folder: Path, seed: int, *, row_s: float) -> Path:
    """Record a run with commands at exact times, whose speeds follow after `DELAY_S` and are read every `row_s`."""
    rng = np.random.default_rng(seed)
    change_s = np.append(0.0, rng.uniform(0.9, 1.1, 12).cumsum())
    command = np.append(30000.0, rng.permutation(np.linspace(15000, 60000, 12)).round())
    time_s = np.arange(0.003, change_s[-1] + 1, row_s)
    late_s = np.append(0.0, change_s[1:] + DELAY_S)
    speed = following(late_s, 400 + 0.033 * command, time_s) + rng.normal(0, 1.5, len(time_s))
    writer = create_run(
        folder,
        kind="speed",
        label=Label(),
        devices={
            "commands": DeviceRecord(file="commands.csv", columns=("t", "m1", "m2", "m3", "m4")),
            "crazyflie": DeviceRecord(file="crazyflie.csv", columns=("t", "rpm.m1", "pm.vbat")),
        },
        started=datetime(2026, 11, 21, 8, seed, tzinfo=UTC),
        cfid_version="0",
        requested={"motors": [1]},
    )
    begin_s, none = 1.79e9, np.zeros(len(command))
    writer.append("commands", (begin_s + change_s, command, none, none, none))
    writer.append("crazyflie", (begin_s + time_s, RPM * speed, np.full(len(time_s), 4.0)))
    writer.close("complete")
    return writer.folder


@pytest.mark.parametrize("row_s", [0.01, 0.02])
def test_steps_have_the_delay_of_their_commands_own_times(cfid: Cfid, tmp_path: Path, row_s: float) -> None:
    """Counted from the first row of speeds after each command, the delay would be 5 or 10 ms too short."""
    ended = cfid("fit", "dynamics", recorded(tmp_path, 1, row_s=row_s), "--no-figures", "--json")
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    delays = [row["delay_s"] for row in found["parameters"]["dynamics.time_constant_s"]["value"] if row["accepted"]]

    assert len(delays) == 12
    assert np.mean(delays) == pytest.approx(DELAY_S, abs=5e-4)
    assert np.std(delays) < 1e-3
    assert "rotor-delay-negative" not in [one["code"] for one in found["findings"]]


@pytest.mark.parametrize("row_s", [0.01, 0.02])
def test_the_mean_lateness_of_rows_is_taken_off_a_logs_delay(cfid: Cfid, tmp_path: Path, row_s: float) -> None:
    """A row shows a command half a row late on average: a known error is corrected, and only its scatter stated."""
    rng, time_s = np.random.default_rng(5), np.arange(0.002, 40, row_s)
    change_s = np.append(0, rng.uniform(0.17, 0.52, 110).cumsum())
    command = np.round(rng.uniform(15000, 55000, len(change_s)))
    speed = following(np.append(0, change_s[1:] + DELAY_S), 400 + 0.033 * command, time_s)
    shown = command[np.searchsorted(change_s, time_s, side="right") - 1]
    rpm = np.round(RPM * (speed + rng.normal(0, 1.5, len(time_s))))
    columns = {"t": time_s, "motor.m1": shown, "rpm.m1": rpm, "pm.vbat": np.full(len(time_s), 4.0)}
    pd.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    ended = cfid("fit", "dynamics", "log.csv", "--no-figures", "--json")
    assert ended.returncode == 0, ended.stderr
    delay = json.loads(ended.stdout)["parameters"]["dynamics.delay_s"]

    assert delay["value"] == pytest.approx(DELAY_S, abs=1e-3)
    assert delay["std"] == pytest.approx(row_s / np.sqrt(12), rel=0.05)  # changes and rows may have one rhythm


def test_the_mean_age_of_repeated_speeds_is_taken_off_a_tables_delay(cfid: Cfid, tmp_path: Path) -> None:
    rng, time_s = np.random.default_rng(3), np.arange(0, 40, 0.01)
    change_s = np.append(0, rng.uniform(0.9, 1.1, 38).cumsum())
    command = np.round(rng.uniform(15000, 60000, len(change_s)))
    read_s = np.arange(0.0, 40, 0.0487)  # a sensor with a clock of its own, shown at the next row
    speed = following(np.append(0, change_s[1:] + DELAY_S), 400 + 0.033 * command, read_s)
    rpm = (RPM * (speed + rng.normal(0, 1.5, len(read_s)))).round()[np.searchsorted(read_s, time_s, side="right") - 1]
    table = {"t": time_s, "cmd": command[np.searchsorted(change_s, time_s, side="right") - 1], "rpm": rpm}
    pd.DataFrame(table).to_csv(tmp_path / "stand.csv", index=False)
    ended = cfid("fit", "dynamics", "--table", "stand.csv", "--no-figures", "--json")
    assert ended.returncode == 0, ended.stderr
    rows = json.loads(ended.stdout)["parameters"]["dynamics.time_constant_s"]["value"]

    assert np.mean([row["delay_s"] for row in rows if row["accepted"]]) == pytest.approx(DELAY_S, abs=2.5e-3)
