"""Tables that merge the rows of several devices or vehicles: what such a table gives, and why it may give nothing."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cfid.errors import DataError
from cfid.motors.lag import fit
from cfid.motors.lag.data import rotor_log
from cfid.records.result import Result
from tests.motors.test_lag_coverage import FALLING_S, RATE_HZ, RISING_S, flown

NEXT = 30 / np.pi


def logged(seed: int = 7) -> pd.DataFrame:
    """Return a log of the Crazyflie's client at 100 Hz."""
    time_s, command, speed = flown(1, seed, noise=3.0, red=0.0)
    stamp = np.rint(1000 * time_s).astype(int)
    columns = {"motor.m1": np.round(65535 * command[0, 0]), "rpm.m1": np.round(NEXT * speed[0])}
    return pd.DataFrame({"Timestamp": stamp, **columns})


def fitted(folder: Path, log: pd.DataFrame) -> Result:
    log.to_csv(folder / "log.csv", index=False)
    found = rotor_log(folder / "log.csv")
    assert found is not None
    return fit(found)


@pytest.mark.parametrize("late_ms", [0, 3])
def test_speeds_in_rows_of_their_own_give_the_lag(tmp_path: Path, late_ms: int) -> None:
    """Such rows come from log blocks that were joined by their times, or concatenated and sorted."""
    log = logged()
    commands, speeds = log[["Timestamp", "motor.m1"]], log[["Timestamp", "rpm.m1"]].iloc[::2]
    speeds = speeds.assign(Timestamp=speeds["Timestamp"] + late_ms)
    result = fitted(tmp_path, pd.concat([commands, speeds]).sort_values("Timestamp", kind="stable"))

    assert result.accepted
    assert 1 / result.quantities["dynamics.rising"].value[0] == pytest.approx(RISING_S, rel=0.01)
    assert 1 / result.quantities["dynamics.falling"].value[0] == pytest.approx(FALLING_S, rel=0.01)
    assert f"the command is known every {1000 / RATE_HZ:.0f} ms" in " ".join(one.text for one in result.findings)


def test_commands_that_repeat_their_times_are_refused_as_that(tmp_path: Path) -> None:
    both = pd.concat([logged(7), logged(8)]).sort_values("Timestamp", kind="stable")
    with pytest.raises(DataError, match="2500 of 5000 rows of commands repeat the time of the one before"):
        fitted(tmp_path, both)
