"""Round trips between this computer and the vehicle in figures, as table 3.2 of the thesis has them."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError

_BINS = 12


class RoundTrips(NamedTuple):
    """How long n answers took, in seconds; the deviation is that of a single one, with n - 1."""

    answers: int
    mean_s: float
    std_s: float
    mean_std_s: float
    least_s: float
    greatest_s: float


class Histogram(NamedTuple):
    """How many round trips lie between neighbouring edges, in seconds; edges (n + 1,), counts (n,)."""

    edges_s: npt.NDArray[np.float64]
    counts: npt.NDArray[np.intp]


def round_trips(rtt_s: npt.NDArray[np.float64]) -> RoundTrips:
    """Return the figures of round trips (n,) in seconds. Raises FitError for fewer than two."""
    if len(rtt_s) < 2:
        raise FitError(f"{len(rtt_s)} round trips tell no deviation: at least two are needed.")
    std_s = float(np.std(rtt_s, ddof=1))
    least_s, greatest_s = float(rtt_s.min()), float(rtt_s.max())
    return RoundTrips(len(rtt_s), float(np.mean(rtt_s)), std_s, std_s / float(np.sqrt(len(rtt_s))), least_s, greatest_s)


def histogram(rtt_s: npt.NDArray[np.float64]) -> Histogram:
    """Return the histogram of round trips (n,) in seconds, in twelve bins."""
    counts, edges_s = np.histogram(rtt_s, bins=_BINS)
    return Histogram(edges_s, counts)
