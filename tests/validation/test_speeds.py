"""Rotor speeds in a log predict it without lags, and show what rotors' inertia and air over velocity do."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.flight.rows import ROW_STEPS, Flight, turned_back
from cfid.recordings.crazyflie import Timed
from cfid.records.campaign import open_campaign
from cfid.records.parameters import Parameter
from cfid.sim.flying import VEHICLES, fly
from cfid.sim.pilot import manoeuvres
from cfid.sim.stepping import Array
from cfid.units import FULL_COMMAND, RPM, USUAL_GRAVITY_MPS2
from cfid.validation.predictions import ParameterSet, best_delay, errors, next_rate_errors, starts
from cfid.validation.sets import measured_in, sets_of
from tests.export.thesis_vehicle import flown_sections
from tests.lab import keep, new_campaign

VEHICLE = VEHICLES["brushless_38"]


@pytest.fixture(scope="module")
def flown() -> Flight:
    plan = manoeuvres(["tilts", "yaw"], 10.0, np.random.default_rng(3))
    logs = fly([VEHICLE], plan[np.newaxis], rngs=[np.random.default_rng(4)])
    column = logs.columns(0)

    def columns(*names: str) -> Array:
        return np.column_stack([column[name] for name in names])

    attitude = columns(*(f"stateEstimate.q{part}" for part in "wxyz"))[::ROW_STEPS]
    in_air = np.arange(len(attitude)) > 50
    return Flight(
        name="sim",
        command=columns(*(f"motor.m{motor}" for motor in (1, 2, 3, 4))) / FULL_COMMAND,
        rates=np.radians(columns(*(f"gyro.{axis}" for axis in "xyz")))[::ROW_STEPS],
        force=USUAL_GRAVITY_MPS2 * columns(*(f"acc.{axis}" for axis in "xyz"))[::ROW_STEPS],
        airborne=in_air,
        driven=in_air,
        beyond=np.zeros(len(attitude), bool),
        averaged=False,
        velocity=turned_back(attitude, columns(*(f"stateEstimate.v{axis}" for axis in "xyz"))[::ROW_STEPS]),
        attitude=attitude,
        speeds=Timed(logs.time_s, RPM * columns(*(f"motor.m{motor}_rpm" for motor in (1, 2, 3, 4)))),
    )


@pytest.fixture(scope="module")
def true(flown: Flight) -> ParameterSet:
    (roll, _, _), (_, pitch, _), (_, _, yaw) = VEHICLE.inertia_kg_m2
    forward, left, _ = (4 * VEHICLE.hover_rad_s * drag / VEHICLE.mass_kg for drag in VEHICLE.drag_kg_per_rad)
    parameters = ParameterSet(
        name="true",
        origin="the plant",
        mass_kg=VEHICLE.mass_kg,
        moments_kg_m2=(roll, pitch, yaw),
        arm_m=VEHICLE.arm_m,
        torque_m=VEHICLE.torque_m,
        thrust_n=(),
        in_volts=False,
        drag_per_s=(forward, left),
        thrust_speed_n=(0.0, 0.0, VEHICLE.thrust_ns2_per_rad2, VEHICLE.thrust_slope),
        rotor_inertia_kg_m2=VEHICLE.rotor_inertia_kg_m2,
        moment_per_velocity_ns=VEHICLE.moment_per_velocity_ns,
    )
    return replace(parameters, delay_s=best_delay(flown, parameters, ("roll", "pitch", "yaw"))[1])


def test_a_set_follows_the_rotors_speeds_with_the_delay_between_gyro_and_telemetry(
    flown: Flight, true: ParameterSet
) -> None:
    gyro_s = 2**0.5 / (2 * np.pi * 80.0)  # of its filter of second order
    assert true.delay_s == pytest.approx(gyro_s - VEHICLE.telemetry_delay_s, abs=2.5e-3)
    late = replace(true, delay_s=true.delay_s + 0.01)
    best, worse = (float(next_rate_errors(flown, each, ("roll", "pitch"), parts=1)[0]) for each in (true, late))
    assert worse > 1.1 * best
    assert np.mean(errors(flown, true, starts(flown))["velocity"][:, 1]) < 0.05


@pytest.mark.parametrize(
    "unknown", [{"rotor_inertia_kg_m2": 0.0}, {"moment_per_velocity_ns": None}, {"moments_kg_m2": (3e-5, 3.2e-5, 6e-5)}]
)
def test_without_the_rotors_inertia_or_the_moment_over_velocity_rates_are_predicted_worse(
    flown: Flight, true: ParameterSet, unknown: dict[str, Any]
) -> None:
    at = starts(flown)
    whole, part = (float(np.mean(errors(flown, each, at)["rates"][:, 1])) for each in (true, replace(true, **unknown)))
    assert part > 1.05 * whole


def test_a_flight_gives_a_set_without_commands_and_lags_where_a_log_has_speeds(tmp_path: Path) -> None:
    new_campaign(tmp_path)
    fit = flown_sections()["flight"]
    scaled = {"flight.mass_kg": 0.03, "flight.arm_m": 0.046, "motor.thrust_speed_poly": [2e-8, 1e-7, 0.0]}
    more = {key: Parameter(value=value) for key, value in (scaled | {"motor.torque_poly": [0.006, 0.0]}).items()}
    keep(tmp_path, "flight", replace(fit, parameters={**fit.parameters, **more}))
    measured = measured_in(open_campaign(tmp_path))

    (found,), _ = sets_of(measured, in_volts=True, by_speed=True)
    assert (found.thrust_speed_n, found.thrust_n, found.lag) == ((0.0, 1e-7, 2e-8), (), None)
    assert found.moments_kg_m2 == (1.6e-5, 1.7e-5, 2.9e-5)
    assert (found.rotor_inertia_kg_m2, found.moment_per_velocity_ns) == (3e-8, (6e-4, -8e-4))
    without, missing = sets_of(measured, in_volts=True)
    assert without == []
    assert "flight.thrust_poly is not there" in missing[1]
