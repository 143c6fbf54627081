"""Describe a reduced staircase of commands: one point for each command, and the load cell's baselines."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import FitError
from cfid.findings import Finding, warning

Array = npt.NDArray[np.float64]

_NO_BASELINE_BEFORE = (
    "the record begins with the motors driven: thrust counts from the rest after them, and how far the load cell "
    "drifted until then is not known."
)
_NO_BASELINE_AFTER = "no steady baseline after the last command: how far the load cell drifted is not known."


class Level(NamedTuple):
    """The channels (k,) in a window about a time: see `signals.Mean`."""

    time_s: float
    mean: Array
    std: Array
    slope: Array
    effective_samples: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Point:
    """One command: means (k,) of its steady window less the tare, with standard uncertainties that include the tare's.

    Means are NaN if the step never settled: `reason` states why it did not, or why the point should not be used.
    `tare_shares` (r, k) is the effect of one standard uncertainty of each of the record's r baselines on the tare.
    `slope` is the remaining change per second in the window; `motors`, 1 to 4, are those that ran. The thrust started
    to follow at `onset_s`, with the time constant `lag_s`, and `delay_s` after its command: data of other instruments,
    by the clock of the commands, are earlier by that delay. Delay, command and motors are unknown without a command
    log.
    """

    command: int | None
    motors: tuple[int, ...]
    begin_s: float
    end_s: float
    mean: Array
    std_of_mean: Array
    effective_samples: Array
    slope: Array
    tare: Array
    std_of_tare: Array
    tare_shares: Array
    onset_s: float
    lag_s: float
    delay_s: float | None
    reason: str

    @property
    def settled(self) -> bool:
        """Whether the mean is valid."""
        return not self.reason


@dataclass(frozen=True, kw_only=True, eq=False)
class Staircase:
    """A reduced record: its points in order, and the load cell's baselines, with the motors off.

    `tare_after`, and the `drift` (k,) per second up to it, are None where no baseline follows the last step.
    `begins_driven` states that the first baseline, `tare_before`, comes after a step.
    """

    points: tuple[Point, ...]
    tare_before: Level
    tare_after: Level | None
    drift: Array | None
    spikes: int
    begins_driven: bool = False

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The findings about its means: steps that are left out, an unknown drift."""
        unsettled = [point for point in self.points if not point.settled]
        return (
            *([warning("no-baseline-before", _NO_BASELINE_BEFORE)] if self.begins_driven else []),
            *([] if self.tare_after or self.begins_driven else [warning("no-baseline-after", _NO_BASELINE_AFTER)]),
            *(
                warning("step-left-out", f"command {point.command}: {point.reason}; it is left out.")
                for point in unsettled
            ),
        )

    def steady(self) -> tuple[Point, ...]:
        """Return the points that settled. Raises FitError when none did."""
        steady = tuple(point for point in self.points if point.settled)
        if not steady:
            raise FitError(
                f"none of {counted(len(self.points), 'step')} settles. The first, from "
                f"{self.points[0].onset_s:.3g} s on: "
                f"{self.points[0].reason}. Hold each command longer, or give the windows by hand."
            )
        return steady
