"""Statistics of round trips between this computer and the vehicle, as in table 3.2 of the thesis."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError
from cfid.estimate.propagation import widened
from cfid.estimate.signals import correlation_inflation

FEW_EFFECTIVE = 200.0  # from where the correlation itself is known well enough
_LONGEST = 4  # correlation is followed over this part of a record: an nth


class RoundTrips(NamedTuple):
    """Statistics of round trips in s: `std_s` of a single one (with n - 1), `mean_std_s` of their mean.

    Neighbours share a burst or a busy channel: `effective` independent round trips would have as uncertain a mean.
    """

    answers: int
    effective: float
    mean_s: float
    std_s: float
    mean_std_s: float
    least_s: float

    @property
    def are_correlated(self) -> bool:
        """Whether they are worth half as many or fewer, and too few to know the uncertainty of their mean well."""
        return self.effective < min(self.answers / 2, FEW_EFFECTIVE)

    @property
    def one_way_mean_s(self) -> float:
        """The mean one-way latency in s, if both ways take equally long."""
        return self.mean_s / 2

    @property
    def offset_bound_s(self) -> float:
        """The largest error in s of a clock offset that assumes both ways of the quickest answer equally long."""
        return self.least_s / 2


def round_trips(rtt_s: npt.NDArray[np.float64]) -> RoundTrips:
    """Return the statistics of round trips (n,) in s, in their order. Raises FitError for fewer than two."""
    count = len(rtt_s)
    if count < 2:
        raise FitError(f"{count} round trip(s) have no standard deviation: at least two are needed.")
    std_s, mean_s = float(np.std(rtt_s, ddof=1)), float(np.mean(rtt_s))
    effective = count / correlation_inflation(rtt_s - mean_s, longest=count // _LONGEST)
    mean_std_s = widened(std_s / math.sqrt(effective), max(round(effective) - 1, 1))
    return RoundTrips(count, effective, mean_s, std_s, mean_std_s, float(rtt_s.min()))
