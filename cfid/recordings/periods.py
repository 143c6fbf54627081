"""Read timed periods of a swing: those of a stopwatch, or of a light gate."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.findings import Finding
from cfid.records.parameters import Source
from cfid.records.run import Label

Array = npt.NDArray[np.float64]

PERIODS = "periods"  # the device of a run


@dataclass(frozen=True, kw_only=True)
class PeriodRecord:
    """Times (n,) that a number of periods (n,) took, with their standard uncertainties and amplitudes where stated.

    Amplitudes are those half-way through the periods; `amplitude_std_rad` is that of each.
    """

    path: Path
    source: Source
    label: Label
    periods: Array
    time_s: Array
    std_s: Array | None = None
    amplitude_rad: Array | None = None
    amplitude_std_rad: Array | None = None
    findings: tuple[Finding, ...] = ()
    run: str | None = None

    @property
    def name(self) -> str:
        """The run's name, or the file's."""
        return self.run or self.path.stem
