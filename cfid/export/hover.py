"""Derive quantities around hovering, in SI units and in the targets' frame: x forward, y left, z up.

Every function takes a vehicle that has the quantities that its docstring names.
"""

import math
from collections.abc import Sequence

from cfid.errors import DataError
from cfid.export.frame import Matrix, Vector, turned_matrix, turned_spread
from cfid.export.vehicle import ExportVehicle
from cfid.units import FULL_COMMAND, MOTOR_AZIMUTH_DEG, ROTOR_TURNS

_CUBIC = 4  # coefficients

# The motors m1 to m4 of a Crazyflie, seen from above: (forward, left) in arm lengths, and the sign of the yaw
# moment that a rotor's drag exerts on the vehicle. m1 is at the front right and turns counter-clockwise; the drag on
# it turns the vehicle clockwise.
_DIAGONAL = math.sqrt(0.5)
PLACES = tuple((1 if abs(at) < 90 else -1, 1 if at > 0 else -1) for at in MOTOR_AZIMUTH_DEG.values())
YAW_SIGNS = tuple(-turn for turn in ROTOR_TURNS.values())


def inertia_kg_m2(vehicle: ExportVehicle) -> Matrix:
    """Return the inertia matrix (3, 3) about the centre of mass, from `inertia`."""
    return turned_matrix(vehicle["inertia"], vehicle.frame)


def inertia_std_kg_m2(vehicle: ExportVehicle) -> Matrix | None:
    """Return the standard uncertainties (3, 3) of the matrix' entries, None if unknown."""
    std = vehicle.quantities["inertia"].std
    if std is None:
        return None
    return turned_spread([[math.nan if part is None else part for part in row] for row in std], vehicle.frame)


def arm_per_axis_m(vehicle: ExportVehicle) -> float:
    """Return the distance of a motor from the forward and left axes, from `arm`, which is the diagonal distance."""
    return _DIAGONAL * float(vehicle["arm"])


def rotor_places_m(vehicle: ExportVehicle) -> tuple[Vector, ...]:
    """Return where m1 to m4 act, relative to the centre of mass, in m; heights were not measured and are zero."""
    side = arm_per_axis_m(vehicle)
    ahead, left, _ = middle_m(vehicle)
    return tuple((side * x + ahead, side * y + left, 0.0) for x, y in PLACES)


def middle_m(vehicle: ExportVehicle) -> Vector:
    """Return the middle between the motors relative to the centre of mass, in m, at the height of the latter."""
    ahead, left, _ = vehicle.frame.turned((vehicle.centre_m[0], vehicle.centre_m[1], 0.0))
    return 0.0 - ahead, 0.0 - left, 0.0


def hover_thrust_n(vehicle: ExportVehicle) -> float:
    """Return a motor's share of the weight in N."""
    return float(vehicle["mass"]) * vehicle.gravity_mps2 / 4


def hover_command(vehicle: ExportVehicle) -> float:
    """Return the command at which the vehicle hovers, from `thrust_of_command`.

    Raises DataError when no command suffices.
    """
    poly, wanted = vehicle["thrust_of_command"], hover_thrust_n(vehicle)
    low, high = 0.0, float(FULL_COMMAND)
    if not value_of(poly, low) < wanted < value_of(poly, high):
        raise DataError(
            f"no command hovers {vehicle['mass']:g} kg: a motor gives {value_of(poly, high):.4g} N at most."
        )
    while high - low > 1e-6:
        middle = (low + high) / 2
        low, high = (middle, high) if value_of(poly, middle) < wanted else (low, middle)
    return (low + high) / 2


def hover_speed_rad_s(vehicle: ExportVehicle) -> float:
    """Return the rotor speed at which the vehicle hovers, from `thrust_per_speed_squared`."""
    return math.sqrt(hover_thrust_n(vehicle) / float(vehicle["thrust_per_speed_squared"]))


def most_speed_rad_s(vehicle: ExportVehicle) -> float:
    """Return the rotor speed at the full command, from `speed_of_command`.

    Raises DataError when this speed is not above zero.
    """
    return _above_zero(value_of(vehicle["speed_of_command"], FULL_COMMAND), "motor.speed_poly at the full command")


def thrust_of_voltage(vehicle: ExportVehicle) -> Sequence[float]:
    """Return the four coefficients of thrust over motor voltage, lowest power first.

    Raises DataError when the campaign's polynomial is no cubic, since the firmware and its tools need a cubic.
    """
    cubic: Sequence[float] = vehicle["thrust_of_voltage"]
    if len(cubic) != _CUBIC:
        raise DataError(f"motor.thrust_voltage_poly has {len(cubic)} numbers; the firmware takes a cubic, of {_CUBIC}.")
    return cubic


def moment_per_thrust_m(vehicle: ExportVehicle) -> float:
    """Return the slope of a rotor's torque over its thrust at hovering, from `torque_of_thrust`.

    Only the slope yaws the vehicle, since a constant part of the torque cancels between the two pairs of rotors.

    Raises DataError when the slope is not above zero, since the vehicle would then yaw the other way.
    """
    slope = slope_of(vehicle["torque_of_thrust"], hover_thrust_n(vehicle))
    return _above_zero(slope, "the slope of motor.torque_poly at hovering")


def _above_zero(value: float, what: str) -> float:
    if value <= 0:
        raise DataError(f"{what} is {value:.4g}: it should be above zero.")
    return value


def moment_per_speed_squared_nm_s2(vehicle: ExportVehicle) -> float:
    """Return the yaw moment of a rotor over its squared speed, in N m s^2/rad^2."""
    return moment_per_thrust_m(vehicle) * float(vehicle["thrust_per_speed_squared"])


def drag_kg_per_rad(vehicle: ExportVehicle) -> Vector:
    """Return drag over (sum of rotor speeds times velocity) along forward, left and up, positive if it brakes."""
    value = vehicle["drag"]
    if not isinstance(value[0], Sequence):
        value = [[part if i == j else 0.0 for j in range(3)] for i, part in enumerate(value)]
    matrix = turned_matrix(value, vehicle.frame)
    return -matrix[0][0], -matrix[1][1], -matrix[2][2]


def drag_n_s_per_m(vehicle: ExportVehicle) -> Vector:
    """Return drag over velocity along forward, left and up, with the four rotors at hovering speed."""
    x, y, z = (4 * hover_speed_rad_s(vehicle) * part for part in drag_kg_per_rad(vehicle))
    return x, y, z


def has_lag(vehicle: ExportVehicle) -> bool:
    """Return whether the lags are known, either from the rotor model or from `thrust_lag`."""
    return _has_rotor_model(vehicle) or "thrust_lag" in vehicle


def _has_rotor_model(vehicle: ExportVehicle) -> bool:
    return all(name in vehicle for name in ("rising", "falling", "thrust_per_speed_squared"))


def lags_s(vehicle: ExportVehicle) -> tuple[float, float]:
    """Return the time constants of rising and falling rotor speeds for small changes around hovering.

    They come from `rising` and `falling`, w' = a (u - w) + b (u^2 - w^2), whose slope at hovering is -(a + 2 b w), or
    else from `thrust_lag`, which serves both directions.

    Raises DataError when the slope at hovering is not negative, since speeds would then run away.
    """
    if not _has_rotor_model(vehicle):
        return float(vehicle["thrust_lag"]), float(vehicle["thrust_lag"])
    speed = hover_speed_rad_s(vehicle)
    rising, falling = (a + 2 * b * speed for a, b in (vehicle["rising"], vehicle["falling"]))
    if rising <= 0 or falling <= 0:
        raise DataError(f"dynamics.rising and dynamics.falling make no lag at hovering, {speed:.0f} rad/s.")
    return 1 / rising, 1 / falling


def value_of(poly: Sequence[float], x: float) -> float:
    """Return the value at x of a polynomial with its highest power first."""
    total = 0.0
    for coefficient in poly:
        total = total * x + coefficient
    return total


def slope_of(poly: Sequence[float], x: float) -> float:
    """Return the slope at x of a polynomial with its highest power first."""
    order = len(poly) - 1
    return value_of([coefficient * (order - i) for i, coefficient in enumerate(poly[:-1])], x)
