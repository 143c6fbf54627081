"""Speeds that a log or a stand repeats in several rows, as loggers do between readings, count once."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from cfid.motors.steps import fit as fit_steps
from cfid.records.result import Result
from tests.motors.rotor_logs import FALLING_S, NOISE, RISING_S, RPM, TRUTH, fit_of, following, off

Array = npt.NDArray[np.float64]


def repeated(value: Array, rows: int) -> Array:
    return value[np.arange(len(value)) // rows * rows]


def fitted_log(folder: Path, rows: int, seed: int, *, own_clock: bool = False) -> Result:
    """Fit 20 s of two rotors at 500 Hz with one speed reading per `rows` rows, or at the sensor's own clock."""
    rng, time_s = np.random.default_rng(seed), np.arange(10_000) / 500
    columns = {"t": time_s, "pm.vbat": np.round(4 + rng.normal(0, 0.004, len(time_s)), 3)}
    for motor in (1, 2):
        change_s: Array = np.append(0, np.round(500 * rng.uniform(0.17, 0.52, 60).cumsum()) / 500)
        command = np.round(rng.uniform(15000, 55000, len(change_s)))
        read_s = np.arange(rng.uniform(0, 0.002), 20, 0.00191 * rows) if own_clock else time_s[::rows]
        speed = following(change_s, 400 + 0.033 * command, read_s) + rng.normal(0, NOISE, len(read_s))
        shown = np.searchsorted(read_s, time_s + 1e-9, side="right") - 1
        columns[f"motor.m{motor}"] = command[np.searchsorted(change_s, time_s + 1e-9, side="right") - 1]
        columns[f"rpm.m{motor}"] = np.round(RPM * speed)[np.maximum(shown, 0)]
    return fit_of(folder, columns)


def fitted_stand(folder: Path, rows: int, seed: int) -> Result:
    """Fit 32 s of a stand at 100 Hz with one speed reading per `rows` rows."""
    rng, time_s = np.random.default_rng(seed), np.arange(3200) / 100
    pulses = 1000 + 1000 * np.array([0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1, 0.8, 0.6, 0.4, 0.2, 0])
    speed = following(np.arange(0.0, 32, 2), pulses - 1000, time_s)
    speed = np.maximum(RPM * speed + rng.normal(0, 5, len(speed)) * (speed > 0), 0)
    table = pd.DataFrame(
        {
            "Time (s)": time_s,
            "ESC signal (µs)": np.repeat(pulses, 200),
            "Thrust (N)": 2e-6 * (speed / RPM) ** 2 + rng.normal(0, 0.002, len(speed)),
            "Motor Optical Speed (RPM)": repeated(np.round(speed, 1), rows),
        }
    )
    table.to_csv(folder / "stand.csv", index=False)
    return fit_steps(folder / "stand.csv")


def said(result: Result) -> str:
    return " ".join(one.text for one in result.findings if "repeated" in one.code)


@pytest.mark.parametrize(
    ("rows", "own_clock"),
    [
        (2, False),
        (25, True),
        *(
            pytest.param(*one, marks=pytest.mark.slow)
            for one in ((2, True), (5, False), (5, True), (10, False), (10, True), (25, False))
        ),
    ],
)
def test_a_log_that_repeats_speeds_gives_the_lag_and_the_delay(tmp_path: Path, rows: int, own_clock: bool) -> None:
    result = fitted_log(tmp_path, rows, 7 + rows, own_clock=own_clock)
    delay = result.quantities["dynamics.delay_s"]

    assert result.accepted
    assert max(off(result)) < 3
    assert abs(delay.value) < 2 * delay.std
    assert delay.std < 0.0018
    assert result.quantities["dynamics.rising"].std[0] < 0.01 / RISING_S
    assert f"500 rows a second show {'' if own_clock else f'{500 / rows:.3g} readings'}" in said(result)


@pytest.mark.parametrize("rows", [5, *(pytest.param(rows, marks=pytest.mark.slow) for rows in (2, 10))])
def test_a_stand_that_repeats_speeds_gives_the_lag(tmp_path: Path, rows: int) -> None:
    for seed in range(4):
        result = fitted_stand(tmp_path, rows, seed)
        assert max(off(result)) < 3
        assert result.accepted
    assert f"each reading is repeated in about {rows} rows: 100 rows a second show {100 // rows} readings" in said(
        result
    )


def test_speeds_that_each_row_reads_are_not_said_to_be_repeated(tmp_path: Path) -> None:
    for result in (fitted_log(tmp_path, 1, 3), fitted_stand(tmp_path, 1, 3)):
        assert max(off(result)) < 3
        assert not said(result)


def sagging(commands: Array) -> tuple[Array, Array]:
    """Return speeds (k, n) and volts (n,) of a battery that sags under commands (k, n), in steps of 0.5 ms."""
    rising, falling = np.expm1(-0.0005 / np.array([RISING_S, FALLING_S])).tolist()
    now, speeds, volts = [1000.0] * len(commands), [], []
    for command in (2000 * (commands.T / 65535)).tolist():
        for step in range(4):
            battery_v = 4.1 - 0.3 * (sum((speed / 2200) ** 2 for speed in now) / len(now))
            if step == 0:
                speeds.append(now)
                volts.append(battery_v)
            targets = [200 + each * battery_v / 4 for each in command]
            now = [w + (w - to) * (rising if to > w else falling) for w, to in zip(now, targets, strict=True)]
    return np.array(speeds).T, np.array(volts)


def test_a_voltage_that_rows_repeat_acts_as_where_other_rows_have_none(tmp_path: Path) -> None:
    rng, time_s = np.random.default_rng(5), np.arange(10_000) / 500
    commands = np.round(rng.uniform(15000, 55000, (2, 58))).repeat(175, axis=1)[:, : len(time_s)]
    speeds, volts = sagging(commands)
    shown_rpm = np.round(RPM * (speeds + rng.normal(0, NOISE, speeds.shape)))
    columns = {f"motor.m{motor}": command for motor, command in enumerate(commands, start=1)}
    columns |= {f"rpm.m{motor}": rpm for motor, rpm in enumerate(shown_rpm, start=1)} | {"t": time_s}
    read = np.where(np.arange(len(time_s)) % 50 == 3, np.round(volts + rng.normal(0, 0.004, len(volts)), 3), np.nan)
    results = []
    for shown in (read, pd.Series(read).ffill().to_numpy()):
        results.append(fit_of(tmp_path, {**columns, "pm.vbat": shown}))
    blank, filled = results

    for way, tau_s in TRUTH:
        one, other = (result.quantities[f"dynamics.{way}"] for result in results)
        assert other.value[0] == pytest.approx(1 / tau_s, rel=0.005)
        assert abs(one.value[0] - other.value[0]) < 0.2 * one.std[0]
    assert "repeated in about 50 rows" in said(filled)
    assert not said(blank)
