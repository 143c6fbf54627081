"""Thrust over motor voltage, batteries that sag and load cells that warm up."""

import dataclasses
from functools import partial

import numpy as np
import numpy.typing as npt
import pytest

from cfid.motors.maps.data import warm_up
from cfid.motors.maps.estimation import compare, compare_thrust, fit_map, maximum_thrust, motor_volts, on_battery
from cfid.motors.points import Points, frame
from tests.motors.test_motor_maps import EQ_3_3, codes

Array = npt.NDArray[np.float64]

UP_AND_DOWN = np.concatenate([np.arange(0.0, 64001.0, 2000.0), np.arange(64000.0, -1.0, -2000.0)])
CUBIC = (2.1e-3, 1.3e-2, 5.5e-3, 1.0e-3)  # N, N/V, N/V^2, N/V^3; lowest first, rising over all voltages

fit_thrust = partial(fit_map, "thrust")


def sagging(command: Array, *, empty_v: float = 0.6) -> Array:
    """Return a battery cell's voltage, which loses 0.5 V at full command, and `empty_v` from first to last point."""
    return 4.1 - 0.5 * (command / 65535) ** 2 - empty_v * np.linspace(0, 1, len(command))


def thrust_of(volts: Array) -> Array:
    return np.asarray(np.polynomial.polynomial.polyval(volts, CUBIC))


def by_voltage(command: Array, vbat: Array) -> Points:
    """Return exact points of a motor that follows its voltage."""
    return frame(command, thrust_n=thrust_of(motor_volts(command=command, vbat_v=vbat)), vbat_v=vbat)


def noise(seed: int, scale: Array) -> Array:
    return np.asarray(scale * np.random.default_rng(seed).standard_normal(len(scale)))


def test_a_cubic_of_motor_voltage_comes_back_lowest_power_first() -> None:
    assert motor_volts(command=[0, 32767.5, 65535], vbat_v=[4.0, 4.0, 3.0]) == pytest.approx([0, 2, 3])
    compared = compare_thrust(by_voltage(UP_AND_DOWN, sagging(UP_AND_DOWN)))

    assert compared.lowest_first == pytest.approx(CUBIC, rel=1e-6)
    assert compared.by_command.order == compared.by_voltage.order == 3
    assert compared.command.min() == 2000  # the dead zone is left out


@pytest.mark.parametrize("seed", range(3))
def test_on_a_sagging_battery_the_voltage_predicts_better_and_lies_within_half_a_percent(seed: int) -> None:
    vbat = sagging(UP_AND_DOWN)
    points = by_voltage(UP_AND_DOWN, vbat)
    std = (5e-5 + 2e-3 * points["thrust_n"]).to_numpy()
    read_v = vbat + noise(seed, np.full_like(vbat, 2e-3))
    noisy = points.assign(thrust_n=points["thrust_n"] + noise(seed + 100, std), thrust_std_n=std, vbat_v=read_v)
    compared = compare_thrust(noisy)
    volts = np.linspace(0.25 * compared.motor_volts.max(), compared.motor_volts.max(), 50)

    assert compared.better == "voltage"
    assert compared.ratio > 5
    assert compared.by_voltage.at(volts) == pytest.approx(thrust_of(volts), rel=5e-3)
    assert codes(compared) == {}


def test_a_motor_that_obeys_the_command_and_one_on_a_supply_are_told_apart() -> None:
    """The former has a brushless controller that compensates for the battery."""
    thrust = 4e-11 * UP_AND_DOWN**2 + 1e-7 * UP_AND_DOWN
    obeying = frame(UP_AND_DOWN, thrust_n=thrust + noise(1, thrust / 500), vbat_v=sagging(UP_AND_DOWN))
    supplied = by_voltage(UP_AND_DOWN, np.full_like(UP_AND_DOWN, 3.7))
    supplied["thrust_n"] += noise(1, 1e-4 + supplied["thrust_n"].to_numpy() / 500)

    assert [compare_thrust(points).better for points in (obeying, supplied)] == ["command", "neither"]


def test_a_voltage_that_falls_with_commands_held_once_cannot_be_separated_and_a_supply_is_silent() -> None:
    up = UP_AND_DOWN[:33]
    assert codes(compare(by_voltage(up, sagging(up)), order=3)) == {"voltage-follows-command": "warning"}
    for vbat in (np.full(33, 12.0), 12.0 - 0.1 * np.linspace(0, 1, 33)):
        assert codes(compare(by_voltage(up, vbat), order=3)) == {}


# The largest thrust


def under_load(command: Array) -> tuple[Array, Array]:
    """Return thrusts and battery voltages at commands; the current, power over voltage, passes an inner resistance."""
    thrust, volts = np.zeros(len(command)), np.full(len(command), 4.0)
    for _ in range(100):
        volts = 4.0 - 30.0 * thrust**1.5 / volts
        thrust = 0.012 * motor_volts(command=command, vbat_v=volts) ** 2 + 0.002
    return thrust, volts


def test_a_supply_that_was_set_to_two_voltages_shows_no_sag() -> None:
    """Thrust and voltage once raised each other until the numbers overflowed."""
    held = np.arange(6000.0, 65001.0, 5000.0)
    command, volts = np.tile(held, 2), np.repeat([12.0, 7.5], len(held))
    std = np.full(len(command), 1e-4)
    noisy = 2.0 * (command / 65535 * volts / 12) ** 2 + noise(3, std)
    points = frame(command, thrust_n=noisy, thrust_std_n=std, vbat_v=volts)
    compared = compare_thrust(points)

    assert compared.better == "voltage"
    assert on_battery(maximum_thrust(fit_thrust(points), gravity_mps2=9.81), compared, order=2, motors=1) is None


def test_the_largest_thrust_is_stated_at_the_voltage_to_which_the_battery_sags() -> None:
    command = np.arange(4000.0, 48001.0, 4000.0)
    (true_n,), (true_v,) = under_load(np.array([65535.0]))
    thrust, volts = under_load(command)
    std = 1e-5 + 2e-4 * thrust
    points = frame(command, thrust_n=thrust + noise(2, std), thrust_std_n=std, vbat_v=volts)
    by_command = maximum_thrust(fit_thrust(points), gravity_mps2=9.81)
    compared = compare_thrust(points)
    better = dataclasses.replace(compared, voltage_rms=0.5 * compared.command_rms)
    most = on_battery(by_command, better, order=2, motors=4)

    assert most is not None
    assert most.volts == pytest.approx(true_v, abs=0.02)
    assert abs(most.thrust_n - true_n) < 3 * most.std_n
    assert abs(most.thrust_n - true_n) < abs(by_command.thrust_n - true_n)
    alike = dataclasses.replace(compared, voltage_rms=compared.command_rms)
    assert on_battery(by_command, alike, order=2, motors=4) is None


# Load cells that warm up


UP = np.arange(8000.0, 64001.0, 8000.0)


def measured(command: Array, *, factor: Array | float = 1.0, seed: int = 0) -> Points:
    thrust = np.asarray(np.polyval(EQ_3_3, command), np.float64)
    std = 1e-5 + 1e-3 * thrust
    return frame(command, thrust_n=factor * thrust + noise(seed, std), thrust_std_n=std)


def times(command: Array) -> Array:
    """Return the times at which steps of ten seconds were held."""
    return 10.0 * np.arange(len(command), dtype=np.float64)


def test_a_command_held_again_shows_that_the_load_cell_warmed_up() -> None:
    command = np.append(UP[2:], UP[2])
    warm = 1 - 0.02 * np.exp(-np.arange(len(command)) / 3)
    causes, findings = warm_up(measured(command, factor=warm), times(command), "run")

    assert [finding.code for finding in findings] == ["load-cell-drifted"]
    assert findings[0].concerns("motor.max_thrust_n")
    assert causes[0].std == pytest.approx(0.02 * (1 - np.exp(-2)), rel=0.3)


def test_a_drift_is_that_of_the_whole_run_and_not_the_mean_change() -> None:
    command = np.append(UP, UP[::-1])
    warm = 1 - 0.02 * np.exp(-np.arange(len(command)) / len(command))
    (cause,), _ = warm_up(measured(command, factor=warm), times(command), "run")

    assert cause.std == pytest.approx(0.012, abs=0.003)  # the mean of all changes is 0.6 %


def test_a_run_too_noisy_to_show_a_warm_up_states_what_it_would_show() -> None:
    command = np.append(UP, UP[::-1])
    points = measured(command)
    _, findings = warm_up(
        points.assign(thrust_std_n=points["thrust_std_n"] + 0.02 * points["thrust_n"]), times(command), "run"
    )

    assert [(one.code, one.severity) for one in findings] == [("load-cell-drift-unseen", "note")]


@pytest.mark.parametrize("seed", range(10))
def test_a_load_cell_that_keeps_its_gain_has_no_drift(seed: int) -> None:
    command = np.append(UP, UP[::-1])
    causes, findings = warm_up(measured(command, seed=seed), times(command), "run")

    assert sum(cause.std or 0.0 for cause in causes) < 0.004
    assert findings == ()


def test_thrust_that_fell_with_the_battery_is_no_drift_of_the_load_cell() -> None:
    command = np.append(UP, UP[0])
    points = measured(command, factor=np.linspace(1, 0.9, len(command)))

    assert warm_up(points.assign(vbat_v=np.linspace(4.1, 3.8, len(command))), times(command), "run") == ((), ())
    assert warm_up(points, times(command), "run")[1]
