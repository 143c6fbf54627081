"""Thrust and speed over motor voltage, which contains the battery's sag; left-out data show if it predicts better."""

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import FitError
from cfid.motors.maps.voltage import compare, compare_thrust, motor_volts
from tests.motors.sentences import remarks

Array = npt.NDArray[np.float64]

UP_AND_DOWN = np.concatenate([np.arange(0.0, 64001.0, 2000.0), np.arange(64000.0, -1.0, -2000.0)])
CUBIC = (2.1e-3, 1.3e-2, 5.5e-3, 1.0e-3)  # N, N/V, N/V^2, N/V^3; lowest first, rising over all voltages


def sagging(command: Array, *, empty_v: float = 0.6) -> Array:
    """Return a battery cell's voltage, which loses 0.5 V at full command, and `empty_v` from first to last point."""
    return 4.1 - 0.5 * (command / 65535) ** 2 - empty_v * np.linspace(0, 1, len(command))


def thrust_of(volts: Array) -> Array:
    return np.asarray(np.polynomial.polynomial.polyval(volts, CUBIC))


def noise(seed: int, scale: Array) -> Array:
    return np.asarray(scale * np.random.default_rng(seed).standard_normal(len(scale)))


def test_motor_voltage_is_the_part_of_the_battery_that_the_command_lets_through() -> None:
    assert motor_volts(command=[0, 32767.5, 65535], vbat_v=[4.0, 4.0, 3.0]) == pytest.approx([0, 2, 3])


def test_a_cubic_of_motor_voltage_comes_back_lowest_power_first() -> None:
    vbat = sagging(UP_AND_DOWN)
    truth = thrust_of(motor_volts(command=UP_AND_DOWN, vbat_v=vbat))
    found = compare_thrust(command=UP_AND_DOWN, vbat_v=vbat, thrust_n=truth)

    assert found.lowest_first == pytest.approx(CUBIC, rel=1e-6)
    assert found.by_command.order == found.by_voltage.order == 3
    assert found.command.min() == 2000  # the dead zone is left out


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("folds", [None, 5])
def test_on_a_sagging_battery_the_voltage_predicts_better_and_lies_within_half_a_percent(
    seed: int, folds: int | None
) -> None:
    vbat = sagging(UP_AND_DOWN)
    volts = motor_volts(command=UP_AND_DOWN, vbat_v=vbat)
    truth = thrust_of(volts)
    std = 5e-5 + 2e-3 * truth
    read_v = vbat + noise(seed, np.full_like(vbat, 2e-3))
    thrust = truth + noise(seed + 100, std)
    found = compare_thrust(command=UP_AND_DOWN, vbat_v=read_v, thrust_n=thrust, std_n=std, folds=folds)
    running = np.linspace(0.25 * volts.max(), volts.max(), 50)
    print(f"{found.verdict.text} rms {found.voltage_rms:.2g} against {found.command_rms:.2g} N")

    assert found.better == "voltage"
    assert found.ratio > 5
    assert found.by_voltage.at(running) == pytest.approx(thrust_of(running), rel=5e-3)
    assert found.verdict.text.startswith("motor voltage predicts")
    assert found.findings == ()


def test_a_motor_that_obeys_the_command_alone_is_told_by_the_command() -> None:
    """Such a motor has a brushless controller that compensates for the battery."""
    thrust = 4e-11 * UP_AND_DOWN**2 + 1e-7 * UP_AND_DOWN
    found = compare_thrust(command=UP_AND_DOWN, vbat_v=sagging(UP_AND_DOWN), thrust_n=thrust + noise(1, thrust / 500))

    assert found.better == "command"
    assert "motor command predicts" in found.verdict.text


def test_on_a_supply_neither_is_better() -> None:
    vbat = np.full_like(UP_AND_DOWN, 3.7)
    thrust = thrust_of(motor_volts(command=UP_AND_DOWN, vbat_v=vbat))
    found = compare_thrust(command=UP_AND_DOWN, vbat_v=vbat, thrust_n=thrust + noise(1, 1e-4 + thrust / 500))

    assert found.ratio == pytest.approx(1)
    assert found.better == "neither"
    assert "predict equally well" in found.verdict.text


def test_commands_held_once_leave_the_two_forms_on_one_path_and_that_is_said() -> None:
    up = UP_AND_DOWN[:33]
    vbat = sagging(up)
    found = compare_thrust(command=up, vbat_v=vbat, thrust_n=thrust_of(motor_volts(command=up, vbat_v=vbat)))

    assert "every command was held once: voltage fell as the command rose, from 4" in remarks(found)[0]


@pytest.mark.parametrize(("noisy", "at"), [(0.0, "12"), (0.1, "11.9 to 12")])
def test_commands_held_once_on_a_supply_are_not_said_to_make_its_voltage_fall(noisy: float, at: str) -> None:
    up = UP_AND_DOWN[:33]
    vbat = 12.0 - noisy * np.linspace(0, 1, len(up))
    found = compare_thrust(command=up, vbat_v=vbat, thrust_n=thrust_of(motor_volts(command=up, vbat_v=vbat)))

    assert "voltage fell" not in remarks(found)[0]
    assert f"every command was held once, at {at} V, so this run" in remarks(found)[0]


def test_a_command_is_judged_by_points_that_have_not_seen_it() -> None:
    """Commands 1e4 to 5e4 have slope one, with 10 added at 3e4; each inner command is left out by hand."""
    command = np.array([1e4, 2e4, 3e4, 4e4, 5e4])
    value = command + np.array([0, 0, 10, 0, 0.0])
    found = compare(command=command, vbat_v=np.full(5, 65535.0), value=value, order=1)
    errors = [
        value[i] - np.polyval(np.polyfit(np.delete(command, i), np.delete(value, i), 1), command[i]) for i in (1, 2, 3)
    ]

    assert found.judged == 3
    assert found.command_rms == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-6)
    assert found.voltage_rms == pytest.approx(found.command_rms, rel=1e-6)


def test_folds_leave_every_so_manyth_command_out_together() -> None:
    command = np.arange(1e4, 6.1e4, 1e4)
    value = command + noise(1, np.full(6, 100.0))
    found = compare(command=command, vbat_v=np.full(6, 4.0), value=value, order=1, folds=2)
    errors = [
        value[out] - np.polyval(np.polyfit(np.delete(command, out), np.delete(value, out), 1), command[out])
        for out in ([1, 3], [2, 4])
    ]

    assert found.command_rms == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-6)


def test_points_without_a_voltage_are_left_out_and_too_few_commands_refused() -> None:
    vbat = sagging(UP_AND_DOWN)
    vbat[10] = np.nan
    thrust = thrust_of(motor_volts(command=UP_AND_DOWN, vbat_v=np.nan_to_num(vbat)))

    assert len(compare_thrust(command=UP_AND_DOWN, vbat_v=vbat, thrust_n=thrust).value) == 63
    with pytest.raises(FitError, match=r"5 commands above 1000 are too few .* of order 3 .*: 6 are needed"):
        compare_thrust(command=UP_AND_DOWN[:6], vbat_v=vbat[:6], thrust_n=thrust[:6])
