"""SDFormat: links, joints and motors of a Crazyflie for both Gazebo and PX4; speeds are in rad/s.

Each rotor is a separate link. The mass and inertia of the rotors are subtracted from those of the body, so that the
whole vehicle has the measured values.
"""

import math
from collections.abc import Mapping, Sequence

from cfid.export.frame import Vector
from cfid.export.hover import (
    YAW_SIGNS,
    drag_kg_per_rad,
    inertia_kg_m2,
    lags_s,
    middle_m,
    moment_per_thrust_m,
    most_speed_rad_s,
    rotor_places_m,
)
from cfid.export.vehicle import ExportVehicle
from cfid.export.wording import number, numbers
from cfid.quantities.values import ENTRIES

NEEDS = (
    "mass",
    "inertia",
    "arm",
    "thrust_per_speed_squared",
    "torque_of_thrust",
    "speed_of_command",
    "rising+falling|thrust_lag",
)
NO_PLACE = ("thrust_of_command", "thrust_range", "max_thrust", "thrust_of_voltage", "thrust_of_speed", "delay")
NOTES = (
    "maxRotVelocity: rad/s (not rpm). motorConstant: N/(rad/s)^2 of one rotor. momentConstant: m (N m/N), not",
    "N m/rpm^2. rotorDragCoefficient: kg/rad over one rotor's speed and its velocity across the axis, mean of forward",
    "and left; zero means not measured, for Gazebo would take 1e-4. Drag along the axis has no place here.",
    "rollingMomentCoefficient: NOT MEASURED, zero switches it off, for Gazebo would take 1e-6. timeConstantUp,",
    "timeConstantDown: s, of rotor speeds around hovering. Joints turn ten times slower than rotors",
    "(rotorVelocitySlowdownSim), and the axial inertia of a measured rotor is ten times larger: its angular momentum",
    "is right. Each rotor's link has one hundredth of the mass, taken out of the body's mass and inertia.",
)
_SLOWDOWN = 10.0  # joints above 785 rad/s alias in PX4's steps of 4 ms
_ROTOR_SHARE = 0.01  # of the mass: enough for the solver, and little enough to subtract from the body
_RADIUS_M = 0.0231  # if not measured: the prop_radius of gym-pybullet-drones


def body(vehicle: ExportVehicle, name: str, sensors: str = "") -> str:
    """Return the link of all but the rotors; the origin of its frame is the centre of mass of the whole vehicle."""
    mass = float(vehicle["mass"])
    rotor = _ROTOR_SHARE * mass
    places = rotor_places_m(vehicle)
    rest = mass - 4 * rotor
    centre = tuple(-rotor * sum(place[axis] for place in places) / rest for axis in range(3))
    inertia = [list(row) for row in inertia_kg_m2(vehicle)]
    for place in places:
        _add(inertia, place, -rotor)
        for axis, moment in enumerate(_rotor_moments(vehicle, rotor)):
            inertia[axis][axis] -= moment
    _add(inertia, centre, -rest)
    hull = f"""<geometry>
          <cylinder>
            <radius>{number(vehicle["arm"])}</radius>
            <length>0.025</length>
          </cylinder>
        </geometry>"""
    return f"""    <link name="{name}">
      <inertial>
        <pose>{numbers(centre, " ")} 0 0 0</pose>
        <mass>{number(rest)}</mass>
        <inertia>
{_entries(inertia)}        </inertia>
      </inertial>
      <collision name="hull">
        <pose>{numbers(middle_m(vehicle), " ")} 0 0 0</pose>
        {hull}
      </collision>
      <visual name="hull">
        <pose>{numbers(middle_m(vehicle), " ")} 0 0 0</pose>
        {hull}
      </visual>
{sensors}    </link>
"""


def rotor(vehicle: ExportVehicle, motor: int, *, body_name: str, link: str, joint: str) -> str:
    """Return the link and the joint of a motor, counted from 0."""
    mass = _ROTOR_SHARE * float(vehicle["mass"])
    across, _, along = _rotor_moments(vehicle, mass)
    inertia = [[across, 0.0, 0.0], [0.0, across, 0.0], [0.0, 0.0, along]]
    return f"""    <link name="{link}">
      <pose>{numbers(rotor_places_m(vehicle)[motor], " ")} 0 0 0</pose>
      <inertial>
        <mass>{number(mass)}</mass>
        <inertia>
{_entries(inertia)}        </inertia>
      </inertial>
      <visual name="disc">
        <geometry>
          <cylinder>
            <radius>{number(_radius_m(vehicle))}</radius>
            <length>0.001</length>
          </cylinder>
        </geometry>
      </visual>
    </link>
    <joint name="{joint}" type="revolute">
      <parent>{body_name}</parent>
      <child>{link}</child>
      <axis>
        <xyz>0 0 1</xyz>
        <limit>
          <lower>-1e16</lower>
          <upper>1e16</upper>
        </limit>
      </axis>
    </joint>
"""


def motor_model(vehicle: ExportVehicle, motor: int, *, number_: int, link: str, joint: str, topic: str) -> str:
    """Return the plugin that converts commands in rad/s to forces; `topic` is the XML that names its topic."""
    up, down = lags_s(vehicle)
    ahead, left, _ = drag_kg_per_rad(vehicle) if "drag" in vehicle else (0.0, 0.0, 0.0)
    fields: Mapping[str, float] = {
        "maxRotVelocity": most_speed_rad_s(vehicle),
        "motorConstant": vehicle["thrust_per_speed_squared"],
        "momentConstant": moment_per_thrust_m(vehicle),
        "rotorDragCoefficient": (ahead + left) / 2,
        "rollingMomentCoefficient": 0.0,
        "rotorVelocitySlowdownSim": _SLOWDOWN,
        "timeConstantUp": up,
        "timeConstantDown": down,
    }
    return f"""    <plugin filename="gz-sim-multicopter-motor-model-system"
        name="gz::sim::systems::MulticopterMotorModel">
      {topic}
      <jointName>{joint}</jointName>
      <linkName>{link}</linkName>
      <turningDirection>{"ccw" if YAW_SIGNS[motor] < 0 else "cw"}</turningDirection>
      <motorNumber>{number_}</motorNumber>
      <motorType>velocity</motorType>
{"".join(f"      <{name}>{number(value)}</{name}>" + chr(10) for name, value in fields.items())}    </plugin>
"""


def _radius_m(vehicle: ExportVehicle) -> float:
    return float(vehicle["rotor_radius"]) if "rotor_radius" in vehicle else _RADIUS_M


def _rotor_moments(vehicle: ExportVehicle, mass_kg: float) -> Vector:
    """Return a rotor's moments of inertia as a disc, from the measured axial inertia times the slowdown if known."""
    along = mass_kg * _radius_m(vehicle) ** 2 / 2
    if "rotor_inertia" in vehicle:
        along = _SLOWDOWN * float(vehicle["rotor_inertia"])
    return along / 2, along / 2, along


def _add(inertia: list[list[float]], place: Sequence[float], mass_kg: float) -> None:
    """Add the inertia of a point mass at a place about the origin."""
    square = math.fsum(part * part for part in place)
    for i in range(3):
        for j in range(3):
            inertia[i][j] += mass_kg * ((square if i == j else 0.0) - place[i] * place[j])


def _entries(inertia: Sequence[Sequence[float]]) -> str:
    entries = sorted(ENTRIES.items())
    return "".join(f"          <i{name}>{number(inertia[i][j])}</i{name}>\n" for name, (i, j) in entries)
