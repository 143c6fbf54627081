"""Check that the Crazyflie's firmware can invert a cubic of motor voltage, in its single precision."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from cfid.units import FULL_COMMAND

Array = npt.NDArray[np.float64]

# THRUST_MIN over THRUST_MAX in every map that the firmware ships, and in its tools/system_id
IDLE = 7000 / FULL_COMMAND
# Of 65535: the most that rounding may reduce a motor command as thrust rises; brushed motors have steps of 256.
FALL = 6.5

_EMPTY_V, _CHARGED_V = 3.0, 4.2
_ERROR = 0.01  # of the range of thrusts: the largest error of a thrust after inversion
_SHIPPED_N = 0.2  # the largest THRUST_MAX that the firmware ships, used where a header has none
_LARGEST_FLOAT = 3.4e38
_KEY = "motor.thrust_voltage_poly"


def firmware_volts(lowest_first: npt.ArrayLike, thrust_n: Array) -> Array:
    """Return the motor voltages (n,) that the firmware finds for thrusts (n,), in its single precision."""
    c0, c1, c2, c3 = np.asarray(lowest_first, dtype=np.float32)
    thrust = thrust_n.astype(np.float32)
    with np.errstate(all="ignore"):
        p, r = -c2 / (3 * c3), c1 / (3 * c3)
        q = p * p * p + (c2 * c1 - 3 * c3 * (c0 - thrust)) / (6 * c3 * c3)
        root = np.sqrt(q * q + (r - p * p) * (r - p * p) * (r - p * p))
        return np.asarray(np.cbrt(q + root) + np.cbrt(q - root) + p, dtype=np.float64)


def least_thrust_n(lowest_first: Sequence[float], max_thrust_n: float) -> float:
    """Return the firmware's THRUST_MIN: its share of THRUST_MAX, and no less than the cubic's thrust at zero volts."""
    return max(IDLE * max_thrust_n, lowest_first[0])


def cubic_fault(lowest_first: Sequence[float], *, max_thrust_n: float | None = None, fall: float = FALL) -> str:
    """Return why the firmware cannot invert a thrust over motor voltage, "" where it can.

    The firmware uses Cardano's formula for one real root: the cubic has to rise over all voltages, including negative
    ones: c1 > 0, c3 > 0 and c2^2 <= 3 c1 c3. Otherwise the argument of a square root is negative, and the motors get no
    command. A cubic that falls only at negative voltages, to below the least thrust that the firmware inverts, is valid
    too; that of the thrust upgrade kit in 2026.08 is an example.

    All commands are then inverted in single precision, up to `max_thrust_n` (if that is unknown, up to the firmware's
    largest default, 0.2 N): voltages have to be finite and not negative, a motor command may fall by `fall` of 65535 at
    most, and each thrust has to be recovered within 1 % of the range.
    """
    if len(lowest_first) != 4:
        return f"{_KEY} has {len(lowest_first)} numbers; the firmware takes a cubic, of 4."
    if not all(abs(c) <= _LARGEST_FLOAT for c in lowest_first):  # also false for NaN
        shown = ", ".join(f"{c:g}" for c in lowest_first)
        return f"{_KEY} is {shown}; the firmware takes finite numbers in single precision."
    most_n = max_thrust_n or _SHIPPED_N
    least_n = least_thrust_n(lowest_first, most_n)
    _, c1, c2, c3 = lowest_first
    if not (c1 > 0 and c3 > 0 and (c2**2 <= 3 * c1 * c3 or _falls_below_zero_volts(lowest_first, least_n))):
        return (
            f"{_KEY} does not rise over all voltages (c1 = {c1:.4g}, c2 = {c2:.4g}, c3 = {c3:.4g}; expected c1 > 0, "
            "c3 > 0 and c2^2 <= 3 c1 c3): the firmware's inverse of it is no number, and its motors stop."
        )
    if not least_n < most_n:
        return f"{_KEY} gives {lowest_first[0]:.4g} N at 0 V, and the motor's largest thrust is {most_n:.4g} N."
    return _rounding_fault(lowest_first, least_n, most_n, fall)


def _rounding_fault(lowest_first: Sequence[float], least_n: float, most_n: float, fall: float) -> str:
    """Return why the inverse in single precision is unusable between two thrusts, "" if it is usable."""
    share = np.arange(FULL_COMMAND + 1, dtype=np.float32) / np.float32(FULL_COMMAND)
    thrust = (share * np.float32(most_n)).astype(np.float64)
    thrust = thrust[thrust >= np.float32(least_n)]
    volts = firmware_volts(lowest_first, thrust)
    lost = int(np.sum(~np.isfinite(volts)))
    if lost:
        return (
            f"{_KEY} has no inverse in the firmware's single precision for {lost} of {len(volts)} commands from "
            f"{least_n:.4g} to {most_n:.4g} N: its motors stop."
        )
    if volts.min() < 0:
        return f"{_KEY}: the firmware's inverse gives {volts.min():.4g} V in single precision; expected 0 V or more."
    fallen = float(np.max(np.maximum.accumulate(volts) - volts)) / _EMPTY_V * FULL_COMMAND
    if fallen > fall:
        return (
            f"{_KEY}: in the firmware's single precision the motor command falls by {fallen:.1f} of {FULL_COMMAND} as "
            f"thrust rises (limit {fall:g})."
        )
    given = thrust <= np.polyval(lowest_first[::-1], _CHARGED_V)
    apart = np.abs(np.polyval(lowest_first[::-1], volts) - thrust)[given] / (most_n - least_n)
    if not given.any() or apart.max() > _ERROR:
        found = f"misses a thrust by {100 * apart.max():.1f} % of the range" if given.any() else "reaches none"
        return (
            f"{_KEY}: between {least_n:.4g} and {most_n:.4g} N the firmware's inverse {found} up to {_CHARGED_V} V "
            f"(limit {100 * _ERROR:.0f} %)."
        )
    return ""


def _falls_below_zero_volts(lowest_first: Sequence[float], thrust_n: float) -> bool:
    """Return whether a cubic's local maximum is at a negative voltage and below a thrust; c1 and c3 are above zero."""
    c0, c1, c2, c3 = lowest_first
    if c2 <= 0:
        return False
    volts = (-c2 - float(np.sqrt(c2**2 - 3 * c1 * c3))) / (3 * c3)
    return c0 + volts * (c1 + volts * (c2 + volts * c3)) < thrust_n
