"""OmniDrones' YAML file for a multirotor; speeds are in rad/s."""

import math

from cfid.export.hover import (
    YAW_SIGNS,
    inertia_kg_m2,
    moment_per_speed_squared_nm_s2,
    most_speed_rad_s,
    rotor_places_m,
)
from cfid.export.target import Target
from cfid.export.vehicle import ExportVehicle
from cfid.export.wording import HASH, number, numbers
from cfid.quantities.values import ENTRIES

_ORDER = (3, 2, 1, 0)  # motors m4 to m1: OmniDrones numbers rotors by angle


def write(vehicle: ExportVehicle) -> str:
    """Return the file."""
    matrix = inertia_kg_m2(vehicle)
    entries = "".join(f"  {name}: {number(matrix[i][j])}\n" for name, (i, j) in sorted(ENTRIES.items()))
    places = [rotor_places_m(vehicle)[motor] for motor in _ORDER]
    rotors = {
        "arm_lengths": [math.hypot(ahead, left) for ahead, left, _ in places],
        "directions": [float(-YAW_SIGNS[motor]) for motor in _ORDER],
        "force_constants": [vehicle["thrust_per_speed_squared"]] * 4,
        "max_rotation_velocities": [most_speed_rad_s(vehicle)] * 4,
        "moment_constants": [moment_per_speed_squared_nm_s2(vehicle)] * 4,
        "rotor_angles": [math.atan2(left, ahead) % (2 * math.pi) for ahead, left, _ in places],
    }
    return f"""
name: crazyflie
mass: {number(vehicle["mass"])}  # kg
inertia:  # kg m^2
{entries}drag_coef: 0.0  # NOT EXPORTED: see above
rotor_configuration:
  num_rotors: 4
{"".join(f"  {name}: [{numbers(values)}]" + chr(10) for name, values in rotors.items())}"""


TARGET = Target(
    name="omnidrones",
    file_name="omnidrones_crazyflie.yaml",
    about="Multirotor parameters for OmniDrones",
    comment=HASH,
    needs=("mass", "inertia", "arm", "thrust_per_speed_squared", "torque_of_thrust", "speed_of_command"),
    no_place=(
        "thrust_of_command",
        "thrust_range",
        "max_thrust",
        "thrust_of_voltage",
        "thrust_of_speed",
        "rising",
        "falling",
        "thrust_lag",
        "delay",
        "drag",
        "rotor_inertia",
        "rotor_radius",
    ),
    notes=(
        "A complete file: copy it over omni_drones/robots/assets/usd/crazyflie.yaml.",
        "force_constants: N/(rad/s)^2, moment_constants: N m/(rad/s)^2, max_rotation_velocities: rad/s (not rpm),",
        "arm_lengths: m from the centre of mass; rotor_angles: rad from forward to the left; all of one rotor",
        "each, in the order of m4, m3, m2, m1. directions: the sign of the rotor's turning, against that of its yaw",
        "moment. The simulator takes mass and inertia from its USD file; these here are its controllers'. Lags",
        "stand in its source. drag_coef times mass and velocity is added to the force there, which brakes only",
        "where it is negative; the simulator begins with none whatever stands here. Drag per rotor speed, as cfid",
        "measures it, has no place.",
    ),
    write=write,
)
