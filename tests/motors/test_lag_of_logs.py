"""A log of the uSD-card deck gives the lag of its rotors, or states why it cannot."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from cfid.errors import ConfigError, DataError, FitError
from cfid.motors.lag import fit
from cfid.motors.lag.data import RotorLog, of_stand, rotor_log
from cfid.motors.lag.estimation import LagFit, fit_lag, joined
from cfid.motors.lag.model import InputLag, LogSegment, Signal
from cfid.recordings.stand import read_stand, stand_of
from cfid.records.result import Result
from tests.campaigns import Cfid
from tests.logs.usd_bytes import Event, bytes_of, written
from tests.motors.rotor_logs import following
from tests.motors.test_lag_coverage import DELAY_S, FALLING_S, RATE_HZ, RISING_S, flown

Array = npt.NDArray[np.float64]

MOTORS = tuple(f"motor.m{motor}(H)" for motor in (1, 2, 3, 4))
SPEEDS = tuple(f"rpm.m{motor}(H)" for motor in (1, 2, 3, 4))
NEXT = 30 / np.pi


def logged(folder: Path, variables: tuple[str, ...], *columns: Array) -> Path:
    """Write a log of columns (n,) at 100 Hz."""
    event: Event = (65535, "fixedFrequency", variables)
    whole = [variable.endswith("(H)") for variable in variables]
    rows = [
        (
            65535,
            5_000_000 + round(1e6 / RATE_HZ) * at,
            [int(v) if one else float(v) for v, one in zip(row, whole, strict=True)],
        )
        for at, row in enumerate(zip(*columns, strict=True))
    ]
    return written(folder, bytes_of([event], rows))


def read(path: Path) -> RotorLog:
    log = rotor_log(path)
    assert log is not None
    return log


def seconds(result: Result, key: str) -> float:
    return 1 / float(result.quantities[key].value[0])


@pytest.fixture(scope="module")
def four(tmp_path_factory: pytest.TempPathFactory) -> RotorLog:
    """Two rotors that follow their commands, one whose sensor drops out, and one that shows only noise."""
    _, command, speed = flown(4, 7, noise=3.0, red=0.0)
    speed[2, ::50] = 0
    speed[3] = 1800 + 200 * np.random.default_rng(2).standard_normal(speed.shape[1])
    columns = [*(65535 * command[:, 0]), *(NEXT * speed)]
    return read(logged(tmp_path_factory.mktemp("log"), MOTORS + SPEEDS, *columns))


@pytest.fixture(scope="module")
def fitted_four(four: RotorLog) -> Result:
    return fit(four)


def test_the_known_lag_comes_back_and_a_bad_rotor_condemns_no_other(fitted_four: Result) -> None:
    result = fitted_four
    rows = result.quantities["dynamics.time_constant_s"].value

    assert result.accepted
    assert seconds(result, "dynamics.rising") == pytest.approx(RISING_S, rel=0.01)
    assert seconds(result, "dynamics.falling") == pytest.approx(FALLING_S, rel=0.01)
    delay = result.quantities["dynamics.delay_s"]
    assert abs(float(delay.value) - DELAY_S) < 3 * float(delay.std)
    assert [row["accepted"] for row in rows if row["rising"]] == [True, True, True, False]
    assert any("rotor 3: 50 of 2500 speeds are 0 while it is driven" in one.text for one in result.findings)
    assert any(one.where == ("rotor 4",) and one.severity == "warning" for one in result.findings)


def test_one_rotor_is_fitted_alone(four: RotorLog) -> None:
    result = fit(four.only(2))
    assert [row["rotor"] for row in result.quantities["dynamics.time_constant_s"].value] == [2, 2]
    assert result.quantities["dynamics.map"].value[0]["c1"] == pytest.approx(2600, rel=0.1)
    assert not fit(four.only(4)).accepted
    with pytest.raises(ConfigError, match="no rotor speeds"):
        replace(four, speeds={}).only(1)


def test_a_rotor_that_has_no_speed_is_refused_with_those_that_have(tmp_path: Path) -> None:
    one = read(logged(tmp_path, (MOTORS[2], SPEEDS[2]), np.full(500, 30000), np.full(500, 9000)))
    with pytest.raises(ConfigError, match="`rotor` 2: the log has speeds of rotor 3 alone"):
        one.only(2)


def test_a_voltage_that_is_logged_in_few_rows_is_used(tmp_path: Path) -> None:
    volts = np.where(np.arange(500) % 20 == 0, 3.9, math.nan)
    assert read(logged(tmp_path, (MOTORS[0], SPEEDS[0], "pm.vbat(f)"), *np.full((2, 500), 9000), volts)).volts


@pytest.mark.parametrize("bad", [math.nan, 0.0])
def test_a_few_voltages_and_speeds_that_are_missing_are_left_out_and_named(tmp_path: Path, bad: float) -> None:
    _, command, speed = flown(1, 7, noise=3.0, red=0.0)
    rows = speed.shape[1]
    volts, rpm = np.full(rows, 3.9), NEXT * speed[0]
    volts[100:200], rpm[500:700] = bad, math.nan
    log = read(logged(tmp_path, (MOTORS[0], "rpm.m1(f)", "pm.vbat(f)"), 65535 * command[0, 0], rpm, volts))
    result = fit(log)

    assert log.volts == "pm.vbat"
    assert seconds(result, "dynamics.rising") == pytest.approx(RISING_S, rel=0.01)
    said = " ".join(one.text for one in result.findings)
    assert f"rotor 1: 200 of {rows} speeds are no numbers, and left out" in said
    where = "no number in 100 and impossible in 0" if math.isnan(bad) else "no number in 0 and impossible in 100"
    assert f"the battery's voltage is {where} of {rows} rows: these are left out" in said


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (0, 1e300),
        (0, 1e6),
        (0, -5.0),
        (1, 1e300),
        pytest.param(0, 1e12, marks=pytest.mark.slow),
        pytest.param(1, 1e100, marks=pytest.mark.slow),
    ],
)
def test_one_command_or_speed_that_cannot_be_is_left_out_and_named(tmp_path: Path, place: int, value: float) -> None:
    _, command, speed = flown(1, 7, noise=3.0, red=0.0)
    columns = np.array([65535 * command[0, 0], NEXT * speed[0]])
    columns[place, columns.shape[1] // 2] = value
    path = tmp_path / "log.csv"
    rows = "\n".join(f"{at / RATE_HZ:.3f},{u!r},{w!r}" for at, (u, w) in enumerate(columns.T.tolist()))
    path.write_text(f"t,motor.m1,rpm.m1\n{rows}\n", encoding="utf-8")
    result = fit(read(path))

    assert result.accepted
    assert "log-values-left-out" in [one.code for one in result.findings]
    assert seconds(result, "dynamics.rising") == pytest.approx(RISING_S, rel=0.01)
    assert seconds(result, "dynamics.falling") == pytest.approx(FALLING_S, rel=0.01)
    assert "motor.speed_poly" in result.without_rejected().quantities


@pytest.mark.parametrize(
    ("wrong", "begin", "count"),
    [
        (1.5, 900, 120),
        *(
            pytest.param(*one, marks=pytest.mark.slow)
            for one in ((8.0, 700, 1), (59.0, 700, 1), (12.0, 1900, 1), (41.0, 900, 200))
        ),
    ],
)
def test_a_voltage_that_the_others_refute_is_left_out_and_named(
    tmp_path: Path, wrong: float, begin: int, count: int
) -> None:
    rng, (_, command, speed) = np.random.default_rng(3), flown(1, 7, noise=3.0, red=0.0)
    sag = 0.2 * np.convolve(command[0, 0], np.ones(5) / 5, mode="same")
    volts = 4.1 - sag + rng.normal(0, 0.004, len(sag))
    commands = np.round(65535 * command[0, 0] * 3.6 / (4.1 - sag))  # compensated: the speed does not sag

    def read_with(volts: Array) -> RotorLog:
        columns = (commands, NEXT * speed[0], volts)
        return read(logged(tmp_path, (MOTORS[0], "rpm.m1(f)", "pm.vbat(f)"), *columns))

    whole = fit(read_with(volts)).quantities
    volts[begin : begin + count] = wrong
    result = fit(read_with(volts))

    where = f"no number in 0 and impossible in {count} of {len(volts)} rows: these are left out (the first {wrong:g} V"
    assert any(where in one.text for one in result.findings)
    for key in ("dynamics.rising", "dynamics.falling"):
        assert abs(result.quantities[key].value[0] - whole[key].value[0]) < whole[key].std[0]


def test_a_rotor_whose_controller_holds_its_speed_condemns_no_other_that_goes_with_the_voltage(tmp_path: Path) -> None:
    rng, (_, command, speed) = np.random.default_rng(3), flown(2, 7, noise=3.0, red=0.0)
    sag = 0.3 * np.convolve(command[0, 0], np.ones(5) / 5, mode="same")
    volts = 4.1 - sag + rng.normal(0, 0.004, len(sag))
    commands = 65535 * command[:, 0] * np.array([3.6 / (4.1 - sag), np.ones(len(sag))])
    result = fit(
        read(logged(tmp_path, (*MOTORS[:2], "rpm.m1(f)", "rpm.m2(f)", "pm.vbat(f)"), *commands, *(NEXT * speed), volts))
    )

    assert result.accepted
    assert [one.where for one in result.findings if one.code == "lag-voltage-unfelt"] == [("rotor 2",)]
    for key, tau_s in (("dynamics.rising", RISING_S), ("dynamics.falling", FALLING_S)):
        assert abs(result.quantities[key].value[0] - 1 / tau_s) < 3 * result.quantities[key].std[0]


def test_a_voltage_that_is_mostly_impossible_is_not_used_and_that_is_said(tmp_path: Path) -> None:
    volts = np.where(np.arange(500) < 200, 0.0, 3.9)
    log = read(logged(tmp_path, (MOTORS[0], SPEEDS[0], "pm.vbat(f)"), *np.full((2, 500), 9000), volts))
    assert log.volts is None
    assert "impossible in 200 of 500 rows: it is not used (limit 10% impossible)" in " ".join(
        f.text for f in log.findings
    )


def about(result: Result, rotor: int) -> dict[str, str]:
    """Return the sentences about a rotor by their codes."""
    return {one.code: one.text for one in result.findings if one.where == (f"rotor {rotor}",)}


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Array, Array]:
    """Commands (2, n) and speeds in rpm (2, n) of two rotors, and a folder for their logs."""
    _, command, speed = flown(2, 11, noise=3.0, red=0.0)
    return tmp_path_factory.mktemp("two"), 65535 * command[:, 0], NEXT * speed


def fitted_two(two: tuple[Path, Array, Array], name: str, speed: Array) -> Result:
    folder = two[0] / name
    folder.mkdir()
    return fit(read(logged(folder, MOTORS[:2] + SPEEDS[:2], *two[1], *speed)))


def test_a_speed_that_stands_still_is_named_as_that(two: tuple[Path, Array, Array]) -> None:
    speed = two[2].copy()
    speed[1] = 14321
    result = fitted_two(two, "still", speed)

    assert seconds(result, "dynamics.rising") == pytest.approx(RISING_S, rel=0.01)
    assert "stands still, at 1500 rad/s, while its command moves" in about(result, 2)["lag-rotor-left-out"]


def test_a_speed_that_follows_another_command_is_named_as_that(two: tuple[Path, Array, Array]) -> None:
    result = fitted_two(two, "swapped", two[2][::-1])

    assert not result.accepted
    for rotor, other in ((1, 2), (2, 1)):
        assert f"follows the command of motor {other}" in about(result, rotor)["lag-other-command"]
        assert "its command moves and a first-order lag explains only" in about(result, rotor)["lag-misfit"]
        assert "lag-not-excited" not in about(result, rotor)


@pytest.mark.parametrize(
    ("share", "times"),
    [(0.01, 1.6), (0.15, 3.0), *(pytest.param(*one, marks=pytest.mark.slow) for one in ((0.01, 3.0), (0.15, 1.6)))],
)
def test_speeds_that_no_command_leads_to_are_left_out_and_named(
    two: tuple[Path, Array, Array], share: float, times: float
) -> None:
    speed, draw = two[2].copy(), np.random.default_rng(5)
    bad = draw.random(speed.shape[1]) < share
    speed[0, bad] = times * speed[0].max()
    bad_from = round((1 - share) * speed.shape[1])
    speed[1, bad_from:] = times * speed[1].max() * draw.uniform(0.97, 1.03, speed.shape[1] - bad_from)
    result = fitted_two(two, f"odd {share} {times}", speed)

    rows = result.quantities["dynamics.time_constant_s"].value
    assert all(row["accepted"] for row in rows)
    for row in rows:
        assert row["time_constant_s"] == pytest.approx(RISING_S if row["rising"] else FALLING_S, rel=0.02)
    for rotor in (1, 2):
        assert "lie far outside all that its commands lead to" in about(result, rotor)["lag-speeds-left-out"]


def test_a_stretch_of_one_reading_is_left_out_and_its_time_named(two: tuple[Path, Array, Array]) -> None:
    speed = two[2].copy()
    speed[0, 1000:1400] = speed[0, 1000]
    result = fitted_two(two, "stretch", speed)

    assert seconds(result, "dynamics.rising") == pytest.approx(RISING_S, rel=0.01)
    text = about(result, 1)["lag-speeds-left-out"]
    assert "400 speeds of 2399, from 10.0 to 14.0 s, stand still for a second or longer" in text
    assert "lag-speeds-left-out" not in about(result, 2)


def test_a_command_that_hardly_moves_is_refused(tmp_path: Path) -> None:
    rows, draw = 1500, np.random.default_rng(3)
    commands: dict[str, Array] = {"rests": np.full(rows, 30000.0), "creeps": np.linspace(30000, 31499, rows)}
    for name, command in commands.items():
        (tmp_path / name).mkdir()
        speed = NEXT * (1500 + 0.01 * (command - 30000) + draw.normal(0, 5, rows))
        result = fit(read(logged(tmp_path / name, (MOTORS[0], SPEEDS[0]), command, speed)))
        assert not result.accepted
        assert any(one.code == "lag-not-excited" for one in result.findings)


@pytest.mark.parametrize("levels", [2, 3])
def test_a_command_of_two_levels_is_asked_for_a_third(tmp_path: Path, levels: int) -> None:
    """For a clean square wave on a battery, messages asked for more excitation and denied that its speed map rises."""
    draw, change_s, time_s = np.random.default_rng(3), np.arange(0.0, 15.0, 0.5), np.arange(1500) / 100
    command = np.array([30000.0, 38000.0, 46000.0])[np.arange(len(change_s)) % levels]
    held = command[np.searchsorted(change_s, time_s + 1e-9, side="right") - 1]
    speed = following(change_s, 0.03 * command + 430, time_s) + draw.normal(0, 3.0, len(time_s))
    volts = np.full(len(time_s), 3.9)
    result = fit(read(logged(tmp_path, (MOTORS[0], SPEEDS[0], "pm.vbat(f)"), held, NEXT * speed, volts)))

    texts = " ".join(one.text for one in result.findings)
    if not result.accepted:
        assert levels == 2
        assert "two levels alone" in texts
    assert "excite the rotor more" not in texts
    assert "does not rise" not in texts


def test_a_record_that_is_too_short_or_shows_nothing_is_an_error(tmp_path: Path, four: RotorLog) -> None:
    with pytest.raises(FitError, match="limit 200"):
        fit(four.between(0, 2.5))
    with pytest.raises(ConfigError, match="no rows between"):
        four.between(100, 200)
    bare = read(logged(tmp_path, MOTORS[:1], np.full(500, 30000)))
    with pytest.raises(DataError, match="use `cfid fit flight`"):
        fit(bare)


@pytest.mark.parametrize("step_s", [0.1, 0.13])
def test_commands_that_were_recorded_too_slowly_are_named(tmp_path: Path, step_s: float) -> None:
    table = tmp_path / "stand.csv"
    rows = (f"{step_s * at:.3f},{20000 + 500 * (at % 7)},{9000 + 100 * (at % 7)}\n" for at in range(300))
    table.write_text("t_s,cmd,rpm\n" + "".join(rows))
    log = of_stand(stand_of(read_stand(table)))
    assert log is not None
    with pytest.raises(DataError, match=rf"recorded every {step_s:.2g} s, and not within 0.1 s"):
        fit(log)


def test_parts_of_a_long_log_join_to_the_fit_of_the_whole() -> None:
    time_s, command, speed = flown(1, 21, noise=5.0, red=15.0)
    speed[0, 1800:] += 30  # the map drifts

    def fitted(first: int, last: int) -> LagFit:
        part = slice(first, last)
        drive, measured = Signal(time_s[part], command[0, 0, part]), Signal(time_s[part], speed[0, part])
        return fit_lag([LogSegment(drive, measured)])

    parts, whole = [fitted(0, 900), fitted(800, 1700), fitted(1700, 2500)], fitted(0, 1700)
    same, drifted = joined(parts[:2]), joined(parts)
    np.testing.assert_allclose(same.lag, whole.lag, atol=0.7e-3)
    np.testing.assert_allclose(same.std_s, whole.std_s, rtol=0.35)
    truth = np.array([RISING_S, FALLING_S, DELAY_S])
    assert np.all(np.abs(np.array(drifted.lag) - truth) < 3 * np.array(drifted.std_s))
    assert drifted.map_std[0] > same.map_std[0]  # the difference between the parts widens it


def test_parts_that_differ_by_more_than_their_uncertainties_widen_their_mean() -> None:
    """Each number of two parts is two std from the mean: the squares sum to 48 over six degrees of freedom."""
    std = np.array([10.0, 20.0, 30.0, 1e-3, 2e-3, 3e-3])
    mean = np.array([100.0, 2000.0, 300.0, 0.05, 0.07, 0.01])
    parts = [
        LagFit(
            lag=InputLag(*values[3:].tolist()),
            covariance=np.diag(std**2),
            map=(float(values[0]), float(values[1]), float(values[2])),
            explained=0.9,
            rms=1.0,
            drift=0.0,
            time_s=np.zeros(2),
            measured=np.zeros(2),
            shown=np.array([0.0, at]),
            findings=(),
        )
        for at, values in enumerate((mean - 2 * std, mean + 2 * std))
    ]
    whole = joined(parts)

    np.testing.assert_allclose([*whole.map, *whole.lag], mean, rtol=1e-12)
    np.testing.assert_allclose(whole.covariance, 8 * np.diag(std**2) / 2, rtol=1e-12)
    assert whole.shown[1] == 1


def test_a_command_that_changes_between_rows_widens_the_delay_and_is_refused_from_half_a_time_constant() -> None:
    time_s, command, speed = flown(1, 5, noise=5.0, red=0.0)
    segment = LogSegment(Signal(time_s, command[0, 0]), Signal(time_s, speed[0]))
    seen, between, slow = (fit_lag([segment], row_s=each, moving=True) for each in (0.0, 0.02, 0.04))
    added_s = np.sqrt(between.std_s.delay_s**2 - seen.std_s.delay_s**2)

    early_s = np.linspace(0, 0.02, 10_001)  # uniform within the interval, and one-sided: its mean is known
    assert added_s == pytest.approx(np.std(early_s), rel=1e-3)
    assert between.lag.delay_s - seen.lag.delay_s == pytest.approx(np.mean(early_s))
    assert between.accepted
    assert [one.code for one in slow.findings] == ["lag-log-too-slow"]


@pytest.mark.parametrize("rate_hz", [100, 500])
def test_commands_that_change_between_rows_leave_the_delay_within_its_uncertainty(tmp_path: Path, rate_hz: int) -> None:
    """The plant takes commands at any time; rows show them up to one row interval late."""
    fine_s, rng = 1e-4, np.random.default_rng(2)
    rows = round(1 / rate_hz / fine_s)
    command = np.repeat(rng.uniform(20000, 50000, 300), rng.integers(500, 1500, 300))
    late = np.concatenate([np.full(round(DELAY_S / fine_s), command[0]), command])[: len(command)]
    speed = np.empty(len(command))
    now = 0.035 * late[0]
    for place, to in enumerate(0.035 * late):
        now += (to - now) * -np.expm1(-fine_s / (0.06 if to > now else 0.09))
        speed[place] = now
    path = tmp_path / "log.csv"
    at = slice(None, None, rows)
    shown = {"motor.m1": command[at].astype(int), "rpm.m1": 60 / (2 * np.pi) * speed[at]}
    count = len(shown["motor.m1"])
    pd.DataFrame({"t_ms": np.arange(count) * 1000 // rate_hz, **shown}).to_csv(path, index=False)
    result = fit(read(path))
    delay = result.quantities["dynamics.delay_s"]
    print(f"{1e3 * delay.value:.2f} +- {1e3 * delay.std:.2f} ms")
    assert abs(float(delay.value) - DELAY_S) < 2 * float(delay.std)
    assert float(delay.std) < 0.7 / rate_hz
    assert any(one.code == "lag-command-between-rows" for one in result.findings)


def test_rotors_of_one_log_share_how_late_rows_show_a_command(tmp_path: Path) -> None:
    """All rotors share the error of late rows, so the mean of four rotors is no better known than one rotor."""
    time_s, command, speed = flown(1, 5, noise=5.0, red=0.0)
    columns = {f"motor.m{motor}": (65535 * command[0, 0]).astype(int) for motor in (1, 2, 3, 4)}
    columns |= {f"rpm.m{motor}": NEXT * speed[0] for motor in (1, 2, 3, 4)}
    pd.DataFrame({"t_ms": (1000 * time_s).astype(int), **columns}).to_csv(tmp_path / "log.csv", index=False)
    delay = fit(read(tmp_path / "log.csv")).quantities["dynamics.delay_s"]
    assert float(delay.std) > 1 / RATE_HZ / np.sqrt(12)


def test_voltage_belongs_to_the_drive(tmp_path: Path) -> None:
    time_s, command, speed = flown(1, 9, noise=3.0, red=0.0)
    volts = 4.0 - 0.5 * time_s / time_s[-1]
    commands = np.round(65535 * command[0, 0] * 3.5 / volts)  # compensated: the speed does not sag
    result = fit(read(logged(tmp_path, (MOTORS[0], SPEEDS[0], "pm.vbat(f)"), commands, NEXT * speed[0], volts)))
    assert result.quantities["dynamics.map"].value[0]["over"] == "cmd / 65535 * V"
    assert result.quality["explained"]["rotor 1"] > 0.999

    at_v = float(np.interp(time_s, time_s, volts).mean())
    at = np.array([25000.0, 40000.0, 55000.0])
    share = at / 65535 * at_v / 3.5
    found = np.polyval(result.quantities["motor.speed_poly"].value, at)
    np.testing.assert_allclose(found, 400 + 2600 * share - 500 * share**2, rtol=2e-3)
    (about,) = (one.text for one in result.findings if one.code == "speed-map-voltage")
    assert f"holds at {at_v:.2f} V" in about


def test_a_speed_in_proportion_to_the_voltage_is_not_said_to_change_at_the_same_voltage(tmp_path: Path) -> None:
    _, command, speed = flown(1, 9, noise=3.0, red=0.0, sag=0.1)  # sag of the whole speed, with its offset
    volts = np.linspace(4.1, 3.69, speed.shape[1])
    columns = (65535 * command[0, 0], NEXT * speed[0], volts)
    result = fit(read(logged(tmp_path, (MOTORS[0], SPEEDS[0], "pm.vbat(f)"), *columns)))
    text = next(one.text for one in result.findings if one.code == "lag-map-drifts")

    assert "at the same command and voltage" not in text
    assert "or its speed goes with the voltage in another way than with the command" in text


def test_a_battery_that_sags_unlogged_is_named_and_the_map_holds_in_the_middle(tmp_path: Path) -> None:
    _, command, speed = flown(1, 9, noise=3.0, red=0.0, sag=0.1)
    result = fit(read(logged(tmp_path, (MOTORS[0], SPEEDS[0]), 65535 * command[0, 0], NEXT * speed[0])))
    (drifts,) = (one.text for one in result.findings if one.code == "lag-map-drifts")
    at = np.array([25000.0, 40000.0, 55000.0])
    found = np.polyval(result.quantities["motor.speed_poly"].value, at)

    assert float(re.findall(r"changed by (-[\d.]+) %", drifts)[0]) == pytest.approx(
        -10 / 0.95 * 24 / 25, abs=0.1
    )  # after 1 s of 25
    assert "Log the battery's voltage" in drifts
    np.testing.assert_allclose(found, 0.95 * np.polyval([-500, 2600, 400], at / 65535), rtol=5e-3)
    assert seconds(result, "dynamics.rising") == pytest.approx(RISING_S, rel=0.01)


def test_the_speed_map_that_was_fitted_with_the_lag_is_the_mean_of_the_rotors_with_its_uncertainty(
    fitted_four: Result,
) -> None:
    result = fitted_four
    poly, covariance = result.quantities["motor.speed_poly"], result.covariances[0]
    at = np.array([[25000.0**2, 25000, 1], [55000.0**2, 55000, 1]])
    known = np.array(covariance.matrix)[-3:, -3:]
    std = np.sqrt(np.diag(at @ known @ at.T))
    truth = np.polyval([-500, 2600, 400], at[:, 1] / 65535)

    assert covariance.of[-1] == "motor.speed_poly"
    np.testing.assert_allclose(np.sqrt(np.diag(known)), poly.std, rtol=1e-9)
    assert np.all(np.abs(at @ poly.value - truth) < 3 * std)
    assert np.all(std < 5)
    (about,) = (one.text for one in result.findings if one.code == "speed-map-voltage")
    assert "the log has no battery voltage" in about
    assert "mean of rotors 1, 2, 3 for commands from 22" in about


def test_a_speed_map_that_falls_is_rejected_and_the_lag_is_not(tmp_path: Path) -> None:
    _, command, speed = flown(1, 9, noise=3.0, red=0.0)
    result = fit(read(logged(tmp_path, (MOTORS[0], SPEEDS[0]), 65535 * (1 - command[0, 0]), NEXT * speed[0])))
    assert result.accepted
    assert "motor.speed_poly" in result.rejected
    assert "motor.speed_poly" not in result.without_rejected().quantities


def scaled(folder: Path, low: float, high: float) -> Result:
    """Return the fit of a log whose commands go from `low` to `high`."""
    _, command, speed = flown(1, 9, noise=3.0, red=0.0)
    names = MOTORS[0].replace("(H)", "(f)"), SPEEDS[0]
    return fit(read(logged(folder, names, low + (high - low) * command[0, 0], NEXT * speed[0])))


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return scaled(tmp_path_factory.mktemp("usual"), 0.0, 65535.0)


@pytest.mark.parametrize(
    ("low", "high", "scale"),
    [
        (0.0, 1.0, "shares of one"),
        (0.0, 100.0, "per cent"),
        (0.0, 255.0, "of 8 bits"),
        (1000.0, 2000.0, "pulse widths"),
    ],
)
def test_commands_on_another_scale_give_the_lag_and_no_map(
    usual: Result, tmp_path: Path, low: float, high: float, scale: str
) -> None:
    other = scaled(tmp_path, low, high)
    assert "motor.speed_poly" in usual.quantities.keys() - usual.rejected
    assert "motor.speed_poly" in other.rejected
    assert any(scale in one.text for one in other.findings if one.code == "commands-of-another-scale")
    first, second = (one.quantities["dynamics.rising"] for one in (usual, other))
    assert second.value[0] == pytest.approx(first.value[0], abs=0.5 * first.std[0])


def campaign(folder: Path, cfid: Cfid) -> Path:
    assert cfid("new", folder / "campaign").returncode == 0
    return folder / "campaign"


def test_a_stand_s_table_of_a_command_that_never_rests_gives_the_lag(tmp_path: Path, cfid: Cfid) -> None:
    time_s, command, speed = flown(1, 11, noise=3.0, red=0.0)
    pulse_us = 1000 + 1000 * command[0, 0]
    table = tmp_path / "stand.csv"
    rows = (f"{t:.2f},{u:.3f},{NEXT * w:.3f}\n" for t, u, w in zip(time_s, pulse_us, speed[0], strict=True))
    table.write_text("Time (s),ESC signal (µs),Motor Optical Speed (RPM)\n" + "".join(rows), encoding="utf-8")
    shown = cfid("fit", "dynamics", table, "--json")
    assert shown.returncode == 0, shown.stderr
    parameters = json.loads(shown.stdout)["parameters"]
    times = [row["time_constant_s"] for row in parameters["dynamics.time_constant_s"]["value"]]
    assert times == pytest.approx([RISING_S, FALLING_S], rel=0.02)
    assert not {"dynamics.rising", "dynamics.falling"} & set(parameters)  # one rate is not the rotor model
    (row,) = parameters["dynamics.map"]["value"]
    assert row["of"] == "rad/s"
    at = np.array([1, 0.6, 0.36])
    assert row["c0"] + row["c1"] * 0.6 + row["c2"] * 0.36 == pytest.approx(at @ [400, 2600, -500], rel=5e-3)
    assert all(row[f"std_c{power}"] > 0 for power in range(3))


def test_the_command_recognises_a_log_and_a_table_of_a_stand(tmp_path: Path, four: RotorLog, cfid: Cfid) -> None:
    shown = cfid("fit", "dynamics", four.path, "--rotor", "1", "--json")
    assert shown.returncode == 0, shown.stderr
    rising = json.loads(shown.stdout)["parameters"]["dynamics.rising"]["value"]
    assert rising == [pytest.approx(1 / RISING_S, rel=0.02), 0]

    made = cfid("import", four.path, "--campaign", campaign(tmp_path, cfid))
    assert made.returncode == 0, made.stderr
    (run,) = (tmp_path / "campaign" / "runs").iterdir()
    of_run = cfid("fit", "dynamics", run, "--rotor", "1", "--json", "--campaign", tmp_path / "campaign")
    assert of_run.returncode == 0, of_run.stderr
    assert json.loads(of_run.stdout)["parameters"]["dynamics.rising"]["value"] == pytest.approx(rising, rel=1e-3)

    stand = tmp_path / "stand.csv"
    stand.write_text("t_s,pwm,rpm_mean\n" + "".join(f"{at / 100},10000,5000\n" for at in range(300)))
    refused = cfid("fit", "dynamics", stand, "--rotor", "1")
    assert refused.returncode == 2
    assert "are for commands that never rest" in refused.stderr
    assert "no step of the command" in cfid("fit", "dynamics", stand).stderr


def test_a_fault_of_a_flight_table_s_time_is_not_taken_for_one_of_a_stand_s_columns(tmp_path: Path) -> None:
    table = tmp_path / "flight.csv"
    rows = "".join(f"{1000 + 10 * at % 300},30000,12000\n" for at in range(60))
    table.write_text("Timestamp,motor.m1,rpm.m1\n" + rows)
    with pytest.raises(DataError, match=r"flight.csv:32: time goes back from 1290 to 1000"):
        rotor_log(table)


def test_where_whitening_and_drift_move_a_lag_beyond_noise_that_counts_in_its_uncertainty(tmp_path: Path) -> None:
    """A chirp logged at 50 Hz on a supply whose voltage falls with the speed, which lowers the speed in turn."""
    rng, row_s, in_std = np.random.default_rng(4), 0.02, []
    for seed in range(4):
        time_s, fine_s = np.arange(0, 60, row_s), 1e-3
        fine = np.arange(0, 60, fine_s)
        drive = 0.55 + 0.3 * np.sin(2 * np.pi * (0.05 + 0.025 * (1 + seed / 10) * fine) * fine)
        speed, now = np.empty(len(fine)), 800.0
        for place, to in enumerate(60 + 1500 * drive):
            leads_to = to * (1 - 0.06 * (now / 1500) ** 2)
            now += (leads_to - now) * -np.expm1(-fine_s / (0.1 if leads_to > now else 0.15))
            speed[place] = now
        at = np.round(time_s / fine_s).astype(int)
        path = tmp_path / f"stand{seed}.csv"
        columns = {
            "Time (s)": time_s,
            "ESC signal (µs)": np.round(1000 + 1000 * drive[at]),
            "Motor Optical Speed (RPM)": NEXT * (speed[at] + rng.normal(0, 2.0, len(at))),
            "Voltage (V)": 16 * (1 - 0.06 * (speed[at] / 1500) ** 2) + rng.normal(0, 0.01, len(at)),
        }
        pd.DataFrame(columns).to_csv(path, index=False)
        found = of_stand(stand_of(read_stand(path)))
        assert found is not None
        result = fit(found)
        for key, tau_s in (("dynamics.rising", 0.1), ("dynamics.falling", 0.15)):
            quantity = result.quantities[key]
            in_std.append((quantity.value[0] - 1 / tau_s) / quantity.std[0])

    assert np.abs(in_std).max() < 3
