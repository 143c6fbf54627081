"""Experiments that measure the same property are compared in units of the joint uncertainty of their difference."""

from pathlib import Path

import numpy as np
import pytest

from cfid.records.campaign import Campaign
from cfid.records.parameters import Parameter, Section
from cfid.records.rig_file import load_rig
from cfid.report.agreement import Agreement
from cfid.report.formats.render import rendered
from tests.lab import keep
from tests.report.fits_by_hand import new_campaign, put, report_of

SLOPE = 2 * 2.13e-11 * 30000 + 1.0326e-6  # N per command, at the middle of the sines


def thrust(campaign: Campaign, *, gain: float = 1.0, held_kg: float = 0.06, **quality: float) -> None:
    values = [2.13e-11 * gain, 1.0326e-6 * gain, 5.48e-4]
    put(
        campaign,
        "thrust",
        {
            "motor.thrust_poly": Parameter(value=values, std=[0.0, 0.01e-6, 0.0], unit="N(cmd)"),
            "motor.hover_mass_kg": Parameter(value=held_kg, std=0.001, unit="kg"),
        },
        quality=quality,
    )


def tf(campaign: Campaign, *, gain: float = SLOPE, lag_s: float = 0.065) -> None:
    put(
        campaign,
        "tf",
        {
            "tf.static_gain_n": Parameter(value=gain, std=0.02e-6, unit="N"),
            "tf.series.motor1.static_gain_n": Parameter(value=gain, std=0.02e-6, unit="N"),
            "tf.time_constant_s": Parameter(value=lag_s, std=0.001, unit="s"),
        },
        quality={"series": {"motor1": {"clock_skew": [1e-5, 1.2e-5, 0.8e-5], "clock_skew_std": [1e-6, 1e-6, 1e-6]}}},
    )


def found(campaign: Campaign, title: str) -> Agreement:
    (one, *_) = (one for one in report_of(campaign).agreements if one.title.startswith(title))
    return one


def test_the_static_gain_is_compared_with_the_slope_of_the_thrust_map(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    thrust(campaign)
    tf(campaign)
    assert found(campaign, "Thrust per command").agrees
    tf(campaign, gain=0.707 * SLOPE)
    apart = found(campaign, "Thrust per command")
    assert not apart.agrees
    assert apart.in_std < -20
    assert "standard uncertainties of the difference apart (limit 3)" in apart.findings[0].text
    named = [one for one in report_of(campaign).agreements if one.title.startswith("Thrust per command")]
    assert len(named) == 1  # the only series has the same gain, and no line of its own


def test_torque_times_speed_takes_at_least_the_power_of_an_ideal_rotor(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    thrust(campaign)
    for markers, agrees in ((1, True), (4, False)):  # a Crazyflie's speeds, and a quarter of these speeds
        speed = Parameter(value=[0.04 / markers, 380.0 / markers], std=[1e-4, 1.0], unit="rad/s(cmd)")
        put(campaign, "speed", {"motor.speed_poly": speed})
        torque = Parameter(value=[0.00596, 1.6e-5], std=[1e-5, 1e-7], unit="Nm(N)")
        put(campaign, "torque", {"motor.torque_poly": torque})
        put(campaign, "set", {"rotor_radius_m": Parameter(value=0.0231, unit="m")})
        power = found(campaign, "Power of a rotor")
        assert power.agrees is agrees
    assert "the thrust by a rotor of 23.1 mm" in power.findings[0].text


def test_one_skew_of_crossings_is_compared_by_its_own_uncertainty(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    lag = Parameter(value=0.065, std=0.001, unit="s")
    merits = {"series": {"motor1": {"clock_skew": [-1 / 85], "clock_skew_std": [1e-6]}}}
    put(campaign, "tf", {"tf.time_constant_s": lag}, quality=merits)
    for skew, agrees in ((-1 / 85 + 2e-6, True), (0.0, False)):
        put(campaign, "latency", {"latency.clock_skew": Parameter(value=skew, std=1e-6, unit="1")})
        assert found(campaign, "Rate of the vehicle's clock").agrees is agrees


def test_moments_and_lag_of_flights_are_compared_with_those_of_the_rig(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    along = {"x": 1.4e-5, "y": 1.6e-5, "z": 2.9e-5}
    matrix = [[along["x"], 0.0, 0.0], [0.0, along["y"], 0.0], [0.0, 0.0, along["z"]]]
    std = [[1e-7 if row == column else 0.0 for column in range(3)] for row in range(3)]
    put(campaign, "inertia", {"inertia.matrix_kg_m2": Parameter(value=matrix, std=std, unit="kg m^2")})
    tf(campaign)
    forward = campaign.rig.vehicle.body_frame.forward[-1]
    flown = {
        "flight.inertia_kg_m2.roll": Parameter(value=along[forward], std=4e-7, unit="kg m^2"),
        "flight.inertia_kg_m2.yaw": Parameter(value=0.8 * along["z"], std=4e-7, unit="kg m^2"),
        "flight.time_constant_s": Parameter(value=0.060, std=0.003, unit="s"),
    }
    put(campaign, "flight", flown)
    assert found(campaign, "Moment of inertia about roll").agrees
    assert not found(campaign, "Moment of inertia about yaw").agrees
    assert found(campaign, "Time constant of motor and rotor").agrees


def test_a_flight_shows_a_moment_as_one_over_the_entry_of_the_inverse_matrix(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    matrix = np.array([[1.6e-5, 2e-6, 0.5e-6], [2e-6, 1.7e-5, 3e-6], [0.5e-6, 3e-6, 2.9e-5]])
    std = np.where(np.eye(3) > 0, 1e-7, 2e-8)
    known = Parameter(value=matrix.tolist(), std=std.tolist(), unit="kg m^2")
    put(campaign, "inertia", {"inertia.matrix_kg_m2": known})
    put(campaign, "flight", {"flight.inertia_kg_m2.yaw": Parameter(value=2.8e-5, std=1e-8, unit="kg m^2")})
    one = found(campaign, "Moment of inertia about yaw")
    up = np.linalg.inv(matrix)[2, 2]
    assert one.second_value == pytest.approx(1 / up, rel=1e-9)
    assert one.second_value < 0.985 * matrix[2, 2]
    scattered = np.random.default_rng(1).normal(size=(20000, 3, 3)) * np.triu(std)
    scattered += np.triu(scattered, 1).transpose(0, 2, 1)
    assert one.second_std == pytest.approx(np.std(1 / np.linalg.inv(matrix + scattered)[:, 2, 2]), rel=0.03)


def test_thrust_over_voltage_is_compared_where_the_flight_hovers(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    rig = [0.0, 0.0, 0.006, 0.0012]  # at 2.9 V, carries a quarter of 32.5 g
    of_rig = Parameter(value=rig, std=[0.0, 0.0, 1e-5, 0.0], unit="N(V)")
    put(campaign, "thrust", {"motor.thrust_voltage_poly": of_rig})
    for gain, agrees in ((1.003, True), (1.05, False)):
        slope = Parameter(value=[gain * value for value in (-0.047, 0.0438, 0.0)], std=[0.0, 3e-4, 0.0], unit="N(V)")
        mass = Parameter(value=0.0325, std=1e-4, unit="kg")
        put(campaign, "flight", {"flight.thrust_voltage_poly": slope, "flight.mass_kg": mass})
        one = found(campaign, "Thrust of a rotor at 2.9 V")
        assert one.second_value == pytest.approx(0.006 * 2.9**2 + 0.0012 * 2.9**3)
        assert one.second_std == pytest.approx(1e-5 * 2.9**2)
        assert one.agrees is agrees


def test_thrust_over_voltage_that_never_carries_the_vehicle_is_not_compared(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    map_of_volts = Parameter(value=[0.0, 0.02, 0.004], std=[0.0, 1e-4, 0.0], unit="N(V)")
    sinking = Parameter(value=[0.0, 0.02, -0.004], std=[0.0, 1e-4, 0.0], unit="N(V)")
    put(campaign, "thrust", {"motor.thrust_voltage_poly": map_of_volts})
    mass = Parameter(value=0.0325, std=1e-4, unit="kg")
    put(campaign, "flight", {"flight.thrust_voltage_poly": sinking, "flight.mass_kg": mass})
    assert not any(one.title.startswith("Thrust") for one in report_of(campaign).agreements)


def test_time_constants_of_flights_are_compared_with_those_of_steps_up_and_down(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    rows = [
        {"time_constant_s": value + (0 if rising else 0.02), "std_s": 0.001, "accepted": True, "rising": rising}
        for value in (0.049, 0.05, 0.051)
        for rising in (True, False)
    ]
    put(campaign, "dynamics", {"dynamics.time_constant_s": Parameter(value=rows)})
    flown = {
        "flight.rising_s": Parameter(value=0.0505, std=0.001, unit="s"),
        "flight.falling_s": Parameter(value=0.080, std=0.001, unit="s"),
    }
    put(campaign, "flight", flown)
    rising, falling = (found(campaign, f"Time constant of a rotor that {way}") for way in ("speeds up", "slows down"))
    assert rising.agrees
    assert rising.second_value == pytest.approx(0.05)
    assert not falling.agrees
    assert falling.second_value == pytest.approx(0.07)


def test_a_cause_that_both_share_counts_once(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    thrust(campaign)
    tf(campaign)
    before = found(campaign, "Thrust per command").difference_std
    for name, keys in (("thrust", ["motor.thrust_poly"]), ("tf", ["tf.static_gain_n"])):
        section = campaign.values().sections()[name]
        effects = {key: [0.01 * value for value in _numbers(section, key)] for key in keys}
        parameters = dict(section.parameters)
        for key in keys:
            own = section.parameters[key]
            stds = own.std if isinstance(own.std, list) else [own.std]
            total = [(std**2 + effect**2) ** 0.5 for std, effect in zip(stds, effects[key], strict=True)]
            parameters[key] = Parameter(value=own.value, std=total if isinstance(own.std, list) else total[0])
        fields = {**vars(section), "parameters": parameters, "common": {"loadcell gain": effects}}
        keep(campaign.folder, name, Section(**fields))
    assert abs(found(campaign, "Thrust per command").difference_std / before - 1) < 0.01


def _numbers(section: Section, key: str) -> list[float]:
    value = section.parameters[key].value
    return value if isinstance(value, list) else [value]


def test_four_motors_hold_at_least_the_weighed_mass(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    thrust(campaign, held_kg=0.06)
    assert found(campaign, "Mass held").agrees
    thrust(campaign, held_kg=0.015)
    assert not found(campaign, "Mass held").agrees


def test_scales_that_read_half_the_thrust_disagree(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    thrust(campaign, verification_gain=1.003, verification_gain_std=0.004)
    assert found(campaign, "Thrust by scales").agrees
    thrust(campaign, verification_gain=0.5, verification_gain_std=0.004)
    assert not found(campaign, "Thrust by scales").agrees


def test_time_constants_and_clocks_are_compared(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    tf(campaign)
    rows = [{"time_constant_s": 0.06 + 0.002 * i, "std_s": 0.001, "accepted": True} for i in range(4)]
    put(campaign, "dynamics", {"dynamics.time_constant_s": Parameter(value=rows)})
    put(campaign, "latency", {"latency.clock_skew": Parameter(value=1.1e-5, std=1e-6, unit="1")})
    assert found(campaign, "Time constant").agrees
    assert found(campaign, "Rate of the vehicle's clock").agrees
    tf(campaign, lag_s=0.1)
    put(campaign, "latency", {"latency.clock_skew": Parameter(value=5e-5, std=1e-6, unit="1")})
    assert not found(campaign, "Time constant").agrees
    assert not found(campaign, "Rate of the vehicle's clock").agrees


def test_steps_count_with_their_scatter_and_their_own_uncertainty(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    tf(campaign)
    rows = [{"time_constant_s": value, "std_s": 0.002, "accepted": True} for value in (0.055, 0.06, 0.065)]
    ignored = {"time_constant_s": 0.5, "std_s": 0.002, "accepted": False}
    put(campaign, "dynamics", {"dynamics.time_constant_s": Parameter(value=[*rows, ignored])})
    one = found(campaign, "Time constant")
    assert abs(one.first_value - 0.06) < 1e-12
    assert abs(one.first_std**2 - (0.005**2 + 0.002**2)) < 1e-12
    assert abs(one.difference_std**2 - (one.first_std**2 + 0.001**2)) < 1e-12


def test_two_distances_of_one_axis_are_compared(tmp_path: Path) -> None:
    text = "\n[mounts.x-far]\npoint_mm = [0.0, 42.0, 18.95]\ndirection = [-2, 0, 0]\n"
    campaign = new_campaign(tmp_path)
    with (tmp_path / "rig.toml").open("a") as file:
        file.write(text)
    campaign = Campaign(folder=tmp_path, rig=load_rig(tmp_path / "rig.toml"))
    for far, agrees in ((16.6e-6, True), (19.0e-6, False)):
        put(
            campaign,
            "inertia",
            {
                "inertia.centre_kg_m2.x": Parameter(value=16.5e-6, std=2e-7, unit="kg m^2"),
                "inertia.centre_kg_m2.x-far": Parameter(value=far, std=2e-7, unit="kg m^2"),
            },
        )
        assert found(campaign, "Inertia about one axis").agrees is agrees


def test_rejected_quantities_are_not_compared(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    thrust(campaign)
    put(campaign, "tf", {"tf.static_gain_n": Parameter(value=1e-7, std=1e-9, unit="N")}, rejected="noise")
    assert not any(one.title.startswith("Thrust per") for one in report_of(campaign).agreements)


def test_every_format_has_the_table_and_the_disagreement(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    thrust(campaign)
    tf(campaign, gain=0.707 * SLOPE)
    report = report_of(campaign)
    for form in ("html", "md", "tex"):
        text = rendered(report, form, tmp_path)
        assert "Across experiments" in text, form
        assert "of the difference apart" in text, form
    assert report.as_json()["agreements"][0]["in_std"] < -3
