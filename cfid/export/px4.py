"""PX4's simulation in Gazebo: the vehicle's model, and the airframe that flies it; rotors in PX4's order."""

import math

from cfid.export import sdf
from cfid.export.hover import (
    YAW_SIGNS,
    hover_thrust_n,
    moment_per_thrust_m,
    most_speed_rad_s,
    rotor_places_m,
)
from cfid.export.target import Target
from cfid.export.vehicle import ExportVehicle
from cfid.export.wording import HASH, XML, number

_ORDER = (0, 2, 3, 1)  # rotor_0 to rotor_3 are m1, m3, m4, m2
_TOPIC = "<commandSubTopic>command/motor_speed</commandSubTopic>"
_RATES_HZ = {"air_pressure": 50, "magnetometer": 100, "imu": 250, "navsat": 30}


def write(vehicle: ExportVehicle) -> str:
    """Return the model file."""
    rotors = "".join(
        sdf.rotor(vehicle, motor, body_name="base_link", link=f"rotor_{i}", joint=f"rotor_{i}_joint")
        for i, motor in enumerate(_ORDER)
    )
    motors = "".join(
        sdf.motor_model(vehicle, motor, number_=i, link=f"rotor_{i}", joint=f"rotor_{i}_joint", topic=_TOPIC)
        for i, motor in enumerate(_ORDER)
    )
    return f"""<?xml version="1.0"?>
<sdf version="1.9">
  <model name="crazyflie">
    <pose>0 0 0.02 0 0 0</pose>
{sdf.body(vehicle, "base_link", "".join(_sensor(name, rate) for name, rate in _RATES_HZ.items()))}{rotors}{motors}\
  </model>
</sdf>
"""


def _sensor(name: str, rate_hz: int) -> str:
    return f"""      <sensor name="{name}_sensor" type="{name}">
        <always_on>1</always_on>
        <update_rate>{rate_hz}</update_rate>
      </sensor>
"""


def write_airframe(vehicle: ExportVehicle) -> str:
    """Return the start script, with the geometry, the motors and the thrust of hovering."""
    places, most = rotor_places_m(vehicle), most_speed_rad_s(vehicle)
    hovering = hover_thrust_n(vehicle) / (vehicle["thrust_per_speed_squared"] * most**2)
    lines = []
    for i, motor in enumerate(_ORDER):
        ahead, left, _ = places[motor]
        lines += [
            f"CA_ROTOR{i}_PX {number(ahead)}",
            f"CA_ROTOR{i}_PY {number(-left)}",
            f"CA_ROTOR{i}_KM {number(-YAW_SIGNS[motor] * moment_per_thrust_m(vehicle))}",
            f"SIM_GZ_EC_FUNC{i + 1} {101 + i}",
            f"SIM_GZ_EC_MIN{i + 1} 0",
            f"SIM_GZ_EC_MAX{i + 1} {math.floor(most)}",
        ]
    return f"""#!/bin/sh
#
# @name Gazebo crazyflie
#
# @type Quadrotor
#

. ${{R}}etc/init.d/rc.mc_defaults

PX4_SIMULATOR=${{PX4_SIMULATOR:=gz}}
PX4_GZ_WORLD=${{PX4_GZ_WORLD:=default}}
PX4_SIM_MODEL=${{PX4_SIM_MODEL:=crazyflie}}

param set-default SIM_GZ_EN 1
param set-default CA_AIRFRAME 0
param set-default CA_ROTOR_COUNT 4
{"".join(f"param set-default {line}" + chr(10) for line in lines)}\
param set-default THR_MDL_FAC 1.0
param set-default MPC_THR_HOVER {number(hovering)}
"""


GAZEBO = Target(
    name="px4-gazebo",
    file_name="px4_crazyflie_model.sdf",
    about="Model for PX4's simulation in Gazebo",
    comment=XML,
    needs=sdf.NEEDS,
    uses=("drag", "rotor_inertia", "rotor_radius"),
    no_place=sdf.NO_PLACE,
    notes=(
        "A complete model: put it at Tools/simulation/gz/models/crazyflie/model.sdf of PX4-Autopilot; the export",
        "px4-airframe flies it. Rotors are in PX4's order: rotor_0 to rotor_3 are m1, m3, m4, m2. Its sensors have no",
        "noise: none was measured.",
        *sdf.NOTES,
    ),
    write=write,
)
AIRFRAME = Target(
    name="px4-airframe",
    file_name="22000_gz_crazyflie",
    about="Airframe for PX4's simulation in Gazebo",
    comment=HASH,
    needs=("mass", "arm", "thrust_per_speed_squared", "torque_of_thrust", "speed_of_command"),
    no_place=(
        "inertia",
        *sdf.NO_PLACE,
        "rising",
        "falling",
        "thrust_lag",
        "drag",
        "rotor_inertia",
        "rotor_radius",
    ),
    notes=(
        "A complete file: put it into ROMFS/px4fmu_common/init.d-posix/airframes, name it in the CMakeLists.txt there,",
        "and `make px4_sitl gz_crazyflie`. CA_ROTOR*_PX, _PY: m forward and right of the centre of mass; _KM: m, the",
        "yaw moment over the thrust, positive for counter-clockwise rotors; SIM_GZ_EC_MAX*: rad/s at the full command,",
        "rounded down. THR_MDL_FAC 1: thrust is quadratic in the output. Gains are PX4's own: none was measured.",
    ),
    write=write_airframe,
)
