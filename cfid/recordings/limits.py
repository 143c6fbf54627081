"""Find what no vehicle's log can show: values beyond any vehicle's, hung sensors, and times that repeat."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.findings import Finding, finding
from cfid.recordings.outliers import stuck
from cfid.units import FULL_COMMAND

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Timed = tuple[Array, Array]

_MOST_HUNG = 0.5  # of a sensor's rows; where more repeat, it is logged that way
_MOST_REPEATED = 0.1  # of rows that may repeat the time of the one before
_PULSES = 2500.0  # 4 % of the full command, with which nothing flies; DShot ends at 2047, pulse widths at 2500 us
_PER_CENT = 100.0


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

    def left_out(self, name: str, count: int, first: float) -> Finding:
        """Return the finding on values that were left out."""
        unit = f" {self.unit}".rstrip()
        return finding(
            "log-values-left-out", name=name, count=count, first=first, unit=unit, least=self.least, most=self.most
        )


COMMANDS = Limits(0.0, FULL_COMMAND, "")
SPEEDS = Limits(-2e4, 2e4, "rad/s")  # 190000 rpm; the smallest motors reach half of it
FORCES = Limits(-1e4, 1e4, "m/s^2")  # 1000 g
# Gyros end at 2000 deg/s. Where degrees are read as radians, 6 % of the rows of public flights are beyond the limits.
RATES = Limits(-36.0, 36.0, "rad/s", share=0.002)


def other_scale(largest: float) -> str | None:
    """Return the likely scale of commands whose largest would turn no motor on a scale up to 65535, None for others."""
    if not 0 < largest <= _PULSES:
        return None
    if largest <= 1:
        return "shares of one"
    return "per cent" if largest <= _PER_CENT else "of 8 bits, DShot or pulse widths"


def refuse_repeated_times(path: Path, time_s: Array) -> None:
    """Raise DataError where many times (n,) repeat the one before: they are rounded, or of two recordings."""
    repeated = int(np.count_nonzero(np.diff(time_s) == 0))
    if repeated > _MOST_REPEATED * len(time_s):
        rate_hz = (len(time_s) - 1) / float(time_s[-1] - time_s[0]) if time_s[-1] > time_s[0] else 0.0
        raise DataError(
            f"{path}: {repeated} of {len(time_s)} rows of commands repeat the time of the one before. Where times are "
            f"rounded, write more of their digits, or import a table with `rate_hz` ({rate_hz:.4g} on average); where "
            "several recordings take turns, write the rows of each into a file of its own.",
            code="time-repeats",
        )


def without_hung(sensors: Mapping[str, Timed]) -> tuple[tuple[Timed, ...], tuple[Finding, ...]]:
    """Return times (n,) and values (n, 3) of two sensors without the rows in which an axis hung, and findings on them.

    Where all axes of both repeat one value, the vehicle stands still in a simulator, and the rows stay.
    """
    axes = [_stuck(*timed) for timed in sensors.values()]
    still = [(time_s, one.all(axis=1).astype(float)) for (time_s, _), one in zip(sensors.values(), axes, strict=True)]
    kept, findings = list[Timed](), list[Finding]()
    for (name, (time_s, values)), one, other in zip(sensors.items(), axes, still[::-1], strict=True):
        wrong = one.any(axis=1) & ~(one.all(axis=1) & (np.interp(time_s, *other) > 0))
        if np.mean(wrong) > _MOST_HUNG:
            wrong[:] = False
        if wrong.any():
            at_s = float(time_s[np.argmax(wrong)] - time_s[0])
            count = int(np.count_nonzero(wrong))
            findings.append(finding("log-sensor-hung", name=name, count=count, rows=len(wrong), at_s=at_s))
        kept.append((time_s[~wrong], values[~wrong]))
    return tuple(kept), tuple(findings)


def _stuck(time_s: Array, values: Array) -> Mask:
    """Return where each axis of values (n, 3) at times (n,) repeats one value for long.

    Repeats at the end of an axis's range do not count: they were measured.
    """
    inside = np.abs(values) < np.abs(values).max(axis=0)
    return np.asarray(inside & np.column_stack([stuck(axis, time_s) for axis in values.T]))
