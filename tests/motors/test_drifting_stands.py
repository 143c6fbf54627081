"""Stands that drift: a load cell that warms up, a battery that sags, halves of a log that contradict each other."""

import dataclasses
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
import pytest

from cfid.findings import Finding
from cfid.motors.maps.estimation import fit_thrust
from cfid.motors.maps.inverse import maximum_thrust, on_battery
from cfid.motors.maps.scales import verify_thrust
from cfid.motors.maps.voltage import compare_thrust, motor_volts
from cfid.motors.maps.warm_up import warm_up
from cfid.motors.points import MotorPoints

Array = npt.NDArray[np.float64]

UP = np.arange(8000.0, 64001.0, 8000.0)
EQ_3_3 = (2.130295e-11, 1.032633e-6, 5.484560e-4)


def measured(command: Array, *, factor: Array | float = 1.0, seed: int = 0) -> MotorPoints:
    thrust: Array = np.asarray(np.polyval(EQ_3_3, command), np.float64)
    std: Array = 1e-5 + 1e-3 * thrust
    noise = std * np.random.default_rng(seed).standard_normal(len(command))
    return MotorPoints(command=command, thrust_n=factor * thrust + noise, thrust_std_n=std)


def codes(findings: Iterable[Finding]) -> set[str]:
    return {one.code for one in findings}


def times(command: Array) -> Array:
    """Return the times at which steps of ten seconds were held."""
    return 10.0 * np.arange(len(command), dtype=np.float64)


def test_a_command_held_again_shows_that_the_load_cell_warmed_up() -> None:
    command = np.append(UP[2:], UP[2])
    warm = 1 - 0.02 * np.exp(-np.arange(len(command)) / 3)
    causes, findings = warm_up(measured(command, factor=warm), times(command), None, "run")

    assert codes(findings) == {"load-cell-drifted"}
    assert findings[0].concerns("motor.max_thrust_n")
    assert causes[0].std == pytest.approx(0.02 * (1 - np.exp(-2)), rel=0.3)


def test_commands_that_were_held_again_late_show_more_of_a_warm_up_than_those_held_at_once() -> None:
    command = np.append(UP, UP[::-1])
    warm = 1 - 0.02 * np.exp(-np.arange(len(command)) / len(command))
    _, findings = warm_up(measured(command, factor=warm), times(command), None, "run")

    # The mean of all changes is 0.6 %; the change from the first step to the last is 1.2 %.
    assert codes(findings) == {"load-cell-drifted"}
    assert float(findings[0].text.split("gave ")[1].split(" %")[0]) == pytest.approx(1.2, abs=0.3)


def test_a_run_too_noisy_to_show_a_warm_up_states_what_it_would_show() -> None:
    command = np.append(UP, UP[::-1])
    points = measured(command)
    assert points.thrust_n is not None
    assert points.thrust_std_n is not None
    noisy = dataclasses.replace(points, thrust_std_n=points.thrust_std_n + 0.02 * points.thrust_n)
    _, findings = warm_up(noisy, times(command), None, "run")

    assert [(one.code, one.severity) for one in findings] == [("load-cell-drift-unseen", "note")]
    assert "only beyond" in findings[0].text


@pytest.mark.parametrize("seed", range(10))
def test_a_load_cell_that_keeps_its_gain_has_no_drift(seed: int) -> None:
    command = np.append(UP, UP[::-1])
    causes, findings = warm_up(measured(command, seed=seed), times(command), None, "run")

    assert sum(cause.std or 0.0 for cause in causes) < 0.004
    assert findings == ()


def test_thrust_that_fell_with_the_battery_is_no_drift_of_the_load_cell() -> None:
    command = np.append(UP, UP[0])
    points = measured(command, factor=np.linspace(1, 0.9, len(command)))

    assert warm_up(points, times(command), np.linspace(4.1, 3.8, len(command)), "run") == ((), ())
    assert warm_up(points, times(command), None, "run")[1]


def test_halves_of_a_log_that_contradict_each_other_are_reported() -> None:
    command = np.append(np.arange(4000.0, 64001.0, 4000.0), np.arange(64000.0, 3999.0, -4000.0))
    second = np.where(np.arange(len(command)) < len(command) // 2, 1.0, 0.9)
    found = fit_thrust(measured(command, factor=second))

    assert "map-halves-differ" in codes(found.findings)
    assert "map-halves-differ" not in codes(fit_thrust(measured(command)).findings)


def sagging(command: Array) -> tuple[Array, Array]:
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
    thrust = 2.0 * (command / 65535 * volts / 12) ** 2
    noisy = thrust + 1e-4 * np.random.default_rng(3).standard_normal(len(command))
    std = np.full(len(command), 1e-4)
    by_command = maximum_thrust(
        fit_thrust(MotorPoints(command=command, thrust_n=noisy, thrust_std_n=std)), gravity_mps2=9.81
    )
    compared = compare_thrust(command=command, vbat_v=volts, thrust_n=noisy, std_n=std)

    assert compared.better == "voltage"
    assert on_battery(by_command, compared, order=2, motors=1) is None


def test_the_largest_thrust_is_stated_at_the_voltage_to_which_the_battery_sags() -> None:
    command = np.arange(4000.0, 48001.0, 4000.0)
    (true_n,), (true_v,) = sagging(np.array([65535.0]))
    thrust, volts = sagging(command)
    std = 1e-5 + 2e-4 * thrust
    noisy = thrust + std * np.random.default_rng(2).standard_normal(len(command))
    by_command = maximum_thrust(
        fit_thrust(MotorPoints(command=command, thrust_n=noisy, thrust_std_n=std)), gravity_mps2=9.81
    )
    compared = compare_thrust(command=command, vbat_v=volts, thrust_n=noisy, std_n=std)
    better = dataclasses.replace(compared, voltage_rms=0.5 * compared.command_rms)
    found = on_battery(by_command, better, order=2, motors=4)

    assert found is not None
    assert found.volts == pytest.approx(true_v, abs=0.02)
    assert abs(found.thrust_n - true_n) < 3 * found.std_n
    assert abs(found.thrust_n - true_n) < abs(by_command.thrust_n - true_n)
    alike = dataclasses.replace(compared, voltage_rms=compared.command_rms)
    assert on_battery(by_command, alike, order=2, motors=4) is None


def test_a_thrust_beyond_the_points_widens_by_what_the_last_points_surprise() -> None:
    command = np.arange(4000.0, 48001.0, 4000.0)
    bent = measured(command, factor=1 - 0.1 * (command / 65535) ** 2)  # no polynomial of order 2 describes this
    truth_n = 0.9 * float(np.polyval(EQ_3_3, 65535))
    found = maximum_thrust(fit_thrust(bent), gravity_mps2=9.81)
    even = maximum_thrust(fit_thrust(measured(command)), gravity_mps2=9.81)

    assert even.beyond_std_n == 0
    assert found.beyond_std_n > 10 * even.std_n
    assert abs(found.thrust_n - truth_n) < 2 * found.std_n


def test_scales_know_a_gain_no_better_than_the_linearity_of_both_instruments() -> None:
    mapped = fit_thrust(measured(UP))
    thrust_n = np.polyval(EQ_3_3, UP)
    plain, stated = (verify_thrust(mapped, command=UP, thrust_n=thrust_n, scale_stds=std) for std in ((), (3e-3, 4e-3)))

    assert stated.gain == plain.gain
    assert stated.gain_std**2 == pytest.approx(plain.gain_std**2 + (5e-3 * plain.gain) ** 2)
