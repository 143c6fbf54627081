"""Which values a Crazyflie-sized vehicle can have, and which voltage cubic its firmware can invert.

A value outside of its range is most likely in another unit: the message guesses which.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

_OTHER_UNITS: Mapping[str, Mapping[float, str]] = {
    "kg": {1e-3: "grams"},
    "m": {1e-3: "millimetres", 1e-2: "centimetres"},
    "s": {1e-3: "milliseconds", 1e-6: "microseconds"},
    "N": {1e-3: "millinewtons", 9.81e-3: "grams of thrust"},
    "kg m^2": {1e-9: "g mm^2", 1e-7: "g cm^2", 1e-6: "kg mm^2", 1e-3: "g m^2"},
    "N s^2/rad^2": {(60 / (2 * math.pi)) ** 2: "N/rpm^2"},
}

_LARGEST_FLOAT = 3.4e38  # of single precision


@dataclass(frozen=True)
class Range:
    """The least and the largest plausible size of a quantity, in its unit, ends included."""

    least: float
    largest: float
    unit: str


# From a nano quadrocopter of 10 g to one of 1 kg: a Crazyflie 2.0 has 0.028 kg, 0.046 m and 0.15 N a motor.
RANGES: Mapping[str, Range] = {
    "mass_kg": Range(0.005, 1.0, "kg"),
    "arm_m": Range(0.015, 0.3, "m"),
    "rotor_radius_m": Range(0.005, 0.15, "m"),
    "rotor_inertia_kg_m2": Range(1e-10, 1e-5, "kg m^2"),
    "inertia.matrix_kg_m2": Range(5e-7, 2e-2, "kg m^2"),  # of its diagonal
    "motor.max_thrust_n": Range(0.01, 10.0, "N"),
    "motor.thrust_per_speed_squared_n_s2": Range(1e-9, 1e-5, "N s^2/rad^2"),
    "tf.time_constant_s": Range(1e-3, 1.0, "s"),
}


def implausible(key: str, value: Any) -> str:
    """Return what is implausible about a quantity's value as a sentence, with a guess of its unit; "" where nothing.

    Of a matrix the diagonal is judged. Keys without a range pass, and so does what is no number.
    """
    if key not in RANGES:
        return ""
    found = RANGES[key]
    for number in _judged(value):
        if not found.least <= number <= found.largest:
            guess = _guess(number, found)
            return (
                f"{key} is implausible, {_shown(number)} {found.unit}{f': {guess}?' if guess else '.'} "
                f"Expected {found.least:g} to {found.largest:g} {found.unit}."
            )
    return ""


def cubic_fault(lowest_first: Sequence[float], *, least_n: float = 0.01) -> str:
    """Return why the firmware cannot invert a thrust over motor voltage, "" where it can.

    It takes Cardano's formula for one real root: the cubic has to rise over all voltages, the negative ones included,
    c1 > 0, c3 > 0 and c2^2 <= 3 c1 c3. Else a square root's argument is negative, and the motors get no command. One
    that falls at negative voltages alone, to below the least thrust that the firmware inverts, is good too: that of
    the thrust upgrade kit in 2026.08 is one. All shipped maps have a least thrust above 0.01 N.
    """
    if len(lowest_first) != 4:
        return f"motor.thrust_voltage_poly has {len(lowest_first)} numbers; the firmware takes a cubic, of 4."
    if not all(abs(c) <= _LARGEST_FLOAT for c in lowest_first):  # nan neither
        shown = ", ".join(f"{c:g}" for c in lowest_first)
        return f"motor.thrust_voltage_poly is {shown}; the firmware takes finite numbers in single precision."
    c0, c1, c2, c3 = lowest_first
    if c1 > 0 and c3 > 0 and (c2**2 <= 3 * c1 * c3 or _falls_below_zero_volts(c0, c1, c2, c3, least_n)):
        return ""
    return (
        f"motor.thrust_voltage_poly does not rise over all voltages (c1 = {c1:.4g}, c2 = {c2:.4g}, c3 = {c3:.4g}; "
        "expected c1 > 0, c3 > 0 and c2^2 <= 3 c1 c3): the firmware's inverse of it is no number, and its motors stop."
    )


def _falls_below_zero_volts(c0: float, c1: float, c2: float, c3: float, least_n: float) -> bool:
    """Return whether a cubic's upper extreme is at a negative voltage and below a thrust; c1 and c3 are above zero."""
    if c2 <= 0:
        return False
    volts = (-c2 - math.sqrt(c2**2 - 3 * c1 * c3)) / (3 * c3)
    return c0 + volts * (c1 + volts * (c2 + volts * c3)) < least_n


def _judged(value: Any) -> list[float]:
    if isinstance(value, list) and len(value) == 3 and all(isinstance(row, list) and len(row) == 3 for row in value):
        value = [row[i] for i, row in enumerate(value)]
    numbers = value if isinstance(value, list) else [value]
    return [number for number in numbers if isinstance(number, int | float)]


def _guess(number: float, expected: Range) -> str:
    """Return the unit in which a number would be nearest to the middle of what is plausible, "" where there is none."""
    middle = math.sqrt(expected.least * expected.largest)
    units = _OTHER_UNITS.get(expected.unit, {})
    near = {
        abs(math.log(number * size / middle)): unit
        for size, unit in units.items()
        if expected.least <= number * size <= expected.largest
    }
    return near[min(near)] if near else ""


def _shown(number: float) -> str:
    return f"{number:.1f}" if 1 <= abs(number) < 1000 else f"{number:.3g}"
