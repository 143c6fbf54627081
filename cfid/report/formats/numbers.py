"""Format a report's numbers to the significant digits of their uncertainty, in a common power of ten."""

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

from cfid.units import COVERAGE_95

_DIGITS = 7  # of a value of unknown standard uncertainty; the thesis prints the same number
_MOST_DECIMALS = 12
_PLAIN = (1e-1, 1e4)  # sizes that need no power of ten
MILLI = -3
_THOUSANDTHS = {"kg": "g", "kg/s": "g/s", "s": "ms", "m": "mm", "N": "mN", "Nm": "mNm", "N m": "mN m"}
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class Printed(NamedTuple):
    """A value, its standard uncertainty and the ends of its 95 % interval; "" is unknown."""

    value: str
    std: str
    low: str
    high: str


def printed(value: float | None, std: float | None, power: int) -> Printed:
    """Return a value, its standard uncertainty and its interval as text, in units of a power of ten."""
    if value is None or not math.isfinite(value):
        return Printed("", "", "", "")
    scale = 10.0**-power
    if std is None or not math.isfinite(std) or std <= 0:
        return Printed(plain_number(value * scale, _DIGITS), "", "", "")
    decimals = min(max(1 - math.floor(math.log10(std * scale)), 0), _MOST_DECIMALS)
    value, std = value * scale, std * scale
    low, high = value - COVERAGE_95 * std, value + COVERAGE_95 * std
    texts = [_minus(f"{x:.{decimals}f}") for x in (value, std, low, high)]
    return Printed(*texts)


def plus_minus_in(value: float | None, std: float | None, power: int) -> str:
    """Return a value and its standard uncertainty, if known, in units of a common power of ten."""
    if value is None or not math.isfinite(value):
        return ""
    scale = 10.0**-power
    if std is None or not math.isfinite(std) or std <= 0:
        return plain_number(value * scale, 4)
    decimals = min(max(1 - math.floor(math.log10(std * scale)), 0), _MOST_DECIMALS)
    return _minus(f"{value * scale:.{decimals}f} ± {std * scale:.{decimals}f}")


def against(value: float | None, yours: float | None) -> str:
    """Return how a value compares with yours: the difference in per cent, or the ratio if far from one."""
    if value is None or not yours or not math.isfinite(value / yours):
        return ""
    ratio = value / yours
    if ratio <= 0:
        return "other sign" if ratio else ""
    if not 0.5 < ratio < 2:
        return f"{ratio:.2g} times"
    percent = f"{100 * (ratio - 1):+.1f}"
    return _minus(f"{percent} %" if float(percent) else "0.0 %")


def power_of_ten(values: Iterable[float | None]) -> int:
    """Return the multiple of three that scales the largest of some values to 1 to 1000, or 0 if none is needed."""
    largest = max((abs(x) for x in values if x is not None and math.isfinite(x)), default=0.0)
    if largest == 0 or _PLAIN[0] <= largest < _PLAIN[1]:
        return 0
    return 3 * math.floor(math.log10(largest) / 3)


def plain_number(value: float, digits: int = 5) -> str:
    """Return a number with this many digits, with a minus sign that is as wide as a plus sign."""
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    return _minus(mantissa) + (f"·10{str(int(exponent)).translate(_SUPERSCRIPTS)}" if exponent else "")


def with_power(unit: str, power: int) -> str:
    """Return a unit after its power of ten, as in `10⁻⁶ kg m²`, or the plain unit of that size: g, ms, mm, mN."""
    if power == MILLI and (plain := _THOUSANDTHS.get(unit.partition("(")[0])):
        return "".join([plain, *unit.partition("(")[1:]])
    words = [f"10{str(power).translate(_SUPERSCRIPTS)}" if power else "", unit_text(unit)]
    return " ".join(filter(None, words))


def unit_text(unit: str) -> str:
    """Return a unit with raised exponents, or "" for a pure number."""
    return "" if unit == "1" else unit.replace("^2", "²").replace("^3", "³")


def cell_text(value: Any) -> str:
    """Return the text of a table cell with a value of any type, or "" if unknown."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return _minus(str(value))
    if isinstance(value, float):
        return plain_number(value) if math.isfinite(value) else ""
    if isinstance(value, list | tuple):
        return ", ".join(cell_text(item) for item in value)
    return str(value)


def _minus(text: str) -> str:
    return text.replace("-", "−")
