"""Rows of coverage tables: how often the 95 % intervals of simulated campaigns contain the true value."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.stats import binomtest

Array = npt.NDArray[np.float64]


def reaches_93_percent(held: npt.ArrayLike) -> bool:
    """Return whether the exact binomial interval of the share of intervals that contain the truth reaches 93 %."""
    hits = np.asarray(held, dtype=bool)
    return bool(binomtest(int(hits.sum()), hits.size).proportion_ci().high >= 0.93)


class Row(NamedTuple):
    """Errors and standard uncertainties, one entry per campaign, which are printed relative to `scale`."""

    name: str
    error: Array
    std: Array
    scale: float = 1.0
    rejected: int = 0

    @property
    def hits(self) -> int:
        """The number of intervals that contain the true value."""
        return int(np.sum(np.abs(self.error) < 1.96 * self.std))

    @property
    def ratio(self) -> float:
        """The rms error over the standard uncertainty."""
        return float(np.sqrt(np.mean((self.error / self.std) ** 2)))

    def covers(self) -> bool:
        """Return whether the exact binomial interval of the coverage reaches into 93 to 97 % or is above it."""
        return reaches_93_percent(np.abs(self.error) < 1.96 * self.std)

    def __str__(self) -> str:
        """The printed row."""
        low, high = binomtest(self.hits, self.error.size).proportion_ci()
        return (
            f"{self.name:48s} n {self.error.size:5d}  bias {100 * self.error.mean() / self.scale:+.3f} %  "
            f"ratio {self.ratio:5.2f}  cover {100 * self.hits / self.error.size:5.1f} % ({100 * low:.1f} to "
            f"{100 * high:.1f})  rejected {self.rejected}"
        )
