"""Check whether a vehicle can have given parameters: a possible body, and rising maps that the firmware can invert."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.estimate.voltage_cubic import IDLE, cubic_fault
from cfid.inertia.matrix import is_consistent
from cfid.units import DEAD_COMMAND, FULL_COMMAND

Array = npt.NDArray[np.float64]

_POSITIVE = (
    "mass_kg",
    "arm_m",
    "rotor_inertia_kg_m2",
    "rotor_radius_m",
    "motor.max_thrust_n",
    "motor.thrust_per_speed_squared_n_s2",
    "tf.time_constant_s",
)
_POINTS = 50  # of a range, at which a slope is checked


def impossible(values: Mapping[str, Any], *, commands: tuple[float, float] = (DEAD_COMMAND, FULL_COMMAND)) -> str:
    """Return the first reason why no vehicle can have the parameters, given by key, or "" if a vehicle can.

    `commands` is the range in which the maps of the command were measured; the other maps are checked over the values
    that these maps reach. The firmware must be able to invert thrust over motor voltage, see `cubic_fault`. How far its
    motor commands may fall by rounding is no property of the vehicle and is not judged.
    """
    for key in _POSITIVE:
        if key in values and not values[key] > 0:
            return f"{key} is not above zero"
    matrix = values.get("inertia.matrix_kg_m2")
    if matrix is not None and not is_consistent(np.array(matrix)):
        return "inertia.matrix_kg_m2 is that of no possible body"
    cmd = np.linspace(*commands, _POINTS)
    for key in ("motor.thrust_poly", "motor.speed_poly"):
        if key in values and not _rises(values[key], cmd):
            return f"{key} does not rise"
    return _impossible_beyond(values, _reached_n(values, cmd))


def _impossible_beyond(values: Mapping[str, Any], thrust: Array) -> str:
    """Continue with the maps of thrust and of speed, over the thrusts (m,) that are reached, if any are known."""
    if len(thrust) and "motor.torque_poly" in values and not _rises(values["motor.torque_poly"], thrust):
        return "motor.torque_poly does not rise"
    cubic = values.get("motor.thrust_voltage_poly")
    most_n = values.get("motor.max_thrust_n")
    if cubic is not None and cubic_fault(cubic, max_thrust_n=most_n, fall=math.inf):
        return "motor.thrust_voltage_poly has no inverse in the firmware"
    square = values.get("motor.thrust_per_speed_squared_n_s2")
    if square is None or not len(thrust):
        return ""
    speed = np.sqrt(thrust / square)
    if "motor.thrust_speed_poly" in values and not _rises(values["motor.thrust_speed_poly"], speed):
        return "motor.thrust_speed_poly does not rise"
    for key in ("dynamics.rising", "dynamics.falling"):
        if key in values and not np.all(values[key][0] + 2 * values[key][1] * speed > 0):
            return f"{key} is no lag"
    return ""


def _reached_n(values: Mapping[str, Any], cmd: Array) -> Array:
    """Return the thrusts (m,) above the idle thrust, in rising order, from a map or the largest thrust; else none."""
    if "motor.thrust_poly" in values:
        thrust = np.polyval(values["motor.thrust_poly"], cmd)
        return np.asarray(thrust[thrust >= IDLE * thrust[-1]])
    most = values.get("motor.max_thrust_n")
    return np.empty(0) if most is None else np.linspace(IDLE * most, most, _POINTS)


def _rises(highest_first: Sequence[float], x: Array) -> bool:
    return bool(np.all(np.polyval(np.polyder(np.array(highest_first)), x) > 0))
