"""The params.toml of crazyflow's first-principles dynamics; speeds are in revolutions per minute."""

from collections.abc import Sequence

from cfid.export.hover import (
    YAW_SIGNS,
    arm_per_axis_m,
    drag_n_s_per_m,
    hover_speed_rad_s,
    hover_thrust_n,
    inertia_kg_m2,
    lags_s,
    moment_per_thrust_m,
    rotor_places_m,
    slope_of,
    value_of,
)
from cfid.export.target import Target
from cfid.export.vehicle import ExportVehicle
from cfid.export.wording import HASH, number, numbers, rows
from cfid.units import RPM

_DRONE = "cf2x_L250"  # crazyflow accepts only the drones of its list


def write(vehicle: ExportVehicle) -> str:
    """Return the file; a number that crazyflow needs but that was not measured is zero and marked."""
    drag = drag_n_s_per_m(vehicle) if "drag" in vehicle else (0.0, 0.0, 0.0)
    spin = vehicle.quantities["rotor_inertia"].value if "rotor_inertia" in vehicle else 0.0
    drag_words = "N/(m/s) with four rotors hovering" if "drag" in vehicle else "NOT MEASURED: zero switches drag off"
    spin_words = "kg m^2" if "rotor_inertia" in vehicle else "NOT MEASURED: zero leaves out the rotors' own inertia"
    _, *rising_torque = rpm_to_torque(vehicle)  # a constant torque cancels between left- and right-turning rotors
    least = float(vehicle["thrust_range"][0]["thrust_min_n"])
    diagonal = [[-drag[i] if i == j else 0.0 for j in range(3)] for i in range(3)]
    return f"""
[{_DRONE}]
mass = {number(vehicle["mass"])}  # kg
J = {rows(inertia_kg_m2(vehicle))}  # kg m^2
thrust_min = {number(max(least, 0.0))}  # N of one motor, where its map begins to rise
thrust_max = {number(vehicle["max_thrust"])}  # N of one motor
L = {number(arm_per_axis_m(vehicle))}  # m, distance from the forward and the left axis: the diagonal arm / sqrt(2)
prop_inertia = {number(spin)}  # {spin_words}
rpm2thrust = [{numbers(rpm_to_thrust(vehicle))}]  # N of one motor, power 0, 1, 2 of rpm
rpm2torque = [{numbers((0.0, *rising_torque))}]  # N m of one motor, power 0, 1, 2 of rpm; none at rest
rotor_dyn_coef = [{numbers(rotor_coefficients(vehicle))}]  # rising 1/s, 1/(rpm s), falling 1/s, 1/(rpm s)
mixing_matrix = {rows(_mixing(vehicle))}  # m1 to m4: roll and pitch in units of L about the centre of mass, yaw
drag_matrix = {rows(diagonal)}  # {drag_words}
"""


def _mixing(vehicle: ExportVehicle) -> tuple[Sequence[float], ...]:
    side, places = arm_per_axis_m(vehicle), rotor_places_m(vehicle)
    return [left / side for _, left, _ in places], [-ahead / side for ahead, _, _ in places], YAW_SIGNS


def rpm_to_thrust(vehicle: ExportVehicle) -> tuple[float, float, float]:
    """Return thrust in N over speed in rpm, lowest power first, with no thrust at rest.

    The polynomial keeps the value and slope of `thrust_of_speed` at hovering. Without `thrust_of_speed`, or where the
    polynomial would pull downwards at low speeds, it is k omega^2.
    """
    if "thrust_of_speed" in vehicle:
        speed = hover_speed_rad_s(vehicle)
        thrust = value_of(vehicle["thrust_of_speed"], speed)
        rise = slope_of(vehicle["thrust_of_speed"], speed) * speed
        if thrust < rise <= 2 * thrust:
            return 0.0, (2 * thrust - rise) / speed * RPM, (rise - thrust) / speed**2 * RPM**2
    return 0.0, 0.0, vehicle["thrust_per_speed_squared"] * RPM**2


def rpm_to_torque(vehicle: ExportVehicle) -> tuple[float, float, float]:
    """Return torque in N m over speed in rpm, lowest power first, by the tangent of torque over thrust at hovering."""
    slope, hovering = moment_per_thrust_m(vehicle), hover_thrust_n(vehicle)
    offset = value_of(vehicle["torque_of_thrust"], hovering) - slope * hovering
    constant, linear, quadratic = rpm_to_thrust(vehicle)
    return offset + slope * constant, slope * linear, slope * quadratic


def rotor_coefficients(vehicle: ExportVehicle) -> tuple[float, float, float, float]:
    """Return (rising 1/s, 1/(rpm s), falling 1/s, 1/(rpm s)), or those of a plain lag if only this is known."""
    if "rising" in vehicle and "falling" in vehicle:
        (a, b), (c, d) = vehicle["rising"], vehicle["falling"]
        return a, b * RPM, c, d * RPM
    up, down = lags_s(vehicle)
    return 1 / up, 0.0, 1 / down, 0.0


TARGET = Target(
    name="crazyflow",
    file_name="crazyflow_params.toml",
    about="First-principles dynamics for crazyflow (0.4)",
    comment=HASH,
    needs=(
        "mass",
        "inertia",
        "arm",
        "thrust_range",
        "max_thrust",
        "thrust_per_speed_squared",
        "torque_of_thrust",
        "rising+falling|thrust_lag",
    ),
    uses=("thrust_of_speed", "drag", "rotor_inertia"),
    no_place=("thrust_of_command", "speed_of_command", "thrust_of_voltage", "delay", "rotor_radius"),
    notes=(
        "A complete file: copy it over crazyflow/dynamics/first_principles/params.toml and fly",
        'Sim(drone="cf2x_L250", dynamics="first_principles"); keep the old file for the other drones. Speeds are in',
        "rpm; thrusts, torques and speeds are those of one motor; polynomials have the lowest power first. rpm2thrust",
        "has no thrust at rest. drag_matrix is per velocity, with the four rotors at the speed of hovering; cfid",
        "measures it over both. The controllers keep the mass and the curves of control/mellinger/params.toml.",
    ),
    write=write,
)
