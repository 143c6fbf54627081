"""Statistics of round trips between this computer and the vehicle, as in table 3.2 of the thesis."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc

from cfid.errors import FitError
from cfid.estimate.propagation import widened
from cfid.estimate.signals import block_means, correlation_inflation

FEW_EFFECTIVE = 200.0  # from there on, the correlation itself is known well enough
_PARTS = 10  # of a record, whose means show what wanders too slowly for neighbours to show it
_BY_CHANCE = 0.001  # below it, the means scatter by more than those of independent round trips
_LONGEST = 4  # correlation is followed over one nth of a record


class RoundTrips(NamedTuple):
    """Statistics of round trips in s; `std_s` is that of a single one (with n - 1), `mean_std_s` that of their mean.

    Neighbours share a burst or a busy channel: their mean is as uncertain as that of `effective` independent round
    trips.
    """

    answers: int
    effective: float
    mean_s: float
    std_s: float
    mean_std_s: float
    least_s: float
    wander: bool = False

    @property
    def are_correlated(self) -> bool:
        """Whether they are worth half as many or fewer, and too few to know well how uncertain their mean is.

        Round trips that `wander` are correlated, too: the means of parts of the record differ.
        """
        return self.wander or self.effective < min(self.answers / 2, FEW_EFFECTIVE)

    @property
    def one_way_mean_s(self) -> float:
        """The mean one-way latency in s, if both ways take equally long."""
        return self.mean_s / 2

    @property
    def offset_bound_s(self) -> float:
        """The largest error in s of a clock offset that takes both ways of the quickest answer as equally long."""
        return self.least_s / 2


def round_trips(rtt_s: npt.NDArray[np.float64]) -> RoundTrips:
    """Return the statistics of round trips (n,) in s, in their order. Raises FitError for fewer than two."""
    count = len(rtt_s)
    if count < 2:
        raise FitError(f"{count} round trip(s) have no standard deviation: at least two are needed.")
    std_s, mean_s = float(np.std(rtt_s, ddof=1)), float(np.mean(rtt_s))
    effective = count / correlation_inflation(rtt_s - mean_s, longest=count // _LONGEST)
    freedom = max(round(effective) - 1, 1)
    of_parts = _effective_of_parts(rtt_s)
    if of_parts < effective:
        effective, freedom = of_parts, min(freedom, _PARTS - 1)
    mean_std_s = widened(std_s / math.sqrt(effective), freedom)
    return RoundTrips(count, effective, mean_s, std_s, mean_std_s, float(rtt_s.min()), math.isfinite(of_parts))


def _effective_of_parts(rtt_s: npt.NDArray[np.float64]) -> float:
    """Return how many independent round trips the means of parts show, infinite where these means scatter by chance.

    A latency that wanders slowly is a small part of each round trip, and hardly correlates neighbours.
    """
    length, variance = len(rtt_s) // _PARTS, float(np.var(rtt_s, ddof=1))
    if length < _PARTS or not variance:
        return math.inf
    scatter = float(np.var(block_means(rtt_s, length=length), ddof=1)) / variance
    return _PARTS / scatter if chdtrc(_PARTS - 1, (_PARTS - 1) * length * scatter) < _BY_CHANCE else math.inf
