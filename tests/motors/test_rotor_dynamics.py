"""Steps of the command give back the lags and the rotor model that made them, from speed and vibration."""

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import chi2

from cfid.errors import FitError
from cfid.motors.steps.data import SpeedRecord
from cfid.motors.steps.estimation import fit_steps
from cfid.motors.steps.model import Lag, command_steps, followed
from cfid.motors.steps.result import fit
from cfid.motors.steps.rotor_model import fit_rotor_model
from cfid.motors.steps.sag import LoggedBattery
from tests.motors.sentences import rejections

Array = npt.NDArray[np.float64]

LEVELS = (600.0, 1200.0, 2000.0, 1500.0, 2400.0, 900.0)
HOLD_S, RATE_HZ = 1.0, 200.0
TIME_S = np.arange(0.0, HOLD_S * len(LEVELS), 1 / RATE_HZ)
COMMAND = np.array(LEVELS)[(TIME_S / HOLD_S + 1e-9).astype(int)]
STEPS = command_steps(time_s=TIME_S, command=COMMAND)


def followed_speed(rising: tuple[float, float], falling: tuple[float, float]) -> Array:
    """Integrate the rotor model through all steps; each way has a linear and a quadratic coefficient (1/s, 1/rad)."""
    speed, parts = LEVELS[0], []
    for level in LEVELS:
        linear, quadratic = rising if level > speed else falling

        def rate(_: float, w: Array, c: float = level, k1: float = linear, k2: float = quadratic) -> Array:
            return k1 * (c - w) + k2 * (c**2 - w**2)

        at = np.arange(0.0, HOLD_S + 0.5 / RATE_HZ, 1 / RATE_HZ)
        course = solve_ivp(rate, (0, at[-1]), [speed], t_eval=at, rtol=1e-9, atol=1e-6).y[0]
        parts.append(course[:-1])
        speed = float(course[-1])
    return np.concatenate(parts)


def noise(seed: int, std: float) -> Array:
    return np.asarray(std * np.random.default_rng(seed).standard_normal(len(TIME_S)))


def test_steps_with_a_plain_lag_give_it_back_and_their_errors_are_as_large_as_stated() -> None:
    exact, in_std = followed_speed((10.0, 0.0), (5.0, 0.0)), []
    for seed in range(1, 11):
        for lag in fit_steps(time_s=TIME_S, value=exact + noise(seed, 3.0), steps=STEPS):
            true_s = 0.1 if lag.rising else 0.2
            assert lag.accepted
            assert lag.time_constant_s == pytest.approx(true_s, rel=0.03)
            assert abs(lag.delay_s) < 0.002
            in_std.append((lag.time_constant_s - true_s) / lag.time_constant_std_s)

    assert 0.001 < chi2.sf(np.sum(np.square(in_std)), len(in_std)) < 0.999


def test_the_four_coefficients_come_back() -> None:
    speed = followed_speed((3.0, 2.5e-3), (1.0, 1.5e-3)) + noise(2, 1.0)
    model = fit_rotor_model(time_s=TIME_S, steps=STEPS, value=speed)

    assert model.rising == pytest.approx((3.0, 2.5e-3), rel=0.1)
    assert model.falling == pytest.approx((1.0, 1.5e-3), rel=0.1)
    assert abs(model.rising[1] - 2.5e-3) < 3 * model.rising_std[1]
    assert model.accepted


def test_commands_that_change_between_rows_leave_the_rates_and_their_uncertainty_right() -> None:
    row_s, rising_s, falling_s = 0.02, 0.1, 0.15
    time_s, levels = np.arange(0.0, 24.0, row_s), np.array([0, 900, 1500, 2100, 2700, 2100, 1200, 600])
    held = levels[(time_s / 3 + 1e-9).astype(int)]
    steps, in_std = command_steps(time_s=time_s, command=held), []
    for seed in range(12):
        rng, speed, now = np.random.default_rng(seed), np.zeros(len(time_s)), 0.0
        for place, level in enumerate(levels):
            tau_s = rising_s if level > now else falling_s
            since_s = time_s - 3 * place + rng.uniform(0, row_s)  # the change precedes its first row by up to a row
            after = since_s >= 0
            speed[after] = level + (now - level) * np.exp(-since_s[after] / tau_s)
            now = float(level)
        model = fit_rotor_model(
            time_s=time_s, value=speed + rng.normal(0, 3.0, len(time_s)), steps=steps, command_row_s=row_s
        )
        at = np.array([1.0, 3000.0])  # the rate at 1500 rad/s
        for found, own, tau_s in (
            (model.rising, model.covariance[:2, :2], rising_s),
            (model.falling, model.covariance[2:, 2:], falling_s),
        ):
            in_std.append((at @ found - 1 / tau_s) / math.sqrt(at @ own @ at))

    assert np.abs(in_std).max() < 4
    assert 0.5 < np.sqrt(np.mean(np.square(in_std))) < 1.5


def test_the_covariance_is_that_of_the_four_coefficients_in_their_order() -> None:
    model = fit_rotor_model(
        time_s=TIME_S, value=followed_speed((3.0, 2.5e-3), (1.0, 1.5e-3)) + noise(2, 1.0), steps=STEPS
    )
    std = np.array([*model.rising_std, *model.falling_std])

    assert np.sqrt(np.diag(model.covariance)) == pytest.approx(std, rel=1e-12)
    # The two coefficients of one direction can replace each other; the two directions share no step.
    correlation = model.covariance / np.outer(std, std)
    assert correlation[0, 1] < -0.9
    assert correlation[2, 3] < -0.9
    assert np.abs(correlation[:2, 2:]).max() < 0.3


def test_without_a_speed_before_the_command_the_delay_is_not_told_and_the_lag_is() -> None:
    speed = followed_speed((10.0, 0.0), (5.0, 0.0)) + noise(3, 2.0)
    speed[(TIME_S < 1.03) | (TIME_S >= 2)] = np.nan
    steps = followed(STEPS, time_s=TIME_S, value=speed)
    (lag,) = fit_steps(time_s=TIME_S, value=speed, steps=steps)

    assert steps == STEPS[:1]
    assert math.isnan(lag.delay_std_s)
    assert lag.time_constant_s == pytest.approx(0.1, rel=0.03)


def test_a_way_that_no_step_went_has_no_coefficients() -> None:
    early = TIME_S < 3
    steps = command_steps(time_s=TIME_S[early], command=COMMAND[early])
    speed = followed_speed((10.0, 0.0), (5.0, 0.0)) + noise(4, 1.0)
    model = fit_rotor_model(time_s=TIME_S[early], value=speed[early], steps=steps)

    assert math.isnan(model.falling[0])
    assert math.isnan(model.falling[1])
    assert 1 / (model.rising[0] + 2 * model.rising[1] * 2000) == pytest.approx(0.1, rel=0.1)


def test_what_is_no_lag_or_too_short_is_not_believed() -> None:
    slow = fit_steps(time_s=TIME_S, value=followed_speed((0.8, 0.0), (0.8, 0.0)) + noise(6, 0.1), steps=STEPS[:2])
    assert all("its final speed is not known" in rejections(lag)[0] for lag in slow)
    drawn = fit_steps(time_s=TIME_S, value=1000 + noise(5, 50.0), steps=STEPS)
    assert not any(lag.accepted for lag in drawn)


def test_no_step_and_too_few_samples_are_refused() -> None:
    with pytest.raises(FitError, match="no step of the command"):
        fit_steps(time_s=TIME_S, value=TIME_S, steps=())
    with pytest.raises(FitError, match="fewer than 8 samples"):
        fit_steps(time_s=TIME_S[::50], value=TIME_S[::50], steps=STEPS)


def test_on_a_battery_that_sags_the_time_constant_is_that_with_a_supply() -> None:
    inner_v, hold_s, tau_s = 0.35, 1.5, 0.06  # of 4 V at the highest speed
    at_s = np.arange(0.0, hold_s, 0.005)
    commands = (0.0, 20000.0, 0.0, 40000.0, 0.0, 60000.0)
    time_s = np.concatenate([place * hold_s + at_s for place in range(len(commands))])
    speed, volts, now = [], [], 0.0
    for command in commands:

        def rate(_: float, w: Array, command: float = command) -> Array:
            leads_to = (400 + 0.04 * command * (4.0 - inner_v * (w / 2500) ** 3) / 3.8) * (command > 0)
            return np.asarray((leads_to - w) / tau_s)

        course = solve_ivp(rate, (0, hold_s), [now], t_eval=at_s, rtol=1e-8, atol=1e-6).y[0]
        speed.append(course)
        volts.append(4.0 - inner_v * (course / 2500) ** 3)
        now = float(course[-1])
    measured = np.concatenate(speed) + np.random.default_rng(3).normal(0, 1.0, len(time_s))
    held = np.repeat(commands, len(at_s))
    battery = LoggedBattery(time_s[::20], np.concatenate(volts)[::20])  # ten times a second
    steps = command_steps(time_s=time_s, command=held)
    rising = [one for one in fit_steps(time_s=time_s, value=measured, steps=steps, battery=battery) if one.rising]
    plain = [one for one in fit_steps(time_s=time_s, value=measured, steps=steps) if one.rising]

    assert [one.time_constant_s for one in rising] == pytest.approx([tau_s] * 3, rel=0.02)
    assert all(abs(one.time_constant_s - tau_s) < 3 * one.time_constant_std_s for one in rising)
    assert plain[-1].time_constant_s < 0.9 * tau_s
    assert all(one.sag == 0 for one in plain)
    model = fit_rotor_model(time_s=time_s, value=measured, steps=steps, battery=battery)
    assert model.rising[0] + 2 * model.rising[1] * 2000 == pytest.approx(1 / tau_s, rel=0.05)


def test_a_lag_that_is_longer_than_its_step_is_judged_without_a_warning() -> None:
    time_s = np.arange(10) / 8
    step = command_steps(time_s=time_s, command=np.where(time_s < 0.1, 0.0, 30000.0))
    (ramp,) = fit_steps(time_s=time_s, value=100.0 + 5 * time_s, steps=step)
    (still,) = fit_steps(time_s=time_s, value=np.full(10, 100.0), steps=step)

    assert "its final speed is not known" in " ".join(rejections(ramp))
    assert still.explained == 0
    assert not still.accepted


@pytest.mark.parametrize("tau_s", [0.006, 0.015, 0.022])
def test_a_lag_that_ends_between_two_readings_is_left_open(tau_s: float) -> None:
    time_s, lag = TIME_S[::10], 1 / tau_s
    speed = followed_speed((lag, 0.0), (lag, 0.0))[::10] + noise(3, 0.5)[::10]
    steps = command_steps(time_s=time_s, command=COMMAND[::10])
    for found in fit_steps(time_s=time_s, value=speed, steps=steps):
        assert not found.accepted
        assert "between two readings, 50 ms apart" in " ".join(rejections(found))


def test_a_lag_as_long_as_the_time_between_two_readings_is_found() -> None:
    time_s = TIME_S[::10]
    speed = followed_speed((20.0, 0.0), (20.0, 0.0))[::10] + noise(3, 0.5)[::10]
    steps = command_steps(time_s=time_s, command=COMMAND[::10])
    for found in fit_steps(time_s=time_s, value=speed, steps=steps):
        assert found.accepted
        assert abs(found.time_constant_s - 0.05) < 3 * found.time_constant_std_s < 0.005


def test_many_short_steps_on_a_sagging_battery_show_with_which_power_of_its_voltage_speeds_go() -> None:
    row_s, falls_v, rising_s, falling_s = 0.02, 0.9, 0.1, 0.15
    rng, now, at_s = np.random.default_rng(11), 0.0, 0.0
    time_s, held, speed, volts = (list[Array]() for _ in range(4))
    while at_s < 50:
        command, hold_s = rng.choice(np.linspace(10000, 60000, 9)), rng.uniform(0.3, 1.2)

        def rate(_: float, w: Array, command: float = command) -> Array:
            leads_to = command / 25 * (1 - falls_v / 16 * (w / 2400) ** 2)
            return np.asarray((leads_to - w) / (rising_s if leads_to[0] > w[0] else falling_s))

        rows = np.arange(0.0, hold_s, row_s)
        course = solve_ivp(rate, (0, hold_s), [now], t_eval=[*rows, hold_s], rtol=1e-8, atol=1e-6).y[0]
        time_s.append(at_s + rows)
        held.append(np.full(len(rows), command))
        speed.append(course[:-1] + rng.normal(0, 2.0, len(rows)))
        volts.append(16 - falls_v * (course[:-1] / 2400) ** 2 + rng.normal(0, 0.01, len(rows)))
        now, at_s = float(course[-1]), at_s + len(rows) * row_s
    times, seen = np.concatenate(time_s), np.concatenate(speed)
    steps = followed(command_steps(time_s=times, command=np.concatenate(held)), time_s=times, value=seen)
    battery = LoggedBattery(times, np.concatenate(volts))
    fits = [one for one in fit_steps(time_s=times, value=seen, steps=steps, battery=battery) if one.accepted]
    power = next(one.battery for one in fits if one.battery is not None)
    off = [(one.time_constant_s - (rising_s if one.rising else falling_s)) / one.time_constant_std_s for one in fits]

    assert len(fits) > 40
    assert abs(power.power - 1) < 2.5 * power.power_std
    assert np.sqrt(np.mean(np.square(off))) < 1.5


def test_a_stiff_supply_under_a_hundred_steps_is_no_battery() -> None:
    times = np.arange(0.0, 110.0, 0.05)
    rng, command = np.random.default_rng(2), 10000.0 + 10000 * ((times // 1.0) % 4)
    battery = LoggedBattery(times, 16 + rng.normal(0, 1e-3, len(times)))
    follows = np.concatenate([[400.0], command[:-1] / 25])
    steps = command_steps(time_s=times, command=command)
    found = fit_steps(time_s=times, value=follows + rng.normal(0, 2.0, len(times)), steps=steps, battery=battery)
    assert not any(one.sag for one in found)


def test_readings_of_a_battery_that_follow_no_load_correct_no_step() -> None:
    times = np.arange(0.0, 110.0, 0.05)
    rng, command = np.random.default_rng(2), 10000.0 + 10000 * ((times // 1.0) % 4)
    speed, level = np.zeros(len(times)), 0.0
    for row, leads_to in enumerate(command / 25):
        speed[row] = level
        level += (leads_to - level) * 0.05 / 1.5  # slower than the commands: no speed settles
    battery = LoggedBattery(times, 4.0 - 8.0 * (speed / 1600) ** 2 + rng.normal(0, 1e-3, len(times)))
    steps = command_steps(time_s=times, command=command)
    fits = fit_steps(time_s=times, value=speed + rng.normal(0, 2.0, len(times)), steps=steps, battery=battery)
    assert all(np.isfinite(fit.time_constant_s) for fit in fits)


def test_steps_whose_speed_was_counted_wrong_for_a_while_are_off_the_map_of_the_others() -> None:
    rng, rows = np.random.default_rng(6), np.arange(0.0, 1.5, 0.02)
    commands = rng.permutation(np.repeat([15000.0, 25000, 35000, 45000, 55000], 4))
    now, parts = 0.0, list[Array]()
    for command in commands:
        leads_to = 100 + 0.04 * command
        parts.append(leads_to + (now - leads_to) * np.exp(-rows / 0.1))
        now = leads_to
    speed = np.concatenate(parts) + rng.normal(0, 3.0, len(commands) * len(rows))
    time_s, command = np.linspace(0.0, 0.02 * (len(speed) - 1), len(speed)), np.repeat(commands, len(rows))
    speed[(time_s > 10.5) & (time_s < 16.5)] /= 2
    record = SpeedRecord(
        name="one", path=Path("one.csv"), time_s=time_s, speed_rad_s=speed, command_time_s=time_s, command=command,
        battery=LoggedBattery(time_s, np.full(len(time_s), 12.0)),
    )  # fmt: skip
    result = fit(record)
    (odd,) = [one.text for one in result.findings if one.code == "steps-off-the-map"]

    assert "left out, whose speed is far off that of the other commands (first: command" in odd
    for key in ("dynamics.rising", "dynamics.falling"):
        quantity = result.quantities[key]
        rate = quantity.value[0] + 2 * 1500 * quantity.value[1]
        assert rate == pytest.approx(10, rel=0.03)


@pytest.mark.parametrize(("start_s", "slow"), [(0.06, True), (0.03, False)])
def test_slow_starts_from_standstill_are_named_and_left_out_of_the_rotor_model(start_s: float, slow: bool) -> None:
    """A speed controller that starts a motor in 66 ms and regulates it in 10 ms got a model of 40 ms, with 0.7 %."""
    row_s, tau_s, hold_s = 0.005, 0.03, 0.5
    commands = np.array([0.0, 16000, 36000, 16000, 40000, 0, 32000, 48000, 0, 20000, 42000, 24000])
    rows, parts, now = np.arange(0.0, hold_s, row_s), list[Array](), 0.0
    for command in commands:
        tau = start_s if command > 0 and now < 1 else tau_s
        parts.append(command / 25 + (now - command / 25) * np.exp(-rows / tau))
        now = command / 25
    speed = np.concatenate(parts) + np.random.default_rng(8).normal(0, 2.0, len(rows) * len(commands))
    time_s = np.asarray(row_s * np.arange(len(speed)), np.float64)
    result = fit(
        SpeedRecord(
            name="one", path=Path("one.csv"), time_s=time_s, speed_rad_s=speed,
            command_time_s=np.asarray(hold_s * np.arange(len(commands)), np.float64), command=commands,
        )
    )  # fmt: skip
    rising = result.quantities["dynamics.rising"]

    assert ("rotor-starts-slowly" in [one.code for one in result.findings]) is slow
    assert rising.value[0] + 2 * 1500 * rising.value[1] == pytest.approx(1 / tau_s, rel=0.03)


@pytest.mark.parametrize("off", [0.0, 1e-12, -1e-12, 1e-9])
def test_a_rotor_that_heads_for_the_speed_where_its_rate_vanishes_runs_out_smoothly(off: float) -> None:
    """Steps to command 0 may lead there, where k1 + 2 k2 c = 0; a formula that divides by the rate leaves noise."""
    linear, quadratic, begin = 0.57, 0.00197, 440.0
    end = -linear / (2 * quadratic) * (1 + off)
    time_s = np.linspace(0.0, 3.0, 31)

    speed = Lag(0.0, begin, end, linear, quadratic).speed(time_s)

    gap = end - begin
    assert speed == pytest.approx(end - gap / (1 - quadratic * gap * time_s), abs=1e-5)
