"""Units of forces and torques, as stands and load cells state them: their spellings, and factors to N and N m."""

import re
from collections.abc import Mapping

from cfid.records.tables.column_units import spelt

GRAM_FORCE_N = 9.80665e-3  # by definition
_POUND_FORCE_N, _INCH_M = 4.4482216152605, 0.0254
_METRIC_N = {"n": 1.0, "mn": 1e-3, "cn": 1e-2, "gf?": GRAM_FORCE_N, "kgf?": 1e3 * GRAM_FORCE_N}
_ARM_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_TIMES = "[.u-]*"  # between force and arm; bytes of a middle dot may have become a micro sign

# Patterns of units as `spelt` returns them.
FORCES_N: Mapping[str, float] = {
    "n(?:ewtons?)?": 1.0,
    "mn": 1e-3,
    "cn": 1e-2,
    "g(?:f|rams?)?": GRAM_FORCE_N,
    "kgf?": 1e3 * GRAM_FORCE_N,
    "lbf": _POUND_FORCE_N,
    "ozf": _POUND_FORCE_N / 16,
}
TORQUES_NM: Mapping[str, float] = {
    **{rf"{force}{_TIMES}{arm}": _METRIC_N[force] * _ARM_M[arm] for force in _METRIC_N for arm in _ARM_M},
    rf"lbf?{_TIMES}in": _POUND_FORCE_N * _INCH_M,
    rf"lbf?{_TIMES}ft": _POUND_FORCE_N * 12 * _INCH_M,
    rf"ozf?{_TIMES}in": _POUND_FORCE_N * _INCH_M / 16,
}
FORCE_UNITS = "N, mN, cN, gf, kgf, lbf or ozf"
TORQUE_UNITS = "N, mN, cN, gf or kgf times m, cm or mm, lbf in, lbf ft or ozf in"


def si_factor(unit: str, units: Mapping[str, float]) -> float | None:
    """Return the factor to N or N m of a unit as a header writes it, None for one that is not read."""
    return next((factor for called, factor in units.items() if re.fullmatch(called, spelt(unit))), None)


def pattern_of(units: Mapping[str, float]) -> str:
    """Return the pattern of units as headers write them, with spaces and signs between force and arm."""
    return "|".join(units).replace(_TIMES, r"[\s.uµμ·⋅∙•*âÂ�-]*")
