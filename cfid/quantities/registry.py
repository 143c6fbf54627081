"""The registry of all quantities that cfid estimates, uses or prints, by experiment, in the order of the thesis.

Plausible ranges cover quadrocopters from 10 g to 1 kg: a Crazyflie 2.0 has 0.028 kg, 0.046 m and 0.15 N per motor.
Those of well-known vehicles are narrower.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from typing import Any, Final, Literal

from cfid.units import FULL_COMMAND
from cfid.wire.app import MIDDLE

Platform = Literal["crazyflie", "cf2", "cf21", "cf21bl", "other"]
"""`crazyflie`: any quadrocopter of its kind; `other`: any body, judged by physics alone."""


class Shape(StrEnum):
    """The shape of a value, as messages print it."""

    NUMBER = "a number"
    LIST = "a list of numbers"
    NUMBER_OR_LIST = "a number or a list of numbers"
    POLYNOMIAL = "a list of coefficients"
    MATRIX = "a matrix of 3 times 3 numbers"
    ROWS = "a list of rows"


@dataclass(frozen=True)
class Range:
    """The least and the largest plausible size, ends included, and why.

    `of` names the part of a value that is checked: "" each number, "size" each number without its sign, "diagonal" the
    diagonal of a matrix, "slope" the slope of a polynomial at zero. With `at`, a polynomial's value there is checked.
    """

    least: float
    largest: float
    reason: str
    of: str = ""
    at: float | None = None


@dataclass(frozen=True)
class Aim:
    """The relative standard uncertainty that a quantity's purpose requires, and the purpose.

    A polynomial is judged where it is used: by its value `at` a place or by its `slope_in_hover`.
    """

    std: float
    purpose: str
    at: float | None = None
    slope_in_hover: bool = False


@dataclass(frozen=True)
class Quantity:
    """A quantity under its public key; in a key, `<axis>` stands for any name, and `[...]` is optional.

    `unit` is that of --json and parameters.toml. A polynomial gives a value with the unit `of` from one with the unit
    `over`; its highest power comes first unless `lowest_first` is set. `count` is how many numbers a list has, where
    that is known, and `places` are their names. `columns` are the columns of rows that must be numbers, `measured`
    those that a rejection removes. `section` is the quantity's section of parameters.toml, `given_by` the way to
    measure it. `of_the_run` marks a property of a run, not of the vehicle. A campaign takes quantities with the same
    word in `joint` from one fit, since they are parts of one result; by default, these are the quantities of a section.
    """

    key: str
    unit: str
    symbol: str
    title: str
    shape: Shape = Shape.NUMBER
    plausible: Range | None = None
    count: int | None = None
    places: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    measured: tuple[str, ...] = ()
    of: str = ""
    over: str = ""
    lowest_first: bool = False
    of_the_run: bool = False
    section: str = ""
    given_by: str = ""
    joint: str = ""
    aim: Aim | None = None


UNITS = {  # by the ending of a name
    "kg_m2": "kg m^2",
    "rad_per_s": "rad/s",
    "mps2": "m/s^2",
    "mps": "m/s",
    "nm": "N m",
    "kg": "kg",
    "mm": "mm",
    "rad": "rad",
    "deg": "deg",
    "ohm": "ohm",
    "hz": "Hz",
    "m": "m",
    "s": "s",
    "n": "N",
    "v": "V",
    "a": "A",
}


_INERTIA = Range(1e-6, 2e-2, "10 g on an axis 10 mm away to 1 kg on one 140 mm away")
_BODY = Range(1e-7, 1e-2, "blocks of a few grams to a few hundred; the thesis' has 1.6e-5")
_VISCOUS = Range(0, 1e-3, "the thesis found 1e-6; far above it nothing swings or turns on")
_COULOMB = Range(0, 1e-2, "40 g on a radius of 2 mm turn against less than 8e-4")
_TALK = Range(-0.2, 0.2, "data sheets state 0.02 at most")
_SPINNING = Range(0, 1000, "time constants above 1 ms, at any speed")
_LATE = Range(-0.5, 0.5, "a radio takes 3 to 20 ms; stamps may be late themselves")
_LAG = Range(1e-3, 1, "the thesis found 0.065 to 0.078")
_ROUND_TRIP = Range(1e-4, 1, "the thesis found 2 to 20 ms")
_DRAG = Range(-1e-4, 1e-7, "the thesis found -9e-7; above zero, beyond noise, air would drive the vehicle")
_CROSS_DRAG = Range(-1e-4, 1e-4, "as the simple model, of either sign off the diagonal")
_PARASITIC = Range(-1e-2, 1e-3, "a plate of 0.1 m has 6e-3; above zero air would drive the vehicle")


_AXES: Final[dict[str, Any]] = {"count": 3, "places": ("x", "y", "z")}


def _given(section: str, given_by: str, *rows: Quantity) -> tuple[Quantity, ...]:
    return tuple(
        replace(row, section=section, given_by=row.given_by or given_by, joint=row.joint or section) for row in rows
    )


_SWING = _given(
    "swing", "`cfid fit swing`",
    Quantity("swing.natural_frequency_squared_s2", "1/s^2", "W", "natural frequency squared, m g r / I",
             plausible=Range(1, 3000, "pendulums of 0.7 to 9 Hz; two threads choose their own, 0.2 Hz and more")),
    Quantity("swing.axis_inertia_kg_m2", "kg m^2", "I_a", "inertia about the mounting axis", plausible=_INERTIA),
    Quantity("swing.viscous_nms_per_rad", "N m s/rad", "c", "damping proportional to speed", plausible=_VISCOUS),
    Quantity("swing.coulomb_nm", "N m", "M_c", "dry friction", plausible=_COULOMB),
    Quantity("swing.quadratic_nms2_per_rad2", "N m s^2/rad^2", "q", "damping proportional to the square of speed",
             plausible=Range(-1e-3, 1e-3, "air around a palm-sized body: 1e-7; a bearing may take from it")),
    Quantity("swing.start_angle_rad", "rad", "φ_0", "angle at the release", of_the_run=True,
             plausible=Range(-3.15, 3.15, "a swing over the top is refused")),
    Quantity("swing.start_speed_rad_per_s", "rad/s", "φ'_0", "speed at the release", of_the_run=True,
             plausible=Range(-110, 110, "2 √W at most, or it goes over the top")),
    Quantity("swing.zero_rad", "rad", "φ_z", "rest angle", of_the_run=True),
    Quantity("swing.peaks_used", "1", "n", "peaks used, the release being the first", of_the_run=True),
)  # fmt: skip

_FRICTION = _given(
    "friction", "`cfid fit friction`",
    Quantity("friction.viscous_nms_per_rad", "N m s/rad", "c", "viscous friction of the axis, all weights together",
             plausible=_VISCOUS, aim=Aim(0.2, "the decay of swings")),
    Quantity("friction.coulomb_nm", "N m", "M_c", "Coulomb friction of the axis", plausible=_COULOMB),
    Quantity("friction.setup_inertia_kg_m2", "kg m^2", "I_s", "inertia of what turns, without the weight",
             plausible=Range(1e-9, 1e-3, "an axle of grams")),
    Quantity("friction.runs", "as named", "", "windows: speed and coefficient of each weight", Shape.ROWS),
)  # fmt: skip

_MATRICES = _given(
    "inertia", "`cfid fit inertia`",
    Quantity("inertia.matrix_kg_m2", "kg m^2", "I", "inertia matrix about the centre of mass, body frame",
             Shape.MATRIX, Range(5e-7, 2e-2, "10 g to 1 kg; its second moments are positive definite", "diagonal"),
             aim=Aim(0.03, "a rate controller's gains")),
    Quantity("inertia.axis_kg_m2.<axis>", "kg m^2", "I_a", "inertia about the mounting axis", plausible=_INERTIA),
    Quantity("inertia.centre_kg_m2.<axis>", "kg m^2", "I_G", "inertia about the parallel axis through the centre of "
             "mass", plausible=Range(5e-7, 2e-2, "as the matrix' diagonal")),
) + _given(
    "testbody", "`cfid fit testbody`",
    Quantity("testbody.calculated_kg_m2.<axis>", "kg m^2", "I_G", "inertia from the drawing", plausible=_BODY),
    Quantity("testbody.measured_kg_m2.<axis>", "kg m^2", "I_G", "inertia from the swings", plausible=_BODY),
    Quantity("testbody.error.<axis>", "1", "e", "measured less calculated, over the calculated one",
             plausible=Range(-1, 1, "beyond, another body swung")),
)  # fmt: skip

_LOADCELL = _given(
    "loadcell", "`cfid fit loadcell`",
    Quantity("loadcell.gain.<axis>", "1", "g", "reading of an axis over its load, for small loads",
             plausible=Range(0.8, 1.2, "beyond, a weight or the active calibration is wrong")),
    Quantity("loadcell.linearity.<axis>", "1", "q", "change of the gain up to the largest load",
             plausible=Range(-0.2, 0.2, "beyond, something touches")),
    Quantity("loadcell.cross_talk_force.<pair>", "1", "c", "part of a force that another axis shows",
             plausible=_TALK),
    Quantity("loadcell.cross_talk_nm_per_n.<pair>", "N m/N", "c", "torque that the cell shows of a force",
             plausible=Range(-0.02, 0.02, "20 mm: the place of the weight is wrong")),
    Quantity("loadcell.cross_talk_n_per_nm.<pair>", "N/(N m)", "c", "force that the cell shows of a torque"),
    Quantity("loadcell.cross_talk_torque.<pair>", "1", "c", "part of a torque that another axis shows",
             plausible=_TALK),
)  # fmt: skip

_OF_SPEEDS = "`cfid fit thrust` of runs with rotor speeds"
_MAPS = _given(
    "thrust", "`cfid fit thrust`",
    Quantity("motor.thrust_poly", "N(cmd)", "a", "input command to thrust, one motor", Shape.POLYNOMIAL,
             Range(0.01, 10, "thrust of one motor", at=FULL_COMMAND), of="N", over="cmd"),
    Quantity("motor.command_of_thrust", "as named", "", "command of a thrust: rising root of a cmd^2 + b cmd + c = "
             "thrust, with its range", Shape.ROWS, columns=("thrust_min_n",)),
    Quantity("motor.max_thrust_n", "N", "f_max", "thrust of one motor at full command",
             plausible=Range(0.01, 10, "10 g that hovers to 1 kg that climbs"),
             aim=Aim(0.03, "a controller's thrust limit")),
    Quantity("motor.hover_mass_kg", "kg", "m_hover", "mass that four motors hold at full command",
             plausible=Range(0.004, 4.1, "four times the largest thrust over g"),
             aim=Aim(0.02, "the hover command")),
    Quantity("motor.thrust_voltage_poly", "N(V)", "v", "motor voltage to thrust, one motor", Shape.POLYNOMIAL,
             Range(0.005, 10, "a Crazyflie has 0.1 N", at=3.0), of="N", over="V", lowest_first=True,
             given_by="`cfid fit thrust` of runs with the battery's voltage", joint="thrust over voltage"),
    Quantity("motor.thrust_per_speed_squared_n_s2", "N s^2/rad^2", "k", "thrust over rotor speed squared",
             plausible=Range(1e-9, 1e-5, "propellers of 45 mm have 2e-8"), given_by=_OF_SPEEDS,
             joint="thrust over speed"),
    Quantity("motor.thrust_speed_poly", "N(rad/s)", "s", "rotor speed to thrust, full quadratic", Shape.POLYNOMIAL,
             Range(0.001, 40, "k of 1e-9 to 1e-5", at=2000.0), count=3, of="N", over="rad/s", given_by=_OF_SPEEDS,
             joint="thrust over speed"),
    Quantity("motor.table", "as named", "", "what was measured at each command", Shape.ROWS, columns=("cmd",),
             given_by="`cfid fit thrust`, `cfid fit speed` or `cfid fit torque`", of_the_run=True),
) + _given(
    "speed", "`cfid fit speed`",
    Quantity("motor.speed_poly", "rad/s(cmd)", "b", "input command to rotor speed", Shape.POLYNOMIAL,
             Range(300, 10000, "the thesis found 3050", at=FULL_COMMAND), of="rad/s", over="cmd",
             given_by="`cfid fit speed`, or `cfid fit dynamics` of a flight log",
             aim=Aim(0.02, "rotor speeds in a simulator", at=MIDDLE)),
) + _given(
    "torque", "`cfid fit torque`",
    Quantity("motor.torque_poly", "Nm(N)", "c", "thrust to torque, one motor", Shape.POLYNOMIAL,
             Range(1e-3, 0.1, "published ones have 0.005 to 0.034", "slope"), of="N m", over="N",
             given_by="`cfid fit torque`, or `cfid fit flight` of a log with rotor speeds",
             aim=Aim(0.05, "yaw in a simulator", slope_in_hover=True)),
)  # fmt: skip

_ROTORS = _given(
    "rotor", "`cfid fit speed`",
    Quantity("rotor.speed_rad_s", "rad/s", "ω", "rotor speed from vibration, a number a window", Shape.NUMBER_OR_LIST,
             Range(200, 5000, "slower ones stand, faster ones no propeller survives"), of_the_run=True),
    Quantity("rotor.windows", "as named", "", "windows: speed estimated in each", Shape.ROWS,
             measured=("speed_rad_s", "std_rad_s"), of_the_run=True),
) + _given(
    "dynamics", "`cfid fit dynamics`",
    Quantity("dynamics.rising", "1/s, 1/rad", "k_r", "rotor model, spinning up: linear and quadratic", Shape.LIST,
             _SPINNING, count=2),
    Quantity("dynamics.falling", "1/s, 1/rad", "k_f", "rotor model, spinning down: linear and quadratic", Shape.LIST,
             _SPINNING, count=2),
    Quantity("dynamics.delay_s", "s", "δ", "delay of the rotor after its logged command", plausible=_LATE),
    Quantity("dynamics.time_constant_s", "s", "τ", "steps or rotors: time constant of each", Shape.ROWS,
             measured=("time_constant_s", "std_s", "delay_s")),
    Quantity("dynamics.map", "as named", "", "speed that each rotor follows, c0 + c1 u + c2 u^2 of a command, with std",
             Shape.ROWS),
)  # fmt: skip


def _transfer(key: str, symbol: str, of: str) -> tuple[Quantity, ...]:
    """Return the quantities of one transfer function, whose keys begin with `key`."""
    return (
        Quantity(f"{key}.numerator", "N", f"n{symbol}", f"numerator{of}, per unit of the command", Shape.POLYNOMIAL,
                 of="N", over="z^-1", lowest_first=True),
        Quantity(f"{key}.denominator", "1", f"d{symbol}", f"denominator{of}, with its leading 1", Shape.POLYNOMIAL,
                 of="1", over="z^-1", lowest_first=True),
        Quantity(f"{key}.time_constant_s", "s", f"τ{symbol}", f"time constant{of}", plausible=_LAG,
                 aim=None if of else Aim(0.05, "an attitude controller's bandwidth")),
        Quantity(f"{key}.static_gain_n", "N", f"K{symbol}", f"static gain{of}, per unit of the command",
                 plausible=Range(1e-8, 1e-3, "the thesis found 2.4e-6, the slope of its thrust map", "size")),
        Quantity(f"{key}.delay_s", "s", f"δ{symbol}", f"delay{of} of the force after the time stamp of its command",
                 plausible=_LATE),
        Quantity(f"{key}.delay_after_quickest_s", "s", f"δ_q{symbol}", f"the same delay{of} after the quickest stamps",
                 plausible=_LATE),
    )  # fmt: skip


_TRANSFER = _given(
    "tf", "`cfid tf identify`",
    *_transfer("tf", "", ""),
    Quantity("tf.sample_time_s", "s", "T", "sample time", plausible=Range(1e-4, 0.1, "0.002 on a Crazyflie")),
    Quantity("tf.lags_s", "s", "τ_i", "both lags of `shape` second", Shape.LIST, Range(1e-4, 1, "as the time "
             "constant"), count=2),
    Quantity("tf.lead_s", "s", "τ_0", "lead of `shape` zero", plausible=Range(-1, 1, "as the time constant")),
    *_transfer("tf.series.<series>", "_i", " of one series"),
    Quantity("tf.frequency_response", "N", "H", "frequency response", Shape.ROWS),
) + _given(
    "tf verify", "`cfid tf verify`",
    Quantity("tf.verify.<name>.fit_percent", "%", "F", "how much of a run's motion the simulation explains",
             plausible=Range(-1000, 100, "all of it at most"), of_the_run=True),
    Quantity("tf.verify.<name>.residual_rms_n", "N", "e", "what is left of the force",
             plausible=Range(0, 10, "as the largest thrust"), of_the_run=True),
    Quantity("tf.verify.<name>.late_s", "s", "Δt", "how much later than simulated",  # noise may hide it
             of_the_run=True),
    Quantity("tf.verify.<name>.gain_ratio", "1", "g", "how much larger than simulated",
             plausible=Range(0, 10, "beyond, another motor ran"), of_the_run=True),
)  # fmt: skip

_LATENCY = _given(
    "latency", "`cfid log ping` or `cfid tf latency`",
    Quantity("latency.rtt_mean_s", "s", "t_r", "mean round trip", plausible=_ROUND_TRIP,
             aim=Aim(0.05, "a controller over this link")),
    Quantity("latency.rtt_std_s", "s", "σ_r", "how far single round trips scatter",
             plausible=Range(0, 1, "as the round trip")),
    Quantity("latency.rtt_min_s", "s", "t_min", "least round trip", plausible=_ROUND_TRIP),
    Quantity("latency.rtt_median_s", "s", "t_50", "median round trip", plausible=_ROUND_TRIP),
    Quantity("latency.rtt_p95_s", "s", "t_95", "round trip that 95 % do not exceed", plausible=_ROUND_TRIP),
    Quantity("latency.clock_offset_s", "s", "t_0", "this computer's time less the vehicle's, amid the pings",
             plausible=Range(1e9, 4e9, "Unix time of 2001 to 2096"), of_the_run=True),
    Quantity("latency.clock_skew", "1", "s", "how much faster the vehicle's clock runs",
             plausible=Range(-0.05, 0.05, "firmware up to 2026.08 loses one in 85")),
)  # fmt: skip

_TERMS = (
    ("kg/rad", "sum of speeds and velocity"), ("kg/m", "velocity squared"), ("N s^2/rad^2", "sum of speeds squared"),
    ("kg/s", "velocity"), ("N s/rad", "sum of speeds"), ("N", "one, a constant"),
)  # fmt: skip
_DRAGS = _given(
    "drag", "`cfid fit drag`",
    Quantity("drag.simple_kg_per_rad", "kg/rad", "K", "simple model", Shape.LIST, _DRAG, count=3,
             aim=Aim(0.2, "drag in a simulator at 3 m/s")),
    Quantity("drag.cross_coupling_kg_per_rad", "kg/rad", "K", "cross-coupling model", Shape.MATRIX, _CROSS_DRAG),
    *(Quantity(f"drag.complex.k{i}", unit, f"K{i}", f"complex model: times {what}", Shape.LIST, count=3)
      for i, (unit, what) in enumerate(_TERMS, 1)),
    *(Quantity(f"drag.complex.normalised.k{i}", "", f"K{i}_n", f"the same, term {i} as equation 4.10 normalises it",
               Shape.LIST, count=3) for i in range(1, 7)),
    Quantity("drag.sse_n2.<model>", "N^2", "SSE", "squared errors of a model: simple, cross, complex", of_the_run=True),
    Quantity("drag.groups", "as named", "", "coefficients of the simple model by group, of `grouping`", Shape.ROWS),
    Quantity("drag.intercepts_n.<model>", "as named", "", "constant force of each wind, of `intercepts`", Shape.ROWS),
    Quantity("drag.parasitic_kg_per_m.<model>", "kg/m", "k_p", "drag of the body, of `parasitic`", Shape.LIST,
             _PARASITIC, count=3),
) + _given(
    "", "`cfid log wind`",
    Quantity("wind.missing_runs", "1", "", "runs of the thesis' plan that the campaign lacks"),
)  # fmt: skip

_BRAKED = Range(-0.01, 10, "30 g at 1 m/s are held back by 12 mN; below zero air would drive the vehicle")
_FLIGHTS = _given(
    "flight", "`cfid fit flight`",
    Quantity("flight.mass_kg", "kg", "m", "mass that thrust and moments in flight were scaled by",
             plausible=Range(0.005, 1, "10 g to 1 kg")),
    Quantity("flight.arm_m", "m", "l", "arm that moments in flight were scaled by",
             plausible=Range(0.01, 0.5, "a Crazyflie has 46 mm")),
    Quantity("flight.torque_m", "m", "q", "torque over thrust that the moment about yaw in flight was scaled by",
             plausible=Range(5e-4, 0.2, "a Crazyflie has 6 mm")),
    Quantity("flight.thrust_poly", "N(cmd)", "a_f", "input command to thrust in flight, one motor", Shape.POLYNOMIAL,
             Range(0.01, 10, "thrust of one motor", at=FULL_COMMAND), count=3, of="N", over="cmd"),
    Quantity("flight.thrust_voltage_poly", "N(V)", "v_f", "motor voltage to thrust in flight, one motor",
             Shape.POLYNOMIAL, Range(0.005, 10, "a Crazyflie has 0.1 N", at=3.0), count=3, of="N", over="V",
             lowest_first=True),
    Quantity("flight.rising_s", "s", "τ_r", "time constant of rotors as they speed up in flight", plausible=_LAG),
    Quantity("flight.falling_s", "s", "τ_f", "time constant of rotors as they slow down in flight", plausible=_LAG),
    Quantity("flight.time_constant_s", "s", "τ", "mean of both time constants in flight", plausible=_LAG),
    Quantity("flight.delay_s", "s", "t_d", "delay from command to rates in flight, besides the time constant",
             plausible=Range(-0.02, 0.05, "electronics, air and filters take milliseconds")),
    Quantity("flight.single_lag_s", "s", "τ_1", "mean time constant and delay of force: one lag for models without "
             "delay", plausible=_LAG),
    *(Quantity(f"flight.inertia_kg_m2.{axis}", "kg m^2", f"I_{axis}", f"moment of inertia about {axis} in flight",
               plausible=_INERTIA) for axis in ("roll", "pitch", "yaw")),
    *(Quantity(f"flight.moment_per_velocity_ns.{axis}", "N s", f"h_{axis}", f"moment of air about {axis} over velocity "
               f"{across}", plausible=Range(-0.1, 0.1, "a Crazyflie has 1e-3", "size"))
      for axis, across in (("roll", "to the left"), ("pitch", "forward"))),
    Quantity("flight.speed_delay_s", "s", "δ_s", "how much later the log shows rotor speeds than rates",
             plausible=Range(-0.03, 0.03, "telemetry and filters take milliseconds")),
    *(Quantity(f"flight.drag_over_mass_per_s.{axis}", "1/s", "-k/m", f"how air brakes along {axis}: minus its force "
               "over mass and velocity", plausible=_BRAKED) for axis in ("forward", "left")),
    *(Quantity(f"flight.drag_kg_per_s.{axis}", "kg/s", "k", f"force of air along {axis} over velocity",
               plausible=Range(-1, 1e-3, "above zero air would drive the vehicle")) for axis in ("forward", "left")),
)  # fmt: skip

_STATED = _given(
    "", "",
    Quantity("mass_kg", "kg", "m", "mass", plausible=Range(0.005, 1, "10 g to 1 kg, with room below"),
             given_by="rig.toml's vehicle, or `cfid set mass_kg 0.0280`"),
    Quantity("gravity_mps2", "m/s^2", "g", "local acceleration of free fall",
             plausible=Range(9.7, 9.9, "on earth: 9.76 on Huascaran, 9.83 at the poles"),
             given_by="rig.toml's site, or `cfid set gravity_mps2 9.81`"),
) + _given(
    "set", "",
    Quantity("arm_m", "m", "l", "vehicle's centre to a motor's axis", plausible=Range(0.015, 0.3, "a Crazyflie has "
             "0.046"), given_by="rig.toml's loadcell, or `cfid set arm_m 0.046`"),
    Quantity("rotor_inertia_kg_m2", "kg m^2", "I_r", "inertia of rotor and propeller about their axis",
             plausible=Range(1e-10, 1e-5, "a Crazyflie has 3e-8"),
             given_by="`cfid fit flight` of a log with rotor speeds, or `cfid set rotor_inertia_kg_m2 3e-8`"),
    Quantity("rotor_radius_m", "m", "R", "radius of a propeller", plausible=Range(0.005, 0.15, "a Crazyflie has "
             "0.0231"), given_by="`cfid set rotor_radius_m 0.0231`"),
)  # fmt: skip

_SHOWN = _given(
    "", "`cfid show`",
    Quantity("recording.[<device>.]samples", "1", "", "samples", of_the_run=True),
    Quantity("recording.[<device>.]duration_s", "s", "", "duration", of_the_run=True),
    Quantity("recording.[<device>.]median_interval_s", "s", "", "median interval of samples", of_the_run=True),
    Quantity("recording.[<device>.]longest_interval_s", "s", "", "longest interval of samples", of_the_run=True),
    Quantity("recording.[<device>.]range_rad", "rad", "", "range of the angle", of_the_run=True),
    Quantity("recording.[<device>.]mean_n", "N", "", "mean force", Shape.LIST, of_the_run=True,
             **_AXES),
    Quantity("recording.[<device>.]std_n", "N", "", "how far forces scatter", Shape.LIST, of_the_run=True,
             **_AXES),
    Quantity("recording.[<device>.]mean_nm", "N m", "", "mean torque", Shape.LIST, of_the_run=True,
             **_AXES),
    Quantity("recording.[<device>.]std_nm", "N m", "", "how far torques scatter", Shape.LIST, of_the_run=True,
             **_AXES),
    Quantity("recording.[<device>.]range.<column>", "", "", "lowest and highest number of a column",
             Shape.LIST, count=2, of_the_run=True),
    Quantity("recording.[<device>.]mean.<column>", "", "", "mean of a column, its unit as the column's name ends",
             of_the_run=True),
)  # fmt: skip

QUANTITIES = (
    *_SWING, *_FRICTION, *_MATRICES, *_LOADCELL, *_MAPS, *_ROTORS, *_TRANSFER, *_LATENCY, *_FLIGHTS, *_DRAGS, *_STATED,
    *_SHOWN,
)  # fmt: skip

_TORQUE = Range(0.003, 0.012, "published ones have 0.0052 to 0.0074", "slope")
_ROTOR = Range(1e-8, 2e-7, "published rotors and those of flights have 3e-8 to 6e-8")
_BRUSHED: Mapping[str, Range] = {
    "mass_kg": Range(0.019, 0.06, "27 g bare, and up to 15 g of decks are advised"),
    "arm_m": Range(0.03, 0.07, "0.046, and longer motor mounts"),
    "rotor_radius_m": Range(0.018, 0.03, "propellers of 45 to 51 mm"),
    "motor.thrust_poly": Range(0.07, 0.3, "published motors give 0.13 to 0.2 N", at=FULL_COMMAND),
    "motor.max_thrust_n": Range(0.07, 0.3, "published motors give 0.13 to 0.2 N"),
    "motor.speed_poly": Range(1700, 4600, "published motors give 2500 to 3100 rad/s", at=FULL_COMMAND),
    "motor.torque_poly": _TORQUE,
    "motor.thrust_per_speed_squared_n_s2": Range(1e-8, 5e-8, "published propellers have 1.8e-8 to 2.9e-8"),
    "rotor_inertia_kg_m2": _ROTOR,
    "tf.static_gain_n": Range(8e-7, 8e-6, "the slope of published thrust maps is 1e-6 to 4e-6", "size"),
    "drag.simple_kg_per_rad": Range(-1.5e-6, -6.5e-7, "the thesis found -9.2e-7 sideways and -1.03e-6 along z"),
}
_BRUSHLESS: Mapping[str, Range] = {
    "mass_kg": Range(0.025, 0.1, "37 g with its battery"),
    "arm_m": Range(0.035, 0.08, "0.05"),
    "rotor_radius_m": Range(0.02, 0.04, "propellers of 55 mm"),
    "motor.thrust_poly": Range(0.1, 0.5, "published motors give 0.2 to 0.25 N", at=FULL_COMMAND),
    "motor.max_thrust_n": Range(0.1, 0.5, "published motors give 0.2 to 0.25 N"),
    "motor.thrust_per_speed_squared_n_s2": Range(1.5e-8, 1e-7, "flights of three groups show 3.6e-8 to 4e-8"),
    "rotor_inertia_kg_m2": _ROTOR,
    "motor.torque_poly": _TORQUE,
}
_RANGES: Mapping[str, Mapping[str, Range]] = {"cf2": _BRUSHED, "cf21": _BRUSHED, "cf21bl": _BRUSHLESS}


@cache
def find(key: str) -> Quantity | None:
    """Return the quantity of a key, None for a key outside the registry, such as a name stored by hand."""
    return _BY_KEY.get(key) or next((found for pattern, found in _PATTERNS if pattern.fullmatch(key)), None)


def registered(key: str) -> Quantity:
    """Return the quantity of a key. Raises KeyError for a key outside the registry, which is a bug."""
    found = find(key)
    if found is None:
        raise KeyError(key)
    return found


def unit_of(key: str) -> str:
    """Return the unit of a key from the registry, else from the ending of its name; "" without either."""
    found = find(key)
    return found.unit if found is not None and found.unit else _at_the_end_of(key)


def range_of(key: str, platform: Platform) -> Range | None:
    """Return the plausible range of a number for a vehicle of a platform, None for a key without a range."""
    found = find(key)
    return platform_range(key, platform) or (found.plausible if found else None)


def platform_range(key: str, platform: Platform) -> Range | None:
    """Return the range of a well-known vehicle, narrower than the registry's; None where there is none."""
    return _RANGES.get(platform, {}).get(key)


def is_of_the_run(key: str) -> bool:
    """Return whether a key is a property of the run, not of the vehicle, such as the release of a swing."""
    found = find(key)
    return found is not None and found.of_the_run


def _at_the_end_of(name: str) -> str:
    """Return the unit that a name's ending states, "" without one or for part of a unit, as in `_m_per_s`."""
    suffix = next((suffix for suffix in UNITS if name.endswith(f"_{suffix}")), "")
    before = name.removesuffix(f"_{suffix}").rpartition("_")[-1]
    return "" if not suffix or before in {"per", *UNITS} else UNITS[suffix]


def _pattern(key: str) -> re.Pattern[str]:
    """Return the pattern of a key, where `<name>` is any name and `[...]` is optional."""
    words = re.split(r"<\w+>", key)
    return re.compile(".+".join(re.escape(word) for word in words).replace(r"\[", "(?:").replace(r"\]", ")?"))


_BY_KEY = {quantity.key: quantity for quantity in QUANTITIES}
_PATTERNS = [(_pattern(quantity.key), quantity) for quantity in QUANTITIES if "<" in quantity.key]
