"""Plausible ranges of well-known vehicles: narrower than the registry's, which cover any small quadrocopter."""

from collections.abc import Mapping
from typing import Literal

from cfid.quantities.quantity import Range
from cfid.units import FULL_COMMAND

Platform = Literal["crazyflie", "cf2", "cf21", "cf21bl", "other"]
"""`crazyflie`: any quadrocopter of its kind; `other`: any body, judged by physics alone."""

_TORQUE = Range(0.003, 0.012, "published ones have 0.0052 to 0.0074", "slope")
_BRUSHED: Mapping[str, Range] = {
    "mass_kg": Range(0.019, 0.06, "27 g bare, and up to 15 g of decks are advised"),
    "arm_m": Range(0.03, 0.07, "0.046, and longer motor mounts"),
    "rotor_radius_m": Range(0.018, 0.03, "propellers of 45 to 51 mm"),
    "motor.thrust_poly": Range(0.07, 0.3, "published motors give 0.13 to 0.2 N", at=FULL_COMMAND),
    "motor.max_thrust_n": Range(0.07, 0.3, "published motors give 0.13 to 0.2 N"),
    "motor.torque_poly": _TORQUE,
    "motor.thrust_per_speed_squared_n_s2": Range(1e-8, 5e-8, "published propellers have 1.8e-8 to 2.9e-8"),
    "tf.static_gain_n": Range(8e-7, 8e-6, "the slope of published thrust maps is 1e-6 to 4e-6", "size"),
    "drag.simple_kg_per_rad": Range(-1.5e-6, -6.5e-7, "the thesis found -9.2e-7 sideways and -1.03e-6 along z"),
}
_BRUSHLESS: Mapping[str, Range] = {
    "mass_kg": Range(0.025, 0.1, "37 g with its battery"),
    "arm_m": Range(0.035, 0.08, "0.05"),
    "rotor_radius_m": Range(0.02, 0.04, "propellers of 55 mm"),
    "motor.thrust_poly": Range(0.1, 0.5, "published motors give 0.2 to 0.25 N", at=FULL_COMMAND),
    "motor.max_thrust_n": Range(0.1, 0.5, "published motors give 0.2 to 0.25 N"),
    "motor.torque_poly": _TORQUE,
}
RANGES: Mapping[str, Mapping[str, Range]] = {"cf2": _BRUSHED, "cf21": _BRUSHED, "cf21bl": _BRUSHLESS}
