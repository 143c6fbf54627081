"""Experiments that measure the same property are compared in units of the joint uncertainty of their difference."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.records.campaign import Campaign, open_campaign
from cfid.records.parameters import Parameter
from cfid.report.texts import agreement_text
from tests.lab import new_campaign
from tests.report.fits_by_hand import put, report_of

SLOPE = 2 * 2.13e-11 * 30000 + 1.0326e-6  # N per command, at the middle of the sines


def of(value: Any, std: Any) -> Parameter:
    return Parameter(value=value, std=std)


def thrust(campaign: Campaign, *, held_kg: float = 0.06, common_std: float = 0.0, **quality: float) -> None:
    """Keep a thrust map whose slope is uncertain by 1e-8 N, and by a gain of the load cell in addition."""
    stds = [common_std * 2.13e-11, float(np.hypot(0.01e-6, common_std * 1.0326e-6)), common_std * 5.48e-4]
    gain = {"loadcell.gain": {"motor.thrust_poly": [common_std * value for value in (2.13e-11, 1.0326e-6, 5.48e-4)]}}
    put(
        campaign,
        "thrust",
        {"motor.thrust_poly": of([2.13e-11, 1.0326e-6, 5.48e-4], stds), "motor.hover_mass_kg": of(held_kg, 0.001)},
        quality=quality,
        common=gain if common_std else None,
    )


def tf(campaign: Campaign, *, gain: float = SLOPE, lag_s: float = 0.065, common_std: float = 0.0) -> None:
    std, common = float(np.hypot(0.02e-6, common_std * gain)), {"tf.static_gain_n": [common_std * gain]}
    put(
        campaign,
        "tf",
        {
            "tf.static_gain_n": of(gain, std),
            "tf.series.motor1.static_gain_n": of(gain, 0.02e-6),
            "tf.time_constant_s": of(lag_s, 0.001),
        },
        quality={"series": {"motor1": {"clock_skew": [1e-5, 1.2e-5, 0.8e-5], "clock_skew_std": [1e-6, 1e-6, 1e-6]}}},
        common={"loadcell.gain": common} if common_std else None,
    )


def compared(campaign: Campaign, title: str) -> list[dict[str, Any]]:
    return [pair for pair in report_of(campaign)["agreements"] if pair["title"].startswith(title)]


def agrees(campaign: Campaign, title: str) -> bool:
    return bool(compared(campaign, title)[0]["agrees"])


def test_the_static_gain_is_compared_with_the_slope_of_the_thrust_map(campaign: Campaign) -> None:
    thrust(campaign)
    tf(campaign)
    (pair,) = compared(campaign, "Thrust per command")  # the only series has the same gain, and no row of its own
    assert pair["agrees"]
    assert pair["finding"] == ""
    assert pair["second_value"] == pytest.approx(SLOPE)

    tf(campaign, gain=0.707 * SLOPE)
    (pair,) = compared(campaign, "Thrust per command")
    assert not pair["agrees"]
    assert pair["in_std"] == pytest.approx(-0.293 * SLOPE / np.hypot(0.01e-6, 0.02e-6))
    assert "30.3 standard uncertainties" in pair["finding"]


def test_a_cause_that_both_share_counts_once(campaign: Campaign) -> None:
    thrust(campaign, common_std=0.01)
    tf(campaign, common_std=0.01)
    (pair,) = compared(campaign, "Thrust per command")

    assert pair["first_std"] > 0.01 * SLOPE
    assert pair["difference_std"] == pytest.approx(np.hypot(0.01e-6, 0.02e-6), rel=1e-6)


def test_torque_times_speed_takes_at_least_the_power_of_an_ideal_rotor(campaign: Campaign) -> None:
    thrust(campaign)
    put(campaign, "torque", {"motor.torque_poly": of([0.00596, 1.6e-5], [1e-5, 1e-7])})
    put(campaign, "set", {"rotor_radius_m": of(0.0231, None)})
    for divisor, agreed in ((1, True), (4, False)):  # a Crazyflie's speeds, and a quarter of these speeds
        put(campaign, "speed", {"motor.speed_poly": of([0.04 / divisor, 380.0 / divisor], [1e-4, 1.0])})
        (pair,) = compared(campaign, "Power of a rotor")
        assert pair["agrees"] is agreed
        assert "23.1 mm" in pair["second"]


@pytest.mark.parametrize(("held_kg", "gain", "agreed"), [(0.06, 1.003, True), (0.015, 0.5, False)])
def test_four_motors_hold_at_least_the_weighed_mass_and_scales_measure_what_the_map_gives(
    campaign: Campaign, held_kg: float, gain: float, agreed: bool
) -> None:
    thrust(campaign, held_kg=held_kg, verification_gain=gain, verification_gain_std=0.004)
    assert agrees(campaign, "Mass held") is agrees(campaign, "Thrust by scales") is agreed


@pytest.mark.parametrize(("skew", "agreed"), [(1.1e-5, True), (5e-5, False)])
def test_clocks_are_compared(campaign: Campaign, skew: float, agreed: bool) -> None:
    tf(campaign)
    put(campaign, "latency", {"latency.clock_skew": of(skew, 1e-6)})
    (pair,) = compared(campaign, "Rate of the vehicle's clock")

    assert pair["agrees"] is agreed
    assert pair["second_std"] == pytest.approx(np.hypot(2e-6, 1e-6))  # the scatter of crossings, and their own


def test_steps_count_with_their_scatter_and_their_own_uncertainty(campaign: Campaign) -> None:
    tf(campaign)
    steps = [{"time_constant_s": value, "std_s": 0.002, "accepted": True} for value in (0.055, 0.06, 0.065)]
    ignored = {"time_constant_s": 0.5, "std_s": 0.002, "accepted": False}
    put(campaign, "dynamics", {"dynamics.time_constant_s": Parameter(value=[*steps, ignored])})
    (pair,) = compared(campaign, "Time constant")

    assert pair["first_value"] == pytest.approx(0.06)
    assert pair["first_std"] == pytest.approx(np.hypot(0.005, 0.002))
    assert pair["difference_std"] == pytest.approx(np.hypot(pair["first_std"], 0.001))
    tf(campaign, lag_s=0.1)
    assert not agrees(campaign, "Time constant")


@pytest.mark.parametrize(("far_kg_m2", "agreed"), [(16.6e-6, True), (19.0e-6, False)])
def test_two_distances_of_one_axis_are_compared(tmp_path: Path, far_kg_m2: float, agreed: bool) -> None:
    new_campaign(tmp_path)
    with (tmp_path / "rig.toml").open("a") as file:
        file.write("\n[mounts.x-far]\npoint_mm = [0.0, 42.0, 18.95]\ndirection = [-2, 0, 0]\n")
    campaign = open_campaign(tmp_path)
    near, far = of(16.5e-6, 2e-7), of(far_kg_m2, 2e-7)
    put(campaign, "inertia", {"inertia.centre_kg_m2.x": near, "inertia.centre_kg_m2.x-far": far})

    assert agrees(campaign, "Inertia about one axis") is agreed


def test_rejected_quantities_are_not_compared(campaign: Campaign) -> None:
    thrust(campaign)
    put(campaign, "tf", {"tf.static_gain_n": of(1e-7, 1e-9)}, rejected="noise")
    assert compared(campaign, "Thrust per") == []


def test_a_flight_shows_a_moment_as_one_over_the_entry_of_the_inverse_matrix(campaign: Campaign) -> None:
    matrix = np.array([[1.6e-5, 2e-6, 0.5e-6], [2e-6, 1.7e-5, 3e-6], [0.5e-6, 3e-6, 2.9e-5]])
    std = np.where(np.eye(3) > 0, 1e-7, 2e-8)
    yaw = 1 / np.linalg.inv(matrix)[2, 2]
    put(campaign, "inertia", {"inertia.matrix_kg_m2": of(matrix.tolist(), std.tolist())})
    put(campaign, "flight", {"flight.inertia_kg_m2.yaw": of(yaw, 1e-8), "flight.inertia_kg_m2.roll": of(2e-5, 1e-8)})
    (pair,) = compared(campaign, "Moment of inertia about yaw")
    scattered = np.random.default_rng(1).normal(size=(20000, 3, 3)) * np.triu(std)
    scattered += np.triu(scattered, 1).transpose(0, 2, 1)

    assert pair["second_value"] == pytest.approx(yaw, rel=1e-9)
    assert yaw < 0.985 * matrix[2, 2]
    assert pair["second_std"] == pytest.approx(np.std(1 / np.linalg.inv(matrix + scattered)[:, 2, 2]), rel=0.03)
    assert pair["agrees"]
    assert not agrees(campaign, "Moment of inertia about roll")


@pytest.mark.parametrize(("gain", "agreed"), [(1.003, True), (1.05, False), (-1.0, None)])
def test_thrust_over_voltage_is_compared_where_the_flight_hovers(
    campaign: Campaign, gain: float, agreed: bool | None
) -> None:
    put(campaign, "thrust", {"motor.thrust_voltage_poly": of([0.0, 0.0, 0.006, 0.0012], [0.0, 0.0, 1e-5, 0.0])})
    flown = of([gain * value for value in (-0.047, 0.0438, 0.0)], [0.0, 3e-4, 0.0])
    put(campaign, "flight", {"flight.thrust_voltage_poly": flown, "flight.mass_kg": of(0.0325, 1e-4)})
    pairs = compared(campaign, "Thrust of a rotor at 2.9 V")  # where the rig's map, too, holds a quarter of 32.5 g

    assert [pair["agrees"] for pair in pairs] == ([] if agreed is None else [agreed])  # none never holds the vehicle
    for pair in pairs:
        assert pair["second_value"] == pytest.approx(0.006 * 2.9**2 + 0.0012 * 2.9**3)
        assert pair["second_std"] == pytest.approx(1e-5 * 2.9**2)


def test_time_constants_of_flights_are_compared_with_sines_and_with_steps_up_and_down(campaign: Campaign) -> None:
    rows = [
        {"time_constant_s": value + (0 if rising else 0.02), "std_s": 0.001, "accepted": True, "rising": rising}
        for value in (0.049, 0.05, 0.051)
        for rising in (True, False)
    ]
    put(campaign, "dynamics", {"dynamics.time_constant_s": Parameter(value=rows)})
    tf(campaign)
    flown = {"rising_s": of(0.0505, 0.001), "falling_s": of(0.080, 0.001), "time_constant_s": of(0.064, 0.003)}
    put(campaign, "flight", {f"flight.{name}": parameter for name, parameter in flown.items()})
    (up,), (down,) = (
        compared(campaign, f"Time constant of a rotor that {verb}") for verb in ("speeds up", "slows down")
    )

    assert (up["agrees"], up["second_value"]) == (True, pytest.approx(0.05))
    assert (down["agrees"], down["second_value"]) == (False, pytest.approx(0.07))
    assert [pair["first"] for pair in compared(campaign, "Time constant of motor")][-1] == "cfid fit flight"


def test_a_sentence_has_both_values_and_a_lower_limit_no_distance(campaign: Campaign) -> None:
    thrust(campaign, held_kg=0.06)
    tf(campaign, gain=SLOPE)
    (slope,), (held,) = compared(campaign, "Thrust per command"), compared(campaign, "Mass held")

    assert "(2.311 ± 0.020)·10⁻⁶ N" in agreement_text(slope)
    assert "0.0 standard uncertainties apart" in agreement_text(slope)
    assert "60.0 ± 1.0 g" in agreement_text(held)
    assert "at least 28.000 ± 0.030 g" in agreement_text(held)
    assert "apart" not in agreement_text(held)
