"""URDF files for gym-pybullet-drones and safe-control-gym; speeds are in revolutions per minute."""

from collections.abc import Mapping

from cfid.export.hover import (
    drag_kg_per_rad,
    hover_command,
    inertia_kg_m2,
    moment_per_thrust_m,
    rotor_places_m,
    slope_of,
    value_of,
)
from cfid.export.target import Target
from cfid.export.vehicle import ExportVehicle
from cfid.export.wording import XML, number, numbers
from cfid.quantities.values import ENTRIES
from cfid.units import FULL_COMMAND, RPM

_NEEDS = ("mass", "inertia", "arm", "thrust_per_speed_squared", "torque_of_thrust", "max_thrust")
_NOTES = (
    "A complete file: copy it over assets/cf2x.urdf of the gym. kf: N/rpm^2 of one motor; km: N m/rpm^2 of one motor",
    "(not m); arm: m from the centre to a motor, diagonally. thrust2weight: four motors at the full command over the",
    "weight, with the battery as it was measured. drag_coeff_*: kg/rad, over the sum of the four rotor speeds in",
    "rad/s and the velocity (not rpm), positive, mean of forward and left. The inertia is diagonal: for a whole matrix",
    "Bullet reports the pose of the principal axes instead of the body's. The rotors answer at once in both gyms, and",
    "their thrust is k omega^2.",
)
_NO_PLACE = (
    "thrust_of_voltage", "thrust_of_speed", "rising", "falling", "thrust_lag", "delay", "rotor_inertia", "thrust_range",
)  # fmt: skip

# The gyms' parsers need these values, which cfid does not measure; they are from the cf2x.urdf of both gyms.
_GYMS_OWN = {
    "max_speed_kmh": 30.0,
    "gnd_eff_coeff": 11.36859,
    "prop_radius": 2.31348e-2,
    "drag_coeff_xy": 0.0,  # not from the gyms: drag that was not measured is zero
    "drag_coeff_z": 0.0,
    "dw_coeff_1": 2267.18,
    "dw_coeff_2": 0.16,
    "dw_coeff_3": -0.11,
}
_COMMAND_LIMITS = {"pwm_min": 20000.0, "pwm_max": float(FULL_COMMAND)}
_HULL = '<origin rpy="0 0 0" xyz="0 0 0"/>\n      <geometry>\n        <cylinder radius="0.06" length="0.025"/>'


def properties(vehicle: ExportVehicle) -> dict[str, float]:
    """Return the attributes that both gyms share, by name."""
    kf = vehicle["thrust_per_speed_squared"] * RPM**2
    weight = vehicle["mass"] * vehicle.gravity_mps2
    found = {
        "arm": vehicle["arm"],
        "kf": kf,
        "km": moment_per_thrust_m(vehicle) * kf,
        "thrust2weight": 4 * vehicle["max_thrust"] / weight,
    }
    if "rotor_radius" in vehicle:
        found["prop_radius"] = vehicle["rotor_radius"]
    if "drag" in vehicle:
        ahead, left, up = drag_kg_per_rad(vehicle)
        found |= {"drag_coeff_xy": (ahead + left) / 2, "drag_coeff_z": up}
    return found


def speed_properties(vehicle: ExportVehicle) -> dict[str, float]:
    """Return the tangent at hovering of speed in rpm over command."""
    poly, hovering = vehicle["speed_of_command"], hover_command(vehicle)
    slope = slope_of(poly, hovering) / RPM
    return {"pwm2rpm_scale": slope, "pwm2rpm_const": value_of(poly, hovering) / RPM - slope * hovering}


def write(vehicle: ExportVehicle) -> str:
    """Return the file for gym-pybullet-drones."""
    return _robot(vehicle, properties(vehicle), _GYMS_OWN)


def write_safe_control(vehicle: ExportVehicle) -> str:
    """Return the file for safe-control-gym."""
    return _robot(vehicle, properties(vehicle) | speed_properties(vehicle), _GYMS_OWN | _COMMAND_LIMITS)


def _robot(vehicle: ExportVehicle, measured: Mapping[str, float], gyms_own: Mapping[str, float]) -> str:
    matrix = inertia_kg_m2(vehicle)
    entries = {f"i{name}": matrix[i][j] if i == j else 0.0 for name, (i, j) in sorted(ENTRIES.items())}
    lost = _attributes({f"i{name}": matrix[i][j] for name, (i, j) in ENTRIES.items() if i != j})
    others = {name: value for name, value in gyms_own.items() if name not in measured}
    return f"""<?xml version="1.0" ?>
<robot name="cf2">
  <!-- NOT MEASURED, the gym's own numbers or zero: {", ".join(others)}, and both cylinders -->
  <properties {_attributes({**measured, **others})}/>
  <link name="base_link">
    <inertial>
      <origin rpy="0 0 0" xyz="0 0 0"/>
      <mass value="{number(vehicle["mass"])}"/>
      <!-- measured and left out: {lost} kg m^2 -->
      <inertia {_attributes(entries)}/>
    </inertial>
    <visual>
      {_HULL}
      </geometry>
    </visual>
    <collision>
      {_HULL}
      </geometry>
    </collision>
  </link>
{"".join(_point(f"prop{i}", place) for i, place in enumerate(rotor_places_m(vehicle)))}\
{_point("center_of_mass", (0.0, 0.0, 0.0))}</robot>
"""


def _point(name: str, place_m: tuple[float, float, float]) -> str:
    """Return a massless link at a place where forces act."""
    return f"""  <link name="{name}_link">
    <inertial>
      <origin rpy="0 0 0" xyz="{numbers(place_m, " ")}"/>
      <mass value="0"/>
      <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>
    </inertial>
  </link>
  <joint name="{name}_joint" type="fixed">
    <parent link="base_link"/>
    <child link="{name}_link"/>
  </joint>
"""


def _attributes(values: Mapping[str, float]) -> str:
    return " ".join(f'{name}="{number(value)}"' for name, value in values.items())


GYM_PYBULLET_DRONES = Target(
    name="gym-pybullet-drones",
    file_name="gym_pybullet_drones_cf2x.urdf",
    about="URDF for gym-pybullet-drones",
    comment=XML,
    needs=_NEEDS,
    uses=("drag", "rotor_radius"),
    no_place=("thrust_of_command", "speed_of_command", *_NO_PLACE),
    notes=_NOTES,
    write=write,
)
SAFE_CONTROL_GYM = Target(
    name="safe-control-gym",
    file_name="safe_control_gym_cf2x.urdf",
    about="URDF for safe-control-gym",
    comment=XML,
    needs=(*_NEEDS, "thrust_of_command", "speed_of_command"),
    uses=("drag", "rotor_radius"),
    no_place=_NO_PLACE,
    notes=(
        *_NOTES,
        "pwm2rpm_scale, pwm2rpm_const: rpm of one motor over its command (0 to 65535), the tangent at hovering.",
        "pwm_min and pwm_max are limits of the gym's controller and no measurements.",
    ),
    write=write_safe_control,
)
