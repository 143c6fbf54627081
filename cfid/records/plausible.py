"""Which values a Crazyflie-sized vehicle can have.

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
    "m/s^2": {1e-2: "cm/s^2", 9.81: "multiples of g"},
}

_INERTIA = "inertia.matrix_kg_m2"
_ROUNDING = 1e-9  # of a matrix' trace


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
    _INERTIA: Range(5e-7, 2e-2, "kg m^2"),  # of its diagonal
    "motor.max_thrust_n": Range(0.01, 10.0, "N"),
    "motor.thrust_per_speed_squared_n_s2": Range(1e-9, 1e-5, "N s^2/rad^2"),
    "tf.time_constant_s": Range(1e-3, 1.0, "s"),
    "gravity_mps2": Range(9.7, 9.9, "m/s^2"),  # on earth: 9.76 on Huascaran, 9.83 at the poles
}


def implausible(key: str, value: Any) -> str:
    """Return what is implausible about a quantity's value as a sentence, with a guess of its unit; "" where nothing.

    Of a matrix the diagonal is judged, and an inertia matrix has to be that of a possible body. Keys without a range
    pass, and so does what is no number.
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
    return _body_fault(key, value) if key == _INERTIA else ""


def centre_fault(centre_m: Sequence[float], arm_m: float) -> str:
    """Return why a vehicle with its centre of mass (3,) there cannot hover, "" where it can; x and y count.

    The rotors stand in a square, a diagonal arm from the middle, and push upwards only.
    """
    side = arm_m / math.sqrt(2)
    if all(abs(length) < side for length in centre_m[:2]):
        return ""
    x, y = (1e3 * length for length in centre_m[:2])
    return (
        f"centre_of_mass_mm is implausible, x = {x:.1f} mm and y = {y:.1f} mm: beyond the rotors. Expected within "
        f"{1e3 * side:.1f} mm of the middle, with an arm of {1e3 * arm_m:.1f} mm."
    )


def _judged(value: Any) -> list[float]:
    if isinstance(value, list) and len(value) == 3 and all(isinstance(row, list) and len(row) == 3 for row in value):
        value = [row[i] for i, row in enumerate(value)]
    numbers = value if isinstance(value, list) else [value]
    return [number for number in numbers if isinstance(number, int | float)]


def _body_fault(key: str, matrix: Sequence[Sequence[float]]) -> str:
    """Return why an inertia matrix (3, 3) is that of no body: its second moments have to be positive definite [WKS]."""
    trace = sum(matrix[i][i] for i in range(3))
    if any(abs(matrix[i][j] - matrix[j][i]) > _ROUNDING * trace for i, j in ((0, 1), (0, 2), (1, 2))):
        return f"{key} is that of no body: it is not symmetric."
    (a, b, c), (_, d, e), (_, _, f) = ([(i == j) - 2 * matrix[i][j] / trace for j in range(3)] for i in range(3))
    if min(a, a * d - b * b, a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)) > 0:
        return ""
    diagonal = ", ".join(f"{matrix[i][i]:.3g}" for i in range(3))
    return (
        f"{key} is that of no body (diagonal {diagonal} kg m^2): each principal moment has to be below the sum of the "
        "other two."
    )


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
