"""A Python file with RotorPy's dictionary for a multirotor; speeds are in rad/s."""

from collections.abc import Iterator

from cfid.export.hover import (
    YAW_SIGNS,
    drag_kg_per_rad,
    inertia_kg_m2,
    lags_s,
    moment_per_speed_squared_nm_s2,
    most_speed_rad_s,
    rotor_places_m,
)
from cfid.export.target import Target
from cfid.export.vehicle import ExportVehicle
from cfid.export.wording import HASH, number, numbers

_GAINS = {"k_w": 200.0, "k_v": 10.0, "kp_att": 310.0, "kd_att": 57.0}  # rotorpy 3.0.0, crazyflie_params.py


def write(vehicle: ExportVehicle) -> str:
    """Return the file."""
    places = "".join(
        f'        "r{i}": np.array([{numbers(place)}]),\n' for i, place in enumerate(rotor_places_m(vehicle), start=1)
    )
    lines = "".join(f'    "{name}": {number(value)},  # {words}\n' for name, value, words in _numbers(vehicle))
    return f"""
import numpy as np

quad_params = {{
{lines}    "num_rotors": 4,
    "rotor_pos": {{  # m from the centre of mass, motors m1 to m4; heights were not measured
{places}    }},
    "rotor_directions": np.array([{", ".join(map(str, YAW_SIGNS))}]),  # sign of the yaw moment
    "rI": np.zeros(3),  # m, the IMU's place: NOT MEASURED, in the centre of mass
}}
"""


def _numbers(vehicle: ExportVehicle) -> Iterator[tuple[str, float, str]]:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia_kg_m2(vehicle)
    yield "mass", vehicle["mass"], "kg"
    for name, value in (("Ixx", xx), ("Iyy", yy), ("Izz", zz), ("Ixy", xy), ("Iyz", yz), ("Ixz", xz)):
        yield name, value, "kg m^2"
    yield "k_eta", vehicle["thrust_per_speed_squared"], "N/(rad/s)^2 of one rotor"
    yield "k_m", moment_per_speed_squared_nm_s2(vehicle), "N m/(rad/s)^2 of one rotor"
    yield "tau_m", sum(lags_s(vehicle)) / 2, "s, mean of rising and falling"
    yield "rotor_speed_min", 0.0, "rad/s, a motor that stands"
    yield "rotor_speed_max", most_speed_rad_s(vehicle), "rad/s at the full command"
    yield from _drag(vehicle)
    for name in ("c_Dx", "c_Dy", "c_Dz"):
        yield name, 0.0, "N/(m/s)^2, parasitic drag: NOT MEASURED, zero switches it off"
    yield "k_h", 0.0, "kg/m, translational lift: NOT MEASURED, zero switches it off"
    yield "k_flap", 0.0, "kg m/rad, flapping moment: NOT MEASURED, zero switches it off"
    yield "motor_noise_std", 0.0, "rad/s: NOT MEASURED"
    for name, gain in _GAINS.items():
        yield name, gain, "a gain of RotorPy's own controllers for its Crazyflie, no measurement"


def _drag(vehicle: ExportVehicle) -> Iterator[tuple[str, float, str]]:
    if "drag" not in vehicle:
        yield "k_d", 0.0, "kg/rad: NOT MEASURED, zero switches it off"
        yield "k_z", 0.0, "kg/rad: NOT MEASURED, zero switches it off"
        return
    ahead, left, up = drag_kg_per_rad(vehicle)
    yield "k_d", (ahead + left) / 2, "kg/rad, over one rotor's speed and the velocity, mean of forward and left"
    yield "k_z", up, "kg/rad, the same along z"


TARGET = Target(
    name="rotorpy",
    file_name="rotorpy_params.py",
    about="Vehicle parameters for RotorPy (3.0)",
    comment=HASH,
    needs=(
        "mass",
        "inertia",
        "arm",
        "thrust_per_speed_squared",
        "torque_of_thrust",
        "speed_of_command",
        "rising+falling|thrust_lag",
    ),
    uses=("drag",),
    no_place=(
        "thrust_of_command",
        "thrust_range",
        "max_thrust",
        "thrust_of_voltage",
        "thrust_of_speed",
        "delay",
        "rotor_inertia",
        "rotor_radius",
    ),
    notes=(
        "A complete module: `from rotorpy_params import quad_params` serves Multirotor(quad_params) and",
        "SE3Control(quad_params). Speeds are in rad/s (not rpm); k_eta and k_m are those of one rotor; k_m is the",
        "slope of torque over thrust (m) times k_eta. k_d and k_z act on each rotor's own speed: summed over four they",
        "are cfid's coefficient of the summed speeds. Rising and falling share one lag, forward and left one drag;",
        "gravity is RotorPy's 9.81 m/s^2.",
    ),
    write=write,
)
