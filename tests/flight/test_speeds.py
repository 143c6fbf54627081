"""Flights with rotor speeds show a vehicle's parameters, each alone is refused where its manoeuvre is missing."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from cfid.console.campaign import make_campaign
from cfid.errors import DataError
from cfid.flight.data import FlownLog
from cfid.flight.estimation import CrossedError
from cfid.flight.result import fit
from cfid.flight.values import Body
from cfid.quantities.plausible import implausible
from cfid.records.campaign import open_campaign
from cfid.sim.flying import VEHICLES, FlyingVehicle, fly, scattered
from cfid.sim.pilot import manoeuvres
from tests.lab import Cfid
from tests.nightly.speeds import KINDS, fitted, flown_in, numbers, truths

Array = npt.NDArray[np.float64]

# Of one flight of 60 s: the largest share of the truth by which a quantity may be uncertain, and the goals.
WIDEST = {
    "motor.thrust_per_speed_squared_n_s2": 0.01,
    "flight.inertia_kg_m2.roll": 0.03,
    "flight.inertia_kg_m2.pitch": 0.03,
    "flight.inertia_kg_m2.yaw": 0.04,
    "rotor_inertia_kg_m2": 0.10,
    "motor.torque_poly": 0.05,
    "flight.moment_per_velocity_ns.roll": 0.10,
    "flight.moment_per_velocity_ns.pitch": 0.10,
}
PLANS = (KINDS, KINDS, ("hover",), ("hover", "tilts", "yaw"))
OF_YAW = {"rotor_inertia_kg_m2", "motor.torque_poly", "flight.inertia_kg_m2.yaw"}
COMMANDS = {f"motor.m{motor}" for motor in (1, 2, 3, 4)}

Flown = list[tuple[FlyingVehicle, dict[str, Array]]]


@pytest.fixture(scope="module")
def flown() -> Flown:
    """Return four vehicles with their logs at 100 Hz: a Brushless in gusts, a large one, two of fewer manoeuvres."""
    rngs = [np.random.default_rng((54, place)) for place in range(len(PLANS))]
    names = ("brushless_38", "five_inch_250", "brushless_38", "deck_32")
    vehicles = [
        scattered(VEHICLES[name], rng, gust=0.02 * (place == 0))
        for place, (name, rng) in enumerate(zip(names, rngs, strict=True))
    ]
    plans = np.stack([manoeuvres(kinds, 60.0, rng) for kinds, rng in zip(PLANS, rngs, strict=True)])
    logs = fly(vehicles, plans, rngs=rngs, rate_hz=100)
    return [(vehicle, {"t": logs.time_s, **logs.columns(place)}) for place, vehicle in enumerate(vehicles)]


def rejected(flight: FlownLog, vehicle: FlyingVehicle, *, torque: bool = False) -> set[str]:
    """Return the keys of the rejected quantities, drag apart."""
    return {key for key in fitted(flight, vehicle, torque=torque).rejected if "drag" not in key}


@pytest.mark.parametrize("place", [0, 1])
def test_a_minute_of_flight_shows_everything_within_its_goal(flown: Flown, tmp_path: Path, place: int) -> None:
    vehicle, columns = flown[place]
    result = fitted(flown_in(columns, tmp_path / "log.csv"), vehicle)
    assert not {key for key in result.rejected if "drag" not in key}
    for key, true in truths(vehicle).items():
        value, std = numbers(result, key)
        assert abs(value - true) < 3 * std, key
        assert std < WIDEST.get(key, np.inf) * abs(true), key


def test_speeds_suffice_without_commands(flown: Flown, tmp_path: Path) -> None:
    vehicle, columns = flown[0]
    both = fitted(flown_in(columns, tmp_path / "both.csv"), vehicle)
    left = {name: values for name, values in columns.items() if name not in COMMANDS}
    alone = fitted(flown_in(left, tmp_path / "speeds.csv"), vehicle)
    assert {key: numbers(alone, key) for key in WIDEST} == {key: numbers(both, key) for key in WIDEST}


def test_without_velocity_moments_are_found_and_those_of_air_are_not_given(flown: Flown, tmp_path: Path) -> None:
    vehicle, columns = flown[0]
    left = {name: values for name, values in columns.items() if not name.startswith("stateEstimate")}
    result = fitted(flown_in(left, tmp_path / "log.csv"), vehicle)
    assert "flight.moment_per_velocity_ns.roll" not in result.quantities
    for axis in ("roll", "pitch"):
        value, std = numbers(result, key := f"flight.inertia_kg_m2.{axis}")
        assert abs(value - truths(vehicle)[key]) < 3 * std


def test_a_flight_that_hovers_shows_thrust_alone(flown: Flown, tmp_path: Path) -> None:
    vehicle, columns = flown[2]
    flight = flown_in(columns, tmp_path / "log.csv")
    result = fitted(flight, vehicle)
    value, std = numbers(result, key := "motor.thrust_per_speed_squared_n_s2")
    assert value == pytest.approx(truths(vehicle)[key], abs=3 * std)
    assert std < 0.01 * value
    assert rejected(flight, vehicle) >= {"flight.inertia_kg_m2.roll", "flight.inertia_kg_m2.pitch", *OF_YAW}


def test_without_turns_a_known_torque_gives_the_moment_about_yaw(flown: Flown, tmp_path: Path) -> None:
    vehicle, columns = flown[3]
    flight = flown_in(columns, tmp_path / "log.csv")
    assert rejected(flight, vehicle) == OF_YAW
    assert rejected(flight, vehicle, torque=True) == set()
    result = fitted(flight, vehicle, torque=True)
    assert "motor.torque_poly" not in result.quantities
    for key in ("flight.inertia_kg_m2.yaw", "rotor_inertia_kg_m2"):
        value, std = numbers(result, key)
        assert abs(value - truths(vehicle)[key]) < 3 * std
        assert std < WIDEST[key] * value


def test_wrong_axes_and_numbers_of_motors_are_refused(flown: Flown, tmp_path: Path) -> None:
    vehicle, columns = flown[0]
    turned = dict(columns)
    turned["motor.m1_rpm"], turned["motor.m2_rpm"] = columns["motor.m2_rpm"], columns["motor.m1_rpm"]
    with pytest.raises(CrossedError):
        fitted(flown_in(turned, tmp_path / "numbers.csv"), vehicle)
    against = {**columns, "gyro.x": -columns["gyro.x"]}
    against = {name: values for name, values in against.items() if not name.startswith("stateEstimate")}
    flight = flown_in(against, tmp_path / "axes.csv")
    assert rejected(flight, vehicle) >= {"flight.inertia_kg_m2.roll", *OF_YAW}


def test_logs_with_and_without_speeds_are_not_fitted_together(flown: Flown, tmp_path: Path) -> None:
    (vehicle, columns), (_, others) = flown[:2]
    left = {name: values for name, values in others.items() if not name.endswith("_rpm")}
    logs = [flown_in(columns, tmp_path / "speeds.csv"), flown_in(left, tmp_path / "commands.csv")]
    with pytest.raises(DataError):
        fit(logs, body=Body(mass_kg=vehicle.mass_kg, mass_std_kg=0.0))


def test_a_speed_counts_in_the_middle_of_the_step_that_telemetry_shows(flown: Flown, tmp_path: Path) -> None:
    """Periods are cut to whole steps, so that speeds are shown too large: by 0.15 %, and thrust over their square."""
    _, columns = flown[2]
    read = flown_in(columns, tmp_path / "log.csv")
    assert read.flight.speeds is not None
    shown = columns["motor.m1_rpm"] * 2 * np.pi / 60
    share = float(np.mean(read.flight.speeds.value[:, 0]) / np.mean(shown))
    assert 0.9978 < share < 0.9995


def test_a_speed_that_stands_still_counts_as_none(flown: Flown, tmp_path: Path) -> None:
    """As where a motor's controller sends no telemetry: the firmware then logs 65535, and k came out at a quarter."""
    _, columns = flown[0]
    still = {**columns, "motor.m3_rpm": np.full_like(columns["motor.m3_rpm"], 65535.0)}
    flight = flown_in(still, tmp_path / "log.csv")
    assert flight.flight.speeds is None
    assert [finding.code for finding in flight.findings if finding.code == "flight-speeds-unused"]
    alone = {name: values for name, values in still.items() if name not in COMMANDS}
    with pytest.raises(DataError):
        flown_in(alone, tmp_path / "speeds.csv")


def test_rows_without_a_speed_or_an_attitude_are_left_out(flown: Flown, tmp_path: Path) -> None:
    vehicle, columns = flown[2]
    gaps = {name: values.copy() for name, values in columns.items()}
    for place, motor in enumerate(("m1", "m2", "m3", "m4")):
        gaps[f"motor.{motor}_rpm"][100 + place :: 97] = 65535.0
    for name in ("stateEstimate.qx", "stateEstimate.vx"):
        gaps[name][50::211] = np.nan
    for name in ("stateEstimate.qw", "stateEstimate.qx", "stateEstimate.qy", "stateEstimate.qz"):
        gaps[name][0] = 0.0
    result = fitted(flown_in(gaps, tmp_path / "log.csv"), vehicle)
    value, std = numbers(result, key := "motor.thrust_per_speed_squared_n_s2")
    assert abs(value - truths(vehicle)[key]) < 3 * std


def test_logs_of_two_vehicles_give_no_thrust(flown: Flown, tmp_path: Path) -> None:
    vehicle, columns = flown[2]
    alone = {name: values for name, values in columns.items() if name not in COMMANDS}
    other = {name: values * (1.25 if name.endswith("_rpm") else 1.0) for name, values in alone.items()}
    logs = [flown_in(each, tmp_path / f"{place}.csv") for place, each in enumerate((alone, other))]
    result = fit(logs, body=Body(mass_kg=vehicle.mass_kg, mass_std_kg=0.0, arm_m=vehicle.arm_m, arm_std_m=0.0))
    assert "motor.thrust_per_speed_squared_n_s2" in result.rejected


def test_rows_at_one_time_and_velocities_of_zero_are_read(flown: Flown, tmp_path: Path) -> None:
    vehicle, columns = flown[2]
    twice = {name: np.insert(values, 10, values[10]) for name, values in columns.items()}
    velocities = {name: 0 * values for name, values in twice.items() if name.startswith("stateEstimate.v")}
    result = fitted(flown_in({**twice, **velocities}, tmp_path / "log.csv"), vehicle)
    value, std = numbers(result, key := "motor.thrust_per_speed_squared_n_s2")
    assert abs(value - truths(vehicle)[key]) < 3 * std


def test_speeds_in_another_unit_are_implausible_for_a_brushless() -> None:
    for key, value in (("motor.thrust_per_speed_squared_n_s2", 3.6e-8), ("rotor_inertia_kg_m2", 3.9e-8)):
        assert not implausible(key, value, std=None, platform="cf21bl")
    for key, value in (("motor.thrust_per_speed_squared_n_s2", 3.6e-8 * 36), ("rotor_inertia_kg_m2", 3.9e-8 * 6)):
        assert implausible(key, value, std=None, platform="cf21bl")


def test_a_flights_torque_does_not_count_as_measured_in_the_next_fit(flown: Flown, cfid: Cfid, tmp_path: Path) -> None:
    vehicle, columns = flown[0]
    folder = tmp_path / "mine"
    make_campaign(folder, kind="simulated")
    flown_in(columns, folder / "log.csv")
    body = ("--mass-kg", f"{vehicle.mass_kg}:0.0001", "--arm-mm", f"{1e3 * vehicle.arm_m}:0.2")
    sections = []
    for _ in range(2):
        done = cfid("fit", "flight", "log.csv", *body, folder=folder)
        assert done.returncode == 0, done.stderr
        sections.append(open_campaign(folder).values().sections()["flight"].parameters)
    first, second = ({key: section[key].value for key in OF_YAW} for section in sections)
    assert second == first
