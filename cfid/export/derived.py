"""The numbers that exports print: SI units, x forward, y left, z up, from the centre of mass, motors m1 to m4."""

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from cfid.errors import DataError
from cfid.estimate.voltage_cubic import IDLE, cubic_fault, least_thrust_n
from cfid.export.vehicle import ExportVehicle
from cfid.quantities.values import ENTRIES
from cfid.records.parameters import Value, plain
from cfid.units import FULL_COMMAND, MOTOR_AZIMUTH_DEG, ROTOR_TURNS, RPM

Array = npt.NDArray[np.float64]
Numbers = list[float]

_ROTOR_MASS_SHARE = 0.01  # enough for a solver, and little enough to subtract from the body
_PROPELLER_RADIUS_M = 0.0231  # if not measured: the prop_radius of gym-pybullet-drones
_LARGEST_MOTOR_V = 5.0
_ROTORS = ("dynamics.rising", "dynamics.falling")


class Motor(NamedTuple):
    """A motor: its number from 1, its place (3,) in m, and the same as distance and angle from forward to the left.

    `turn` is 1 for a rotor that turns counter-clockwise seen from above, else -1. The drag on a rotor turns the vehicle
    against it, which is the `yaw_sign`.
    """

    number: int
    place_m: Numbers
    arm_m: float
    angle_rad: float
    turn: int
    yaw_sign: int


class Derived:
    """The numbers of a vehicle, derived from its quantities when a template asks for them.

    Templates may be written by others, so public attributes are plain numbers, lists, dictionaries and named tuples:
    an array has methods that write files. An attribute raises DataError if a quantity that it needs is not known, or if
    it makes no sense.
    """

    rpm = RPM  # rad/s of one revolution per minute
    full_command = FULL_COMMAND

    def __init__(self, vehicle: ExportVehicle) -> None:
        """Take the quantities of a vehicle."""
        self._vehicle = vehicle
        self._axes, self._signs = np.array(vehicle.frame.axes).T  # in the campaign's frame

    def __getitem__(self, key: str) -> Any:
        """Return the value of a quantity as measured, in the campaign's body frame."""
        quantity = self._vehicle.find(key)
        if quantity is None:
            raise DataError(f"{key} was not measured, or is not among what the target needs and uses.")
        return quantity.value

    def has(self, need: str) -> bool:
        """Return whether a need is met: `a|b` by either quantity, `a+b` by both."""
        return bool(self._vehicle.met(need))

    def range_of(self, key: str) -> Numbers:
        """Return a number less and plus its expanded uncertainty (k = 2); twice the number if that is not known."""
        quantity = self._vehicle.find(key)
        return _around(float(self[key]), 0.0 if quantity is None else float(quantity.std or 0.0))

    @property
    def name(self) -> str:
        """The vehicle's name in rig.toml."""
        return self._vehicle.name

    # Body

    @cached_property
    def inertia_kg_m2(self) -> list[Numbers]:
        """The inertia matrix (3, 3) about the centre of mass; its products have the matrix' own signs."""
        matrix: list[Numbers] = self.turned_tensor(self["inertia.matrix_kg_m2"])
        return matrix

    def turned_tensor(self, tensor: Value, *, signed: bool = True) -> Value:
        """Return a tensor (3, 3), or its diagonal (3,), of the campaign's frame in the vehicle's, without rounding.

        Standard uncertainties are not `signed`. Unknown entries, None, stay unknown.
        """
        entries = np.array(tensor, dtype=np.float64)
        if entries.ndim == 1:
            return plain(entries[self._axes] + 0.0)
        turned = entries[np.ix_(self._axes, self._axes)] * np.outer(self._signs, self._signs) + 0.0
        return plain(turned if signed else np.abs(turned))

    @cached_property
    def inverse_inertia(self) -> list[Numbers]:
        """The inverse (3, 3) of the inertia matrix, in 1/(kg m^2)."""
        inverse: list[Numbers] = np.linalg.inv(np.array(self.inertia_kg_m2)).tolist()
        return inverse

    @cached_property
    def middle_m(self) -> Numbers:
        """The middle between the motors (3,), at the height of the centre of mass."""
        x, y, _ = self["centre_of_mass_m"]
        return _plain(0.0 - self._signs * np.array([x, y, 0.0])[self._axes])

    @cached_property
    def motors(self) -> list[Motor]:
        """The motors m1 to m4. Their heights were not measured and are zero."""
        motors = []
        for number, azimuth_deg in MOTOR_AZIMUTH_DEG.items():
            x = math.copysign(self.arm_per_axis_m, 90 - abs(azimuth_deg)) + self.middle_m[0]
            y = math.copysign(self.arm_per_axis_m, azimuth_deg) + self.middle_m[1]
            turn, angle_rad = ROTOR_TURNS[number], math.atan2(y, x) % (2 * math.pi)
            motors.append(Motor(number, [x, y, 0.0], math.hypot(x, y), angle_rad, turn, -turn))
        return motors

    @cached_property
    def arm_per_axis_m(self) -> float:
        """The distance of a motor from the forward and left axes through the middle."""
        return float(np.sqrt(0.5) * self["arm_m"])

    # Hovering

    @cached_property
    def hover_thrust_n(self) -> float:
        """A motor's share of the weight."""
        return float(self["mass_kg"] * self["gravity_mps2"] / 4)

    @cached_property
    def hover_command(self) -> float:
        """The command at which the vehicle hovers."""
        thrust_n = _polynomial(self["motor.thrust_poly"])
        most_n = thrust_n(float(FULL_COMMAND))
        if not thrust_n(0.0) < self.hover_thrust_n < most_n:
            raise DataError(f"no command hovers {self['mass_kg']:g} kg: a motor gives {most_n:.4g} N at most.")
        return _root(thrust_n, self.hover_thrust_n, float(FULL_COMMAND))

    @cached_property
    def hover_speed_rad_s(self) -> float:
        """The rotor speed at which the vehicle hovers, by the thrust over the squared speed."""
        square = _positive(self["motor.thrust_per_speed_squared_n_s2"], "motor.thrust_per_speed_squared_n_s2")
        return float(np.sqrt(self.hover_thrust_n / square))

    @cached_property
    def hover_command_speed_rad_s(self) -> float:
        """The rotor speed at the command at which the vehicle hovers, by the map of the command."""
        return _polynomial(self["motor.speed_poly"])(self.hover_command)

    @cached_property
    def full_speed_rad_s(self) -> float:
        """The rotor speed at the full command."""
        speed_rad_s = _polynomial(self["motor.speed_poly"])(float(FULL_COMMAND))
        return _positive(speed_rad_s, "motor.speed_poly at the full command")

    @cached_property
    def command_to_rpm(self) -> Numbers:
        """The tangent at hovering (2,) of the rotor speed in rpm over the command, lowest power first."""
        slope = _slope(self["motor.speed_poly"], self.hover_command) / RPM
        return [self.hover_command_speed_rad_s / RPM - slope * self.hover_command, slope]

    # Torque, drag and lag

    @cached_property
    def moment_per_thrust_m(self) -> float:
        """The slope of a rotor's torque over its thrust at hovering.

        Only the slope yaws the vehicle: a constant part of the torque cancels between the two pairs of rotors.
        """
        slope = _slope(self["motor.torque_poly"], self.hover_thrust_n)
        return _positive(slope, "the slope of motor.torque_poly at hovering")

    @cached_property
    def torque_at_no_thrust_nm(self) -> float:
        """Where the tangent at hovering of torque over thrust meets no thrust."""
        torque_nm = _polynomial(self["motor.torque_poly"])(self.hover_thrust_n)
        return torque_nm - self.moment_per_thrust_m * self.hover_thrust_n

    @cached_property
    def moment_per_speed_squared_nm_s2(self) -> float:
        """The yaw moment of a rotor over its squared speed."""
        return self.moment_per_thrust_m * float(self["motor.thrust_per_speed_squared_n_s2"])

    @cached_property
    def drag_kg_per_rad(self) -> Numbers:
        """Drag (3,) over the sum of rotor speeds times the velocity along each axis, positive if it brakes.

        It is zero if it was not measured: `has("drag")` tells.
        """
        if not self.has("drag"):
            return [0.0, 0.0, 0.0]
        drag = np.array(self.turned_tensor(self["drag"]))
        return _plain(-(np.diag(drag) if drag.ndim == 2 else drag))

    @cached_property
    def drag_across_kg_per_rad(self) -> float:
        """The mean of the forward and the left drag."""
        return sum(self.drag_kg_per_rad[:2]) / 2

    @cached_property
    def drag_n_s_per_m(self) -> Numbers:
        """Drag (3,) over the velocity along each axis, with the four rotors at hovering speed."""
        return [4 * self.hover_speed_rad_s * drag for drag in self.drag_kg_per_rad]

    @cached_property
    def flapping_kgm_per_rad(self) -> Numbers:
        """The moments of air (2,) about x over velocity along y, and about y over that along x.

        Both are also over the sum of the rotors' speeds, at hovering. They are zero if they were not measured.
        """
        if not self.has("flight.moment_per_velocity_ns.roll+flight.moment_per_velocity_ns.pitch"):
            return [0.0, 0.0]
        moments = [float(self[f"flight.moment_per_velocity_ns.{axis}"]) for axis in ("roll", "pitch")]
        return [moment / (4 * self.hover_speed_rad_s) for moment in moments]

    @cached_property
    def lags_s(self) -> Numbers:
        """The time constants of rising and falling rotor speeds, for small changes around hovering.

        They come from w' = a (u - w) + b (u^2 - w^2), whose slope at hovering is -(a + 2 b w), or else from the
        transfer function's time constant, which serves both directions.
        """
        if not self.has("dynamics.rising+dynamics.falling+motor.thrust_per_speed_squared_n_s2"):
            return [float(self["tf.time_constant_s"])] * 2
        rates = [a + 2 * b * self.hover_speed_rad_s for a, b in (self["dynamics.rising"], self["dynamics.falling"])]
        return [1 / _positive(rate, "the rate of dynamics.rising or dynamics.falling at hovering") for rate in rates]

    @cached_property
    def mean_lag_s(self) -> float:
        """The mean of the time constants of rising and falling."""
        return sum(self.lags_s) / 2

    @cached_property
    def lag_ranges_s(self) -> list[Numbers]:
        """The time constants of rising and falling, each less and plus its expanded uncertainty (k = 2).

        The speed at hovering counts as exact: that of the coefficients, whose errors cancel in part, is much larger.
        """
        if not self.has("dynamics.rising+dynamics.falling+motor.thrust_per_speed_squared_n_s2"):
            return [self.range_of("tf.time_constant_s")] * 2
        slopes = np.array([1.0, 2 * self.hover_speed_rad_s])
        stds = [math.sqrt(max(slopes @ of @ slopes, 0.0)) for of in self._rotor_covariances]
        return [_around(lag, lag**2 * std) for lag, std in zip(self.lags_s, stds, strict=True)]

    @cached_property
    def _rotor_covariances(self) -> list[Array]:
        """The covariance (2, 2) of the coefficients of rising and of falling: zero where it is not known."""
        for block in (block for of_fit in self._vehicle.covariance.values() for block in of_fit.get("covariance", ())):
            if tuple(block["of"]) == _ROTORS:
                matrix = np.array(block["matrix"])
                return [matrix[:2, :2], matrix[2:, 2:]]
        return [np.zeros((2, 2))] * 2

    @cached_property
    def rotor_coefficients_rpm(self) -> Numbers:
        """Rising in 1/s and 1/(rpm s), falling in 1/s and 1/(rpm s), or a plain lag if only this is known."""
        if self.has("dynamics.rising+dynamics.falling"):
            (a, b), (c, d) = self["dynamics.rising"], self["dynamics.falling"]
            return [a, b * RPM, c, d * RPM]
        return [1 / self.lags_s[0], 0.0, 1 / self.lags_s[1], 0.0]

    # Maps of motor voltage and of rpm, lowest power first

    @cached_property
    def voltage_cubic(self) -> Numbers:
        """Thrust in N over motor voltage (4,)."""
        cubic: Numbers = self["motor.thrust_voltage_poly"]
        if len(cubic) != 4:
            raise DataError(f"motor.thrust_voltage_poly has {len(cubic)} numbers; the firmware takes a cubic, of 4.")
        return cubic

    @cached_property
    def firmware_cubic(self) -> Numbers:
        """Thrust in N over motor voltage (4,) that the firmware can invert: with another one the motors would stop."""
        most_n = self["motor.max_thrust_n"] if self.has("motor.max_thrust_n") else None
        if fault := cubic_fault(self.voltage_cubic, max_thrust_n=most_n):
            raise DataError(f"no header: {fault} Fit again with `cfid fit thrust`, which constrains the cubic.")
        return self.voltage_cubic

    @cached_property
    def min_thrust_n(self) -> float:
        """The firmware's THRUST_MIN: below it, a motor stops."""
        most_n = float(self["motor.max_thrust_n"])
        return least_thrust_n(self.voltage_cubic, most_n) if self.has("motor.thrust_voltage_poly") else IDLE * most_n

    def volts(self, thrust_n: float) -> float:
        """Return the motor voltage that gives a thrust."""
        of_volts = _polynomial(self.voltage_cubic[::-1])
        if not of_volts(0.0) <= thrust_n <= of_volts(_LARGEST_MOTOR_V):
            raise DataError(
                f"motor.thrust_voltage_poly gives {thrust_n:.4g} N at no voltage from 0 to {_LARGEST_MOTOR_V:g} V."
            )
        return _root(of_volts, thrust_n, _LARGEST_MOTOR_V)

    @cached_property
    def volts_to_rpm(self) -> Numbers:
        """The tangent at hovering (2,) of the rotor speed in rpm over motor voltage."""
        volts, speed_rad_s = self.volts(self.hover_thrust_n), self.hover_speed_rad_s
        rise_n_per_v = _slope(self.voltage_cubic[::-1], volts)
        slope = rise_n_per_v / (2 * self["motor.thrust_per_speed_squared_n_s2"] * speed_rad_s)
        return [(speed_rad_s - slope * volts) / RPM, slope / RPM]

    @cached_property
    def volts_to_torque(self) -> Numbers:
        """Torque in N m over motor voltage (4,), by the tangent at hovering of torque over thrust."""
        constant, *others = (self.moment_per_thrust_m * coefficient for coefficient in self.voltage_cubic)
        return [self.torque_at_no_thrust_nm + constant, *others]

    @cached_property
    def rpm_to_thrust(self) -> Numbers:
        """Thrust in N over speed in rpm (3,), none at rest.

        It keeps value and slope at hovering of the measured map over speed. Without that map, or where the parabola
        would pull downwards at low speeds or bend down, it is k omega^2.
        """
        if self.has("motor.thrust_speed_poly"):
            speed_rad_s = self.hover_speed_rad_s
            thrust_n = _polynomial(self["motor.thrust_speed_poly"])(speed_rad_s)
            rise_n = _slope(self["motor.thrust_speed_poly"], speed_rad_s) * speed_rad_s
            if thrust_n < rise_n <= 2 * thrust_n:
                linear, square = (2 * thrust_n - rise_n) / speed_rad_s, (rise_n - thrust_n) / speed_rad_s**2
                return [0.0, linear * RPM, square * RPM**2]
        return [0.0, 0.0, self["motor.thrust_per_speed_squared_n_s2"] * RPM**2]

    @cached_property
    def rpm_to_torque(self) -> Numbers:
        """Torque in N m over speed in rpm (3,), by the tangent at hovering of torque over thrust."""
        _, linear, square = (self.moment_per_thrust_m * coefficient for coefficient in self.rpm_to_thrust)
        return [self.torque_at_no_thrust_nm, linear, square]

    # The vehicle as separate bodies, of which each rotor is one

    @cached_property
    def propeller_radius_m(self) -> float:
        """The radius of a propeller, or that of a Crazyflie's if it was not measured."""
        return float(self["rotor_radius_m"]) if self.has("rotor_radius_m") else _PROPELLER_RADIUS_M

    @cached_property
    def rotor_mass_kg(self) -> float:
        """The mass of a rotor: a small share of the vehicle's."""
        return _ROTOR_MASS_SHARE * float(self["mass_kg"])

    def rotor_moments_kg_m2(self, slowdown: float) -> Numbers:
        """Return the moments of inertia (3,) of a rotor that turns slower than the real one by a factor.

        They are those of a disc, or the measured axial inertia times the factor: its angular momentum is right.
        """
        along = self.rotor_mass_kg * self.propeller_radius_m**2 / 2
        if self.has("rotor_inertia_kg_m2"):
            along = slowdown * float(self["rotor_inertia_kg_m2"])
        return [along / 2, along / 2, along]

    @cached_property
    def rest_mass_kg(self) -> float:
        """The vehicle's mass without its rotors."""
        return float(self["mass_kg"]) - 4 * self.rotor_mass_kg

    @cached_property
    def rest_centre_m(self) -> Numbers:
        """The centre of mass (3,) of the vehicle without its rotors."""
        places = np.array([motor.place_m for motor in self.motors])
        return _plain(0.0 - self.rotor_mass_kg * places.sum(axis=0) / self.rest_mass_kg)

    def rest_inertia_kg_m2(self, slowdown: float) -> list[Numbers]:
        """Return the inertia matrix (3, 3) of the vehicle without its rotors, about its own centre of mass."""
        inertia = np.array(self.inertia_kg_m2) - 4 * np.diag(self.rotor_moments_kg_m2(slowdown))
        for motor in self.motors:
            inertia -= _of_a_point(self.rotor_mass_kg, motor.place_m)
        rest: list[Numbers] = (inertia - _of_a_point(self.rest_mass_kg, self.rest_centre_m)).tolist()
        return rest


def entries(matrix: Sequence[Sequence[float]]) -> dict[str, float]:
    """Return the six entries of a symmetric matrix (3, 3) by name, in the order xx, xy, xz, yy, yz, zz."""
    return {name: matrix[i][j] for name, (i, j) in sorted(ENTRIES.items())}


def _of_a_point(mass_kg: float, place_m: Numbers) -> Array:
    """Return the inertia matrix (3, 3) of a point mass about the origin."""
    place = np.array(place_m)
    return np.asarray(mass_kg * (place @ place * np.eye(3) - np.outer(place, place)))


def _polynomial(highest_first: Sequence[float]) -> Callable[[float], float]:
    return lambda x: float(np.polyval(highest_first, x))


def _slope(highest_first: Sequence[float], x: float) -> float:
    return float(np.polyval(np.polyder(np.array(highest_first)), x))


def _root(function: Callable[[float], float], wanted: float, largest: float) -> float:
    """Return the argument from 0 to `largest` at which a function has a value that it has between these."""
    return float(brentq(lambda x: function(x) - wanted, 0.0, largest, xtol=1e-12))


def _positive(value: float, what: str) -> float:
    if value <= 0:
        raise DataError(f"{what} is {value:.4g}: it should be above zero.")
    return value


def _around(value: float, std: float) -> Numbers:
    return [value - 2 * std, value + 2 * std]


def _plain(array: Array) -> Numbers:
    numbers: Numbers = np.asarray(array, dtype=np.float64).tolist()
    return numbers
