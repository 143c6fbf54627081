"""Round a value and its standard uncertainty for print: both to the second digit of the uncertainty."""

import math
from typing import Any

_DIGITS = 7  # of a value of unknown uncertainty; the thesis prints the same number
_SMALLEST, _LARGEST = 1e-4, 1e6  # numbers without an exponent; larger ones have none while all digits are known


def value_and_std(value: Any, std: Any) -> tuple[str, str]:
    """Return a value and its standard uncertainty as text; "-" is an unknown uncertainty, or an unknown value."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return ("-" if value is None else str(value)), "-"
    known = isinstance(std, int | float) and math.isfinite(std) and std > 0
    if not known or not math.isfinite(value):
        return f"{value + 0.0:.{_DIGITS}g}", "-"  # a sum with zero has no negative zero
    last_place = _place(float(f"{std:.1e}")) - 1  # the second digit after rounding: of 0.0996, that of 0.10
    return _rounded(value, last_place, max(abs(value), std)), _rounded(std, last_place, std)


def with_std(value: Any, std: Any) -> str:
    """Return a value and its standard uncertainty as one text, such as 16.42 ± 0.05; an unknown one is left out."""
    shown, spread = value_and_std(value, std)
    return shown if spread == "-" else f"{shown} ± {spread}"


def _place(number: float) -> int:
    """Return the power of ten of a number's first digit."""
    return math.floor(math.log10(abs(number)))


def _rounded(number: float, last_place: int, size: float) -> str:
    if size >= _SMALLEST and (size < _LARGEST or last_place < 0):
        return f"{round(number, -last_place) + 0.0:.{max(-last_place, 0)}f}"
    digits = max(_place(number) - last_place, 1) if number else 1
    return f"{number:.{digits}e}"
