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
    if "inertia.matrix_kg_m2" in values and not is_consistent(np.array(values["inertia.matrix_kg_m2"])):
        return "inertia.matrix_kg_m2 is that of no possible body"
    command = np.linspace(*commands, _POINTS)
    thrust_n = _reached_n(values, command)
    square = values.get("motor.thrust_per_speed_squared_n_s2", math.nan)
    speed_rad_s = np.sqrt(np.maximum(thrust_n, 0.0) / square)
    speed_rad_s = speed_rad_s[np.isfinite(speed_rad_s)]
    maps = {
        "motor.thrust_poly": command,
        "motor.speed_poly": command,
        "motor.torque_poly": thrust_n,
        "motor.thrust_speed_poly": speed_rad_s,
    }
    for key, x in maps.items():
        if key in values and not np.all(np.polyval(np.polyder(np.array(values[key])), x) > 0):
            return f"{key} does not rise"
    most_n = values.get("motor.max_thrust_n")
    cubic: Sequence[float] | None = values.get("motor.thrust_voltage_poly")
    if cubic is not None and cubic_fault(cubic, max_thrust_n=most_n, fall=math.inf):
        return "motor.thrust_voltage_poly has no inverse in the firmware"
    for key in ("dynamics.rising", "dynamics.falling"):
        if key in values and not np.all(values[key][0] + 2 * values[key][1] * speed_rad_s > 0):
            return f"{key} is no lag"
    return ""


def _reached_n(values: Mapping[str, Any], command: Array) -> Array:
    """Return the thrusts (m,) above the idle thrust, in rising order, from a map or the largest thrust; else none."""
    if "motor.thrust_poly" in values:
        thrust_n = np.polyval(values["motor.thrust_poly"], command)
        return np.asarray(thrust_n[thrust_n >= IDLE * thrust_n[-1]])
    most_n = values.get("motor.max_thrust_n")
    return np.empty(0) if most_n is None else np.linspace(IDLE * most_n, most_n, _POINTS)
