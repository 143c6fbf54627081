"""A Python file with RotorPy's dictionary of a multirotor; speeds are in rad/s."""

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
from cfid.export.vehicle import Vehicle
from cfid.export.wording import HASH, number, numbers


def write(vehicle: Vehicle) -> str:
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
}}
"""


def _numbers(vehicle: Vehicle) -> Iterator[tuple[str, float, str]]:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia_kg_m2(vehicle)
    yield "mass", vehicle["mass"], "kg"
    for name, value in (("Ixx", xx), ("Iyy", yy), ("Izz", zz), ("Ixy", xy), ("Iyz", yz), ("Ixz", xz)):
        yield name, value, "kg m^2"
    yield "k_eta", vehicle["thrust_per_speed_squared"], "N/(rad/s)^2 of one rotor"
    yield "k_m", moment_per_speed_squared_nm_s2(vehicle), "N m/(rad/s)^2 of one rotor"
    yield "tau_m", sum(lags_s(vehicle)) / 2, "s, mean of rising and falling"
    yield "rotor_speed_min", 0.0, "rad/s, a motor that stands"
    yield "rotor_speed_max", most_speed_rad_s(vehicle), "rad/s at the full command"
    if "drag" in vehicle:
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
    notes=(
        "Speeds are in rad/s (not rpm); k_eta and k_m are those of one rotor; k_m is the slope of torque over thrust",
        "(m) times k_eta. k_d and k_z act on each rotor's own speed: summed over four they are cfid's coefficient",
        "of the summed speeds. What is left out RotorPy takes as zero: k_d and k_z where they were not measured,",
        "parasitic drag c_D*, k_h, k_flap, motor noise. The controller gains k_w, k_v, kp_att, kd_att and the",
        "IMU's place rI are no measurements: take them from the file that this one replaces.",
    ),
    write=write,
)
