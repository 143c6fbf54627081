"""The inverse of a thrust map for a controller: the command for a thrust, and the largest thrust."""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from cfid.errors import FitError
from cfid.estimate.linear import fit_linear
from cfid.estimate.polynomials import PolynomialFit, fit_polynomial
from cfid.findings import Finding, rejection, warning
from cfid.motors.maps.estimation import MotorMap
from cfid.motors.maps.voltage import VoltageComparison
from cfid.motors.points import Array
from cfid.units import DEAD_COMMAND, FULL_COMMAND, NEAR_FULL, ROTORS

_OPEN = 0.25  # of an extrapolated thrust at full command: the largest accepted standard uncertainty
_MAXIMUM = ("motor.max_thrust_n", "motor.hover_mass_kg")
_FURTHER = 2.0
_BELOW, _BEYOND = 0.5, 1.2  # times the lowest and the highest voltage that a battery had: in between under any load
_NEAR = 0.1  # of full command: where nothing lower was measured, the inverse is extrapolated downwards


@dataclass(frozen=True, kw_only=True)
class InverseMap:
    """The inverse of one motor's thrust map: the command is the rising root of `coefficients` (3,), eq. 3.3 solved.

    It is valid within `command_range` and `thrust_range_n`, both ends included. `round_trip_command` is how far a
    command may change on its way to thrust and back in the single precision of the firmware, and `round_trip_n` how far
    the thrust of the rounded command is from the wanted thrust.
    """

    coefficients: Array
    command_range: tuple[float, float]
    thrust_range_n: tuple[float, float]
    round_trip_command: float
    round_trip_n: float
    findings: tuple[Finding, ...]

    def command(self, thrust_n: npt.ArrayLike) -> Array:
        """Return the commands for thrusts of any shape, nan outside of the range."""
        thrust = np.asarray(thrust_n, dtype=np.float64)
        low, high = self.thrust_range_n
        inside = (thrust >= low) & (thrust <= high)
        return np.where(inside, _root(self.coefficients, np.clip(thrust, low, high)), np.nan)


@dataclass(frozen=True, kw_only=True)
class MaximumThrust:
    """One motor's thrust at full command of all four, the largest measured thrust, and the mass with which four hover.

    `beyond_std_n` is the part of the standard uncertainty that is not the polynomial's own: what it may miss beyond the
    points. `volts` is the battery's voltage for which the thrust is stated, by the polynomial `by_volts` of motor
    voltage; both are None where the thrust follows from the command.
    """

    thrust_n: float
    std_n: float
    beyond_std_n: float
    volts: float | None
    by_volts: PolynomialFit | None
    measured_n: float
    measured_command: float
    hover_mass_kg: float
    hover_mass_std_kg: float
    findings: tuple[Finding, ...]


def invert(thrust_map: MotorMap) -> InverseMap:
    """Solve a thrust map of order 1 or 2 for the command, where it rises between the dead zone and full command.

    Raises FitError for another order, which has no such root, and for a map that nowhere rises above zero.
    """
    fit = thrust_map.fit
    if fit.order > 2:
        raise FitError(f"a thrust map of order {fit.order} has no inverse in closed form: fit it with order 2 too.")
    low, high = _rising(fit)
    coefficients = np.concatenate([np.zeros(2 - fit.order), fit.coefficients])
    first, last = fit.at([low, high]).tolist()
    commands = np.arange(low, high + 1, dtype=np.float32)
    single = coefficients.astype(np.float32)
    between = np.clip(fit.at(commands[:-1] + 0.5), first, last)  # rounding is worst half-way between two commands
    rounded = np.rint(_root(coefficients, between))
    lowest = float(thrust_map.command[thrust_map.command > DEAD_COMMAND].min())
    text = f"the command of a thrust is extrapolated below {lowest:.0f}, the smallest command that was measured."
    below = warning("inverse-extrapolated-below", text, "motor.command_of_thrust")
    return InverseMap(
        coefficients=coefficients,
        command_range=(low, high),
        thrust_range_n=(first, last),
        round_trip_command=float(np.max(np.abs(_root(single, np.polyval(single, commands)) - commands))),
        round_trip_n=float(np.max(np.abs(fit.at(rounded) - between))),
        findings=(below,) if lowest > max(low, _NEAR * FULL_COMMAND) else (),
    )


def maximum_thrust(thrust_map: MotorMap, *, gravity_mps2: float) -> MaximumThrust:
    """Return the thrust at full command and the mass that four motors hover with (section 3.3.1)."""
    fit = thrust_map.fit
    largest, highest = int(np.argmax(thrust_map.y)), float(thrust_map.command.max())
    far = highest < NEAR_FULL * FULL_COMMAND
    text = f"the thrust at command {FULL_COMMAND} is extrapolated: {highest:.0f} is the largest that was measured."
    beyond = warning("maximum-extrapolated", text, *_MAXIMUM)
    thrust, beyond_std = float(fit.at(FULL_COMMAND)), missed(fit, FULL_COMMAND) if far else 0.0
    std = math.hypot(float(fit.std_at(FULL_COMMAND)[0]), beyond_std)
    if far and not std < _OPEN * thrust:  # also where nothing shows how far it is off
        open_by = (
            f"open by {100 * std / thrust:.0f} % (limit {100 * _OPEN:.0f} %)" if std > 0 else "of unknown uncertainty"
        )
        beyond = rejection("maximum-open", f"{text.removesuffix('.')}, and {open_by}.", *_MAXIMUM)
    return MaximumThrust(
        thrust_n=thrust,
        std_n=std,
        beyond_std_n=beyond_std,
        volts=None,
        by_volts=None,
        measured_n=float(thrust_map.y[largest]),
        measured_command=float(thrust_map.command[largest]),
        hover_mass_kg=hover_mass_kg(thrust_n=thrust, gravity_mps2=gravity_mps2),
        hover_mass_std_kg=hover_mass_kg(thrust_n=std, gravity_mps2=gravity_mps2),
        findings=(beyond,) if far else (),
    )


def on_battery(
    most: MaximumThrust, voltage: VoltageComparison, *, order: int, motors: Array | float
) -> MaximumThrust | None:
    """Return the largest thrust by motor voltage, at the voltage to which the battery sags under four motors.

    It is None where the command predicts better, or as well and four motors ran, and where voltage and thrust rise
    together without end, as on a supply that was set to other voltages. The battery falls in proportion to its current:
    that of the `motors` (n,) which ran together, whose power goes with thrust to the power of 1.5. Where voltage and
    command predict equally well, the uncertainty contains that the thrust may follow the command.
    """
    if voltage.better == "command" or (voltage.better == "neither" and np.all(motors == ROTORS)):
        return None
    # The order is the map's: the firmware's cubic has to rise over all voltages, and may miss beyond the points.
    std = voltage.by_command.point_std
    fit = fit_polynomial(voltage.motor_volts, voltage.value, order=order, std=std if np.all(std > 0) else None)
    battery = voltage.motor_volts * FULL_COMMAND / voltage.command

    def row(motors: Array | float, thrust: Array | float, volts: Array | float) -> Array:
        current = np.asarray(motors * np.maximum(thrust, 0.0) ** 1.5 / volts)
        return np.stack([np.ones_like(current), current], axis=-1)

    line = fit_linear(row(motors, voltage.value, battery), battery, noise_known=False)

    def excess(volts: float) -> float:
        return float(row(ROTORS, float(fit.at(volts)), volts) @ line.values) - volts

    lowest_v, highest_v = _BELOW * float(battery.min()), _BEYOND * float(battery.max())
    if not excess(lowest_v) > 0 > excess(highest_v):
        return None
    volts = float(brentq(excess, lowest_v, highest_v))
    thrust = float(fit.at(volts))
    at = row(ROTORS, thrust, volts)
    volts_std = math.sqrt(float(at @ line.covariance @ at) + float(np.mean(line.residual**2)))
    ahead = missed(fit, volts) if voltage.command.max() < NEAR_FULL * FULL_COMMAND else 0.0
    beyond_std = math.hypot(ahead, float(fit.slope_at(np.array([volts]))[0]) * volts_std)
    if voltage.better == "neither":
        beyond_std = math.hypot(beyond_std, (thrust - most.thrust_n) / math.sqrt(3))
    total = math.hypot(float(fit.std_at(volts)[0]), beyond_std)
    ratio = most.hover_mass_kg / most.thrust_n
    return replace(
        most,
        thrust_n=thrust,
        std_n=total,
        beyond_std_n=beyond_std,
        volts=volts,
        by_volts=fit,
        hover_mass_kg=ratio * thrust,
        hover_mass_std_kg=ratio * total,
    )


def missed(fit: PolynomialFit, at: float) -> float:
    """Return by how much the polynomial may miss at a place ahead of the points, beyond its own uncertainty.

    That is twice by how much it misses the last points when fitted to those that lie as far below them as `at` lies
    ahead: a misfit grows with every step ahead. It is zero where such points are too few, or where `at` is not ahead.
    """
    last = float(fit.x.max())
    below = fit.x <= min(2 * last - at, 0.999 * last)
    if at <= last or len(np.unique(fit.x[below])) <= fit.order + 1:
        return 0.0
    value, end = fit.at(fit.x) + fit.residual, fit.x > 0.999 * last
    std = fit.point_std if np.all(fit.point_std > 0) else None  # nan neither
    shorter = fit_polynomial(fit.x[below], value[below], order=fit.order, std=None if std is None else std[below])
    miss = float(np.mean(value[end])) - float(shorter.at(last))
    own = float(shorter.std_at(last)[0]) ** 2 + (0.0 if std is None else float(np.mean(std[end] ** 2)))
    return _FURTHER * (math.sqrt(max(miss**2 - own, 0.0)) if math.isfinite(own) else abs(miss))


def hover_mass_kg(*, thrust_n: float, gravity_mps2: float) -> float:
    """Return the mass that four motors of this thrust hold in hover: 0.15 N gives 61.16 g (section 3.3.1)."""
    return ROTORS * thrust_n / gravity_mps2


def _rising(fit: PolynomialFit) -> tuple[float, float]:
    """Return the first and last whole command, from the dead zone up, where thrust is above zero and rises."""
    commands = np.arange(DEAD_COMMAND, FULL_COMMAND + 1)
    good = (fit.at(commands) > 0) & (fit.slope_at(commands) > 0)
    edges = np.flatnonzero(np.diff(good, prepend=False, append=False)).reshape(-1, 2)
    if not len(edges):
        raise FitError("the thrust map nowhere rises above zero with the command: it has no inverse.")
    first, end = edges[np.argmax(np.diff(edges, axis=1))]
    return float(commands[first]), float(commands[end - 1])


def _root(coefficients: npt.NDArray[np.floating], thrust: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Return the command c at which a c^2 + b c + d is the thrust and rises, in the precision of the arguments.

    Of the two forms of the root, this is the one that does not subtract nearly equal numbers.
    """
    a, b, d = coefficients
    root = np.sqrt(np.maximum(b * b + 4 * a * (thrust - d), 0))
    if b < 0:
        return np.asarray((root - b) / (2 * a))
    return np.asarray(2 * (thrust - d) / (b + root))
