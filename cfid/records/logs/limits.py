"""Values that no vehicle has, which one damaged row of a log may hold: which they are, and what is said of them."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.units import FULL_COMMAND

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


class Limits(NamedTuple):
    """The least and the most that a value may be, in `unit`, and up to which share of the values others are left out.

    Where more are outside, the column is in another unit, or is something else.
    """

    least: float
    most: float
    unit: str
    share: float = 0.1

    def outside(self, values: Array) -> Mask:
        """Return which values (n, ...) are numbers that cannot be."""
        return np.asarray((values < self.least) | (values > self.most))

    def few(self, count: int, known: int) -> bool:
        """Return whether some values are outside, and so few of those known that these alone are left out."""
        return 0 < count <= self.share * known

    def left_out(self, what: str, count: int, first: float) -> str:
        """Return a sentence on values that were left out."""
        unit = f" {self.unit}".rstrip()
        return (
            f"{what}: {counted(count, 'value')} that cannot be, the first {first:.4g}{unit} (limits {self.least:g} and "
            f"{self.most:g}{unit}), left out."
        )


COMMANDS = Limits(0.0, FULL_COMMAND, "")
SPEEDS = Limits(-2e4, 2e4, "rad/s")  # 190000 rpm; the smallest motors reach half of it
FORCES = Limits(-1e4, 1e4, "m/s^2")  # 1000 g
# Gyros end at 2000 deg/s. In degrees that are read as radians, 6 % of the rows of public flights are beyond.
RATES = Limits(-36.0, 36.0, "rad/s", share=0.002)

_PULSES = 2500.0  # 4 % of the full command, with which nothing flies; DShot ends at 2047, pulse widths at 2500 us
_PER_CENT = 100.0


def other_scale(largest: float) -> str | None:
    """Return what commands may be whose largest turns no motor where the full one is 65535, None for others."""
    if not 0 < largest <= _PULSES:
        return None
    if largest <= 1:
        return "shares of one"
    return "per cent" if largest <= _PER_CENT else "of 8 bits, DShot or pulse widths"
