"""Find values that no vehicle can have, as damaged rows of a log may hold, and report them."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.units import FULL_COMMAND

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


class Limits(NamedTuple):
    """The smallest and largest possible value, in `unit`; values outside are left out where they are at most a `share`.

    Where more values are outside, the column is in another unit, or is something else.
    """

    least: float
    most: float
    unit: str
    share: float = 0.1

    def outside(self, values: Array) -> Mask:
        """Return which values (n, ...) are numbers outside the limits."""
        return np.asarray((values < self.least) | (values > self.most))

    def few(self, count: int, known: int) -> bool:
        """Return whether some values are outside, but so few of the known ones that only these are left out."""
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
# Gyros end at 2000 deg/s. Where degrees are read as radians, 6 % of the rows of public flights are beyond the limits.
RATES = Limits(-36.0, 36.0, "rad/s", share=0.002)

_PULSES = 2500.0  # 4 % of the full command, with which nothing flies; DShot ends at 2047, pulse widths at 2500 us
_PER_CENT = 100.0


def other_scale(largest: float) -> str | None:
    """Return the likely scale of commands whose largest would turn no motor on a scale up to 65535, None for others."""
    if not 0 < largest <= _PULSES:
        return None
    if largest <= 1:
        return "shares of one"
    return "per cent" if largest <= _PER_CENT else "of 8 bits, DShot or pulse widths"
