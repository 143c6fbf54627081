"""Statistics of round trips between this computer and the vehicle, as in table 3.2 of the thesis."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError
from cfid.estimate.linear import mean_of


class RoundTrips(NamedTuple):
    """Statistics of round trips in s: `std_s` of a single one (with n - 1), `mean_std_s` of their mean."""

    answers: int
    mean_s: float
    std_s: float
    mean_std_s: float
    least_s: float

    @property
    def one_way_mean_s(self) -> float:
        """The mean one-way latency in s, if both ways take equally long."""
        return self.mean_s / 2

    @property
    def offset_bound_s(self) -> float:
        """The largest error in s of a clock offset that assumes both ways of the quickest answer equally long."""
        return self.least_s / 2


def round_trips(rtt_s: npt.NDArray[np.float64]) -> RoundTrips:
    """Return the statistics of round trips (n,) in s. Raises FitError for fewer than two."""
    count = len(rtt_s)
    if count < 2:
        raise FitError(f"{count} round trip(s) have no standard deviation: at least two are needed.")
    std_s = float(np.std(rtt_s, ddof=1))
    return RoundTrips(count, float(np.mean(rtt_s)), std_s, float(mean_of(rtt_s).std[0]), float(rtt_s.min()))
