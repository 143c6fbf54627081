"""Check whether a vehicle of a platform can have a value.

A value outside its range is most likely in another unit: the message suggests which.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from cfid.quantities.registry import Platform, Quantity, Range, find, platform_range
from cfid.quantities.values import PRODUCTS, coefficient_units, evaluate, is_matrix, leaves
from cfid.units import RPM, USUAL_GRAVITY_MPS2

_OTHER_UNITS: Mapping[str, Mapping[float, str]] = {
    "kg": {1e-3: "grams"},
    "m": {1e-3: "millimetres", 1e-2: "centimetres"},
    "g": {1e3: "kilograms", 1e-3: "milligrams"},
    "mm": {1e3: "metres", 10: "centimetres", 1e-3: "micrometres"},
    "s": {1e-3: "milliseconds", 1e-6: "microseconds"},
    "N": {1e-3: "millinewtons", 1e-3 * USUAL_GRAVITY_MPS2: "grams of thrust"},
    "m/s": {1 / 3.6: "km/h", 0.514444: "knots"},
    "rad/s": {RPM: "rpm", 60.0: "turns a second under a head in rpm"},
    "kg m^2": {1e-9: "g mm^2", 1e-7: "g cm^2", 1e-6: "kg mm^2", 1e-3: "g m^2"},
    "N s^2/rad^2": {RPM**-2: "N/rpm^2"},
    "m/s^2": {1e-2: "cm/s^2", USUAL_GRAVITY_MPS2: "multiples of g"},
}

_INERTIA = "inertia.matrix_kg_m2"
_ROUNDING = 1e-9  # relative to a matrix's trace
# Relative to the geometric mean of the product's two moments: axes tilted by 12 degrees, or a tenth of the mass at the
# end of an arm. The thesis found up to 0.093; two exchanged swings give 0.17 or more.
_PRODUCT = 0.15


def implausible(
    key: str, value: Any, *, std: Any = None, platform: Platform = "crazyflie", measured_to: float | None = None
) -> str:
    """Return a sentence on why a quantity's value is implausible, with a guess of its unit; "" for a plausible value.

    A polynomial over the command is too large where it is so at `measured_to`, the largest command that was measured:
    what it extrapolates to condemns no measurement.

    An inertia matrix must also be that of a possible body, and its products must be small: a quadrocopter's axes are
    nearly its principal axes. For the platform `other`, only gravity and whether a body can have the inertia matrix are
    checked. Keys without a range pass, and so do values without numbers. The range of a known vehicle is narrow, so a
    value may lie beyond it by two of its standard uncertainties.
    """
    quantity = find(key)
    if quantity is None or quantity.plausible is None:
        return ""
    if platform == "other" and key != "gravity_mps2":
        return _body_fault(key, value) if key == _INERTIA else ""
    unit = judged_unit(quantity)
    narrow = platform_range(key, platform)
    if narrow is not None and not quantity.over:  # a polynomial's range stays as it is
        margin = 2 * max(leaves(std), default=0.0)
        narrow = replace(narrow, least=narrow.least - margin, largest=narrow.largest + margin)
    for expected in filter(None, (quantity.plausible, narrow)):
        found = expected
        if found.at is not None and measured_to is not None:
            too_large = max(_judged(quantity, found, value), default=0.0) > found.largest
            found = replace(found, at=min(found.at, measured_to)) if too_large else found
        at = "" if found.at is None else f" at {found.at:g} {quantity.over}"
        where = " in its slope" if found.of == "slope" else at
        for number in _judged(quantity, found, value):
            if fault := out_of_range(f"{key} is implausible{where}", number, found, unit):
                return fault
    return _body_fault(key, value) or _product_fault(key, value, std) if key == _INERTIA else ""


def out_of_range(claim: str, number: float, expected: Range, unit: str) -> str:
    """Return the claim about a number outside its range as a sentence that guesses the unit; "" for a number inside."""
    if expected.least <= number <= expected.largest:
        return ""
    guess, of = _guess(number, expected, unit), "" if unit == "1" else f" {unit}"
    return (
        f"{claim}, {_shown(number)}{of}{f': {guess}?' if guess else '.'} "
        f"Expected {expected.least:g} to {expected.largest:g}{of}."
    )


def judged_unit(quantity: Quantity) -> str:
    """Return the unit of a quantity's range."""
    if not quantity.over:
        return quantity.unit
    slope = quantity.plausible is not None and quantity.plausible.of == "slope"
    return coefficient_units(quantity.key, 2)[0] if slope else quantity.of


def centre_fault(centre_m: Sequence[float], arm_m: float) -> str:
    """Return why a vehicle cannot hover with its centre of mass (3,) at `centre_m`, "" where it can; z does not matter.

    The rotors are the corners of a square, each `arm_m` from its middle, and push upwards only.
    """
    side = arm_m / math.sqrt(2)
    if all(abs(length) < side for length in centre_m[:2]):
        return ""
    x, y = (1e3 * length for length in centre_m[:2])
    return (
        f"centre_of_mass_mm is implausible, x = {x:.1f} mm and y = {y:.1f} mm: beyond the rotors. Expected within "
        f"{1e3 * side:.1f} mm of the middle, with an arm of {1e3 * arm_m:.1f} mm."
    )


def _judged(quantity: Quantity, found: Range, value: Any) -> list[float]:
    if found.of == "diagonal" and is_matrix(value):
        value = [row[i] for i, row in enumerate(value)]
    judged = list(leaves(value))
    if found.of == "slope":
        return judged[-2:-1]
    if found.of == "size":
        return [abs(number) for number in judged]
    known = isinstance(value, list) and len(judged) == len(value)
    if found.at is not None:
        return [evaluate(quantity.key, judged, found.at)] if known else []
    return judged


def _body_fault(key: str, value: Any) -> str:
    """Return why no body has an inertia matrix (3, 3), "" where one can, or where a number is unknown.

    Its second moments must be positive definite [WKS].
    """
    import numpy as np  # slow to load, and commands that judge no matrix do without

    matrix = np.array(value if is_matrix(value) else math.nan, dtype=np.float64)
    if not np.all(np.isfinite(matrix)):
        return ""
    trace = np.trace(matrix)
    if np.max(np.abs(matrix - matrix.T)) > _ROUNDING * trace:
        return f"{key} is not that of a body: it is not symmetric."
    if np.linalg.eigvalsh(np.eye(3) * trace / 2 - matrix).min() > 0:
        return ""
    diagonal = ", ".join(f"{moment:.3g}" for moment in np.diag(matrix))
    return (
        f"{key} is not that of a body (diagonal {diagonal} kg m^2): each principal moment must be below the sum of the "
        "other two."
    )


def _product_fault(key: str, matrix: Any, std: Any) -> str:
    """Return why a product of inertia is too large for a quadrocopter, beyond two standard uncertainties; else ""."""
    if any(number is None for row in matrix for number in row):
        return ""
    for i, j in PRODUCTS:
        moments = math.sqrt(matrix[i][i] * matrix[j][j])
        margin = 2 * (std[i][j] or 0.0) if is_matrix(std) else 0.0
        if abs(matrix[i][j]) > _PRODUCT * moments + margin:
            return (
                f"{key} is implausible, {'xyz'[i]}{'xyz'[j]} = {matrix[i][j]:.3g} kg m^2, "
                f"{abs(matrix[i][j]) / moments:.2g} of the geometric mean of the moments about {'xyz'[i]} and "
                f"{'xyz'[j]}: two swings exchanged, or a load off the axes? Expected at most {_PRODUCT:g}."
            )
    return ""


def _guess(number: float, expected: Range, unit: str) -> str:
    """Return the unit that puts a number nearest to the middle of its range, "" for none."""
    if expected.least <= 0:
        return ""
    middle = math.sqrt(expected.least * expected.largest)
    near = {
        abs(math.log(number * size / middle)): other
        for size, other in _OTHER_UNITS.get(unit, {}).items()
        if expected.least <= number * size <= expected.largest
    }
    return near[min(near)] if near else ""


def _shown(number: float) -> str:
    return f"{number:.1f}" if 1 <= abs(number) < 1000 else f"{number:.3g}"
