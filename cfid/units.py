"""Units and constants that all rooms share, each defined once: spelt units with their factors, and the vehicle's facts.

The simulated plants have their own constants on purpose: a plant that shared a constant with a fit could not reveal a
wrong one. Constants that a wire format fixes, such as the largest command, belong to `wire`.
"""

import math
import re

from cfid.wire.app import LARGEST_COMMAND

RPM = 2 * math.pi / 60  # rad/s of one revolution per minute
MM = 1e-3  # m
CRYSTAL_STD = 5e-5  # relative, of a clock with a crystal, over temperature and age
USUAL_GRAVITY_MPS2 = 9.81  # as in section 3.3.1 of the thesis; used where no rig.toml states the local value
COVERAGE_95 = 1.96  # standard deviations on either side that cover 95 % of a normal distribution

FULL_COMMAND = LARGEST_COMMAND
NEAR_FULL = 0.95  # of the full command: if no measured command reached this, values at full command are extrapolated
DEAD_COMMAND = 1000  # up to this command a motor stands still (thesis, section 3.3.2)

MOTORS = (1, 2, 3, 4)
ROTORS = len(MOTORS)
# Seen from above, counterclockwise from forward: front right, back right, back left, front left.
MOTOR_AZIMUTH_DEG = {1: -45.0, 2: -135.0, 3: 135.0, 4: 45.0}
ROTOR_TURNS = {1: 1, 2: -1, 3: 1, 4: -1}  # 1 is counterclockwise, seen from above

_GRAM_FORCE_N, _POUND_FORCE_N, _INCH_M = 9.80665e-3, 4.4482216152605, 0.0254  # by definition

# The factors of units to each SI unit, by the spelling that `spelt` returns.
UNITS: dict[str, dict[str, float]] = {
    "s": {
        **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
        **dict.fromkeys(("ms", "msec", "msecs", "milliseconds"), 1e-3),
        **dict.fromkeys(("us", "usec", "usecs", "microseconds"), 1e-6),
        **dict.fromkeys(("ns", "nsec", "nanoseconds"), 1e-9),
        "min": 60.0,
    },
    "rad": {
        **dict.fromkeys(("rad", "radian", "radians"), 1.0),
        **dict.fromkeys(("deg", "degree", "degrees", "\u00b0"), math.pi / 180),
        "mrad": 1e-3,
    },
    "rad/s": {
        **dict.fromkeys(("rad/s", "rad.s^-1", "rad_per_s", "rad_s"), 1.0),
        **dict.fromkeys(("deg/s", "\u00b0/s", "deg_per_s", "deg_s"), math.pi / 180),
        **dict.fromkeys(("rpm", "1/min", "r/min", "min^-1"), RPM),
        **{f"erpm/{pairs}": RPM / pairs for pairs in range(1, 25)},  # electrical ones, over a motor's pairs of poles
        **dict.fromkeys(("hz", "rps", "1/s"), 60 * RPM),
        "krpm": 1e3 * RPM,
        "mrad/s": 1e-3,
    },
    "N": {
        **dict.fromkeys(("n", "newton", "newtons"), 1.0),
        "mn": 1e-3,
        **dict.fromkeys(("g", "gf", "gram", "grams"), _GRAM_FORCE_N),
        **dict.fromkeys(("kg", "kgf"), 1e3 * _GRAM_FORCE_N),
        "mg": 1e-3 * _GRAM_FORCE_N,
        **dict.fromkeys(("lbf", "lb", "lbs"), _POUND_FORCE_N),
        **dict.fromkeys(("ozf", "oz"), _POUND_FORCE_N / 16),
    },
    "N m": {
        "nm": 1.0,
        "mnm": 1e-3,
        "ncm": 1e-2,
        "nmm": 1e-3,
        "gfcm": 1e-2 * _GRAM_FORCE_N,
        "kgfm": 1e3 * _GRAM_FORCE_N,
        "kgfcm": 10 * _GRAM_FORCE_N,
        **dict.fromkeys(("lbfin", "lbin"), _POUND_FORCE_N * _INCH_M),
        **dict.fromkeys(("lbfft", "lbft"), _POUND_FORCE_N * 12 * _INCH_M),
        **dict.fromkeys(("ozfin", "ozin"), _POUND_FORCE_N / 16 * _INCH_M),
    },
    "V": {"v": 1.0, "volt": 1.0, "volts": 1.0, "mv": 1e-3},
    "A": {"a": 1.0, "ma": 1e-3},
    "W": {"w": 1.0, "mw": 1e-3},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3, "m_per_s": 1.0, "m_s": 1.0, "mps": 1.0},
    "m/s^2": {
        "m/s^2": 1.0,
        "m/s2": 1.0,
        "mm/s^2": 1e-3,
        "m_per_s2": 1.0,
        "m_s2": 1.0,
        "g0": 9.80665,
        "g": USUAL_GRAVITY_MPS2,
    },
    "Pa": {"pa": 1.0, "mbar": 100.0, "hpa": 100.0},
    "T": {"tesla": 1.0, "ut": 1e-6, "gauss": 1e-4},
    "1": {"1": 1.0, "%": 0.01, "percent": 0.01, "fraction": 1.0, "pwm": 1.0, "counts": 1.0, "count": 1.0},
}
_MICRO = re.compile("[\u00b5\u03bc]")
_BETWEEN_UNITS = re.compile(r"[\s\u00b7\u22c5\u2219\u2022*]|(?<=[nfb])[-.](?=c?m+$|in$|ft$)")
_BRACKETS = re.compile(r"(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]()]*)[\])]\s*")
_SUFFIX = re.compile(r"(?P<name>.+?)_(?P<unit>(?:rad|deg|m)_s2?|[A-Za-z]+(?:_per_s2?)?)")


def spelt(unit: str) -> str:
    """Return a unit in lower case, without spaces and dots between factors: `N\u00b7m` is `nm`, `\u00b5s` is `us`."""
    return _BETWEEN_UNITS.sub("", _MICRO.sub("u", unit.strip()).lower())


def factor(unit: str, si: str) -> float | None:
    """Return the factor from a unit, as it is spelt somewhere, to an SI unit; None for a unit of another kind."""
    return UNITS[si].get(spelt(unit))


def si_of(unit: str) -> tuple[str, float] | None:
    """Return the SI unit of a unit and the factor to it, None for an unknown one; a bare `g` is a weight."""
    return next(((si, factors[spelt(unit)]) for si, factors in UNITS.items() if spelt(unit) in factors), None)


def split_unit(head: str) -> tuple[str, str]:
    """Return a column's name and its unit, "" for none: of `Thrust (gf)`, `weight[g]`, `gyro.x [rad/s]`, `phi_deg`.

    A word in brackets counts where it is a known unit, and one after an underscore where a name is before it.
    """
    match = _BRACKETS.fullmatch(head.strip()) or _SUFFIX.fullmatch(head.strip())
    if match is None or si_of(match["unit"]) is None:
        return head.strip(), ""
    return match["name"].strip(), match["unit"].strip()


def bracketed(head: str) -> str:
    """Return what stands in brackets at the end of a head, a known unit or not, "" for nothing."""
    match = _BRACKETS.fullmatch(head.strip())
    return "" if match is None else match["unit"].strip()
