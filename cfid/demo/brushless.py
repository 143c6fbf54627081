"""The demo of an owner of a Crazyflie 2.1 Brushless, who has thread, kitchen scales and a ruler, and flies it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from cfid.demo.recordings import STAIRS, Plan, Recording
from cfid.demo.truth import true_matrix, true_motors
from cfid.flight.rows import AXES
from cfid.records.files import write_whole
from cfid.records.rig_file import Rig
from cfid.sim.flying import VEHICLES, FlyingVehicle, fly
from cfid.sim.pilot import manoeuvres
from cfid.sim.truth import SimTruth, as_mounted, draw_vehicle
from cfid.units import FULL_COMMAND

_MANOEUVRES = ("hover", "tilts", "yaw", "turns")
_SECONDS = 20.0  # of each
_MOUNTS = ("x", "y", "z", "xy", "xz", "yz", "x")
_FLOWN = VEHICLES["brushless_38"]
_MEASURED = {"mass_g": "38.0", "arm_mm": "50.0", "above_mm": "70.0", "below_mm": "70.0", "length_mm": "400.0"}

EXPERIMENTS: Plan = (
    ((), ("fit flight hover.csv tilts.csv yaw.csv turns.csv", "fit dynamics yaw.csv")),
    (tuple(Recording(f"log gyro --axis {axis} --for 30", {"axis": axis}) for axis in _MOUNTS), ("fit inertia",)),
    ((Recording(f"log scales --motor 1,2,3,4 {STAIRS}", reads="grams"),), ("fit thrust",)),
)


def owned_truth() -> SimTruth:
    """Return the true parameters of the owner's rig: of the vehicle that flies, whose thrust is k w^2 here."""
    thrust_ns2_per_rad2 = _FLOWN.thrust_ns2_per_rad2 + _FLOWN.thrust_slope * _FLOWN.hover_rad_s
    return SimTruth.model_validate(
        {
            "crazyflie": {"platform": "cf21bl"},
            "vehicle": {"inertia_kg_m2": _FLOWN.inertia_kg_m2},
            "rotors": {"thrust_ns2_per_rad2": thrust_ns2_per_rad2, "torque_m": _FLOWN.torque_m},
        }
    )


def state_measured(rig_file: Path) -> None:
    """Write what the owner measured in place of each question mark of a new rig.toml."""
    text = rig_file.read_text(encoding="utf-8")
    text = re.sub(r'(\w+) = "\?', lambda found: f'{found[1]} = "{_MEASURED[found[1]]}', text)
    write_whole(rig_file, text.encode())


def flying(truth: SimTruth, rig: Rig, *, seed: int) -> FlyingVehicle:
    """Return the vehicle of a rig as it flies: its mass, inertia, arm and rotors are those of the rig's truth."""
    truth = as_mounted(truth, rig)
    rotors = truth.rotors
    return replace(
        _FLOWN,
        mass_kg=draw_vehicle(rig, truth, rng=np.random.default_rng(seed).spawn(1)[0]).mass_kg,
        inertia_kg_m2=truth.vehicle.inertia_kg_m2,
        arm_m=rotors.arm_m * (1 + rotors.arm_error),
        thrust_ns2_per_rad2=rotors.thrust_ns2_per_rad2,
        thrust_slope=0.0,
        torque_m=rotors.torque_m,
        idle_rad_s=rotors.idle_rad_per_s,
        rad_s_per_v=rotors.rad_per_s_per_command * FULL_COMMAND / rotors.nominal_v,
    )


def write_flights(folder: Path, vehicle: FlyingVehicle, *, seed: int) -> None:
    """Fly each manoeuvre, and write its log into a folder."""
    rngs = [np.random.default_rng([seed, place]) for place in range(len(_MANOEUVRES))]
    plans = [manoeuvres([kind], _SECONDS, rng) for kind, rng in zip(_MANOEUVRES, rngs, strict=True)]
    logs = fly([vehicle] * len(plans), np.stack(plans), rngs=rngs)
    for place, kind in enumerate(_MANOEUVRES):
        columns = {"t": logs.time_s, **logs.columns(place)}
        table, head = np.column_stack(list(columns.values())), ",".join(columns)
        np.savetxt(folder / f"{kind}.csv", table, "%.7g", ",", header=head, comments="")


def true_values(truth: SimTruth, vehicle: FlyingVehicle) -> dict[str, float]:
    """Return the true values of the owner's rig and of the flight, by the names of the parameters' numbers."""
    motors, moments = true_motors(truth), np.diagonal(vehicle.inertia_kg_m2)
    of_fits = ("motor.thrust_poly [0]", "motor.torque_poly [0]", "motor.thrust_per_speed_squared_n_s2")
    return {
        **true_matrix(truth),
        **{name: motors[name] for name in of_fits},
        "rotor_inertia_kg_m2": vehicle.rotor_inertia_kg_m2,
        **{f"dynamics.rising [{place}]": value for place, value in enumerate(vehicle.rising)},
        **{f"dynamics.falling [{place}]": value for place, value in enumerate(vehicle.falling)},
        **{f"flight.inertia_kg_m2.{axis}": float(moment) for axis, moment in zip(AXES, moments, strict=True)},
        **{
            f"flight.moment_per_velocity_ns.{axis}": moment
            for axis, moment in zip(AXES[:2], vehicle.moment_per_velocity_ns, strict=True)
        },
    }
