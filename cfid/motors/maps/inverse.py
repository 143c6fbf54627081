"""The inverse of a thrust map for a controller: the command for a thrust, and the largest thrust."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError
from cfid.estimate.polynomials import PolynomialFit
from cfid.findings import Finding, warning
from cfid.motors.maps.estimation import MotorMap
from cfid.motors.points import Array
from cfid.units import DEAD_COMMAND, FULL_COMMAND, NEAR_FULL, ROTORS

_NEAR = 0.1  # of it: where no less was measured, the inverse is extrapolated downwards


@dataclass(frozen=True, kw_only=True)
class InverseMap:
    """command = the rising root of `coefficients` (3,) at a thrust, eq. 3.3 solved; one motor.

    Valid within `command_range` and `thrust_range_n`, both ends included. `round_trip_command` is how far a command
    may come back from thrust and inverse in the single precision of the firmware, `round_trip_n` how far the thrust of
    the rounded command is from the wanted thrust.
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
    """One motor's thrust at full command by the map, and the largest that was measured; what four could hover with."""

    thrust_n: float
    std_n: float
    measured_n: float
    measured_command: float
    hover_mass_kg: float
    hover_mass_std_kg: float
    findings: tuple[Finding, ...]


def invert(thrust_map: MotorMap) -> InverseMap:
    """Solve a thrust map of order 1 or 2 for the command, from above the dead zone to full, while it rises.

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
    between = np.clip(fit.at(commands[:-1] + 0.5), first, last)  # between two commands rounding is worst
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
    thrust, std = float(fit.at(FULL_COMMAND)), float(fit.std_at(FULL_COMMAND)[0])
    largest, highest = int(np.argmax(thrust_map.y)), float(thrust_map.command.max())
    far = highest < NEAR_FULL * FULL_COMMAND
    text = f"the thrust at command {FULL_COMMAND} is extrapolated: {highest:.0f} is the largest that was measured."
    beyond = warning("maximum-extrapolated", text, "motor.max_thrust_n", "motor.hover_mass_kg")
    return MaximumThrust(
        thrust_n=thrust,
        std_n=std,
        measured_n=float(thrust_map.y[largest]),
        measured_command=float(thrust_map.command[largest]),
        hover_mass_kg=hover_mass_kg(thrust_n=thrust, gravity_mps2=gravity_mps2),
        hover_mass_std_kg=hover_mass_kg(thrust_n=std, gravity_mps2=gravity_mps2),
        findings=(beyond,) if far else (),
    )


def hover_mass_kg(*, thrust_n: float, gravity_mps2: float) -> float:
    """Return the mass that four motors of this thrust keep in hover: 0.15 N make 61.16 g (section 3.3.1)."""
    return ROTORS * thrust_n / gravity_mps2


def _rising(fit: PolynomialFit) -> tuple[float, float]:
    """Return the first and last of the whole commands, up from the dead zone, where thrust is above zero and rises."""
    commands = np.arange(DEAD_COMMAND, FULL_COMMAND + 1)
    good = (fit.at(commands) > 0) & (fit.slope_at(commands) > 0)
    edges = np.flatnonzero(np.diff(good, prepend=False, append=False)).reshape(-1, 2)
    if not len(edges):
        raise FitError("the thrust map nowhere rises above zero with the command: it has no inverse.")
    first, end = edges[np.argmax(np.diff(edges, axis=1))]
    return float(commands[first]), float(commands[end - 1])


def _root(coefficients: npt.NDArray[np.floating], thrust: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Return where a c^2 + b c + d is the thrust and rises, in the precision of the arguments.

    Of the two forms of the root, the one that does not subtract nearly equal numbers.
    """
    a, b, d = coefficients
    root = np.sqrt(np.maximum(b * b + 4 * a * (thrust - d), 0))
    if b < 0:
        return np.asarray((root - b) / (2 * a))
    return np.asarray(2 * (thrust - d) / (b + root))
