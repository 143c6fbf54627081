"""Compares two clocks by stamps that can only be late.

No packet is early: host times over device times lie above a line, each by how much later its packet came than the
quickest one. The average line through them lies above that line by the mean lateness. Every offset here contains the
least one-way latency, which the other way's line bounds. Sources: S. B. Moon, P. Skelly, D. Towsley,
Estimation and removal of clock skew from network delay measurements, INFOCOM 1999; L. Zhang, Z. Liu, C. H. Xia, Clock
synchronization algorithms for network measurements, INFOCOM 2002, for the lower convex hull.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.estimate.linear import fit_linear, sandwich, std_of
from cfid.estimate.propagation import widened

Array = npt.NDArray[np.float64]

COUNTER_S = 2**32 / 1e6  # after which 32 bits of microseconds wrap

# A line under n points that are late by an exponential of mean 1, simulated with 4 to 1000 points, lies 1.85/n too
# high in their middle, with a standard deviation of 1.4/n; that of its slope is 2.1/n over that of their places.
_RAISED, _OFFSET_STD, _SLOPE_STD = 1.85, 1.4, 2.1
_FEW = 3.0  # over n - 2: the share by which standard uncertainties are widened, since few points give a poor mean
_FEWEST = 3
_PART, _FEWEST_PARTS, _MOST_PARTS = 8, 8, 12  # stamps of a part of a record, whose least counts; fewest and most parts
_EDGE, _FEW_NEAR = 10, 25  # the earliest nth of the stamps, with a least number, shows their density near the edge
_NO_EDGE = 1.3  # times fewer than with exponentials: rarely by chance
_ROUNDED_S = 1e-6  # of the vehicle's counter: less scatter is its rounding
_WANDERS = 1.5  # times the scatter of the least of exponentials: above, latencies are not exponential


@dataclass(frozen=True, kw_only=True, eq=False)
class ClockLine:
    """The line host = middle_host + rate (device - middle_device) in s, under all n points.

    `lateness_s` (n,) is how far each point lies above it, and `mean_offset_s` how far above it the average line lies in
    the middle. `offset_std_s` is the standard uncertainty in the middle, independent of `rate_std`.
    """

    rate: float
    rate_std: float
    middle_device_s: float
    middle_host_s: float
    offset_std_s: float
    lateness_s: Array
    mean_offset_s: float

    def host_s(self, device_s: npt.ArrayLike) -> Array:
        """Return the host's times in s, plus the least latency, when the device's clock shows times of any shape."""
        return np.asarray(self.middle_host_s + self.rate * (np.asarray(device_s) - self.middle_device_s))

    def device_s(self, host_s: npt.ArrayLike) -> Array:
        """Return the device's times in s at the host's times of any shape."""
        return np.asarray(self.middle_device_s + (np.asarray(host_s) - self.middle_host_s) / self.rate)

    @property
    def offset_s(self) -> float:
        """The host's time in s when the device's clock was zero."""
        return float(self.host_s(0.0))

    @property
    def skew(self) -> float:
        """The relative excess of the device's rate: -1/85 for a clock that runs at 84/85."""
        return 1 / self.rate - 1


def clock_line(device_s: Array, host_s: Array) -> ClockLine:
    """Return the line under stamps (n,): the edge of their lower hull that passes under their middle.

    Of all lines below the points, it has the least sum of distances, and it is best for latencies whose excess over the
    least is nearly exponential. Where the least latencies of parts of the record differ by more than such latencies
    would, as when the channel gets busy, the slope is that of these least latencies, and their scatter gives the
    uncertainties. The same applies to latencies without a sharp edge, of which few are near the least.

    Raises DataError for fewer than three points, or device times that do not change.
    """
    if len(device_s) < _FEWEST or np.ptp(device_s) <= 0:
        raise DataError(
            f"{counted(len(device_s), 'stamp is', 'stamps are')} too few to compare two clocks: at least "
            f"{_FEWEST} are needed."
        )
    middle, first = float(device_s.mean()), float(host_s[0])
    place, height = device_s - middle, host_s - first - (device_s - device_s[0])
    slope, level = _edge_below(place, height)
    above = height - level - slope * place
    count = len(place)
    scale = float(above.sum()) / (count - 2)
    raised, single = _RAISED * scale / count, (1 + _FEW / (count - 2)) * scale / count
    thinner = _thinner_at_the_edge(above, scale)
    single *= thinner
    offset_std_s, rate_std = _OFFSET_STD * single, _SLOPE_STD * single / float(place.std())
    wandering = _line_of_least(place, above, usual_s=0.0 if thinner > _NO_EDGE else scale)
    if wandering is not None:
        turn, offset_std_s, rate_std = wandering
        slope, level = slope + turn, level + float((above - turn * place).min())
        above = height - level - slope * place
    return ClockLine(
        rate=1 + slope,
        rate_std=rate_std,
        middle_device_s=middle,
        middle_host_s=first + middle - float(device_s[0]) + level - raised,
        offset_std_s=offset_std_s,
        lateness_s=above + raised,
        mean_offset_s=float(height.mean()) - level + raised,
    )


def _thinner_at_the_edge(above: Array, scale_s: float) -> float:
    """Return how many times fewer latencies (n,) are near the least than with exponentials of mean `scale_s`."""
    near = min(max(len(above) // _EDGE, _FEW_NEAR), len(above) // 2)
    usual_s = -scale_s * math.log1p(-near / len(above))
    return max(float(np.partition(above, near)[near]) / usual_s, 1.0) if usual_s > 0 else 1.0


def _line_of_least(place: Array, above: Array, *, usual_s: float) -> tuple[float, float, float] | None:
    """Return the slope of the least latencies of parts of a record, and standard uncertainties of offset and slope.

    `above` (n,) at places (n,) are latencies over a first line. Returns None where their least ones scatter no more
    than those of exponentials of mean `usual_s`, or where there are too few to know.
    """
    parts = min(len(place) // _PART, _MOST_PARTS)
    if parts < _FEWEST_PARTS:
        return None
    order = np.argsort(place, kind="stable")
    least, middle = (
        np.array([measure(own[rows]) for rows in np.array_split(order, parts)])
        for measure, own in ((np.min, above), (np.mean, place))
    )
    rows = np.stack([np.ones(parts), middle], axis=1)
    line = fit_linear(rows, least, noise_known=False)
    scatter = math.sqrt(float(line.residual @ line.residual) / line.degrees_of_freedom)
    if scatter <= max(_WANDERS * usual_s * parts / len(place), _ROUNDED_S):
        return None
    # Few parts show their correlation poorly: it never makes the uncertainty smaller.
    std = np.maximum(line.std, std_of(sandwich(rows, line.residual, longest=parts // 4)))
    offset_std_s, slope_std = (widened(float(one), line.degrees_of_freedom) for one in std)
    return float(line.values[1]), offset_std_s, slope_std


def unwrapped_s(counter_s: Array, host_s: Array) -> Array:
    """Return seconds (n,) that run on where a 32-bit counter of microseconds wraps, every 71 minutes.

    The host's times (n,) give the number of wraps, as long as both clocks agree to 2 % over a day.
    """
    passed = host_s - host_s[0] - (counter_s - counter_s[0])
    return np.asarray(counter_s + COUNTER_S * np.round(passed / COUNTER_S))


def sessions(first_device_s: Sequence[float], first_host_s: Sequence[float]) -> list[int]:
    """Return a number for each run, in order of time: runs with the same number share one clock.

    A device that was restarted counts from zero: the time passed on its clock, modulo 71 minutes, then differs from
    the time passed on the host's.
    """
    numbers = [0]
    for place in range(1, len(first_host_s)):
        passed = first_host_s[place] - first_host_s[place - 1]
        device = first_device_s[place] - first_device_s[place - 1]
        apart = (device - passed + COUNTER_S / 2) % COUNTER_S - COUNTER_S / 2
        numbers.append(numbers[-1] + (abs(apart) > 1.0 + 0.03 * passed))
    return numbers


def _edge_below(place: Array, height: Array) -> tuple[float, float]:
    """Return slope and height at 0 of the lower hull's edge at place 0, which lies within the places (n,)."""
    hull: list[tuple[float, float]] = []
    order = np.lexsort((height, place))
    for x, y in zip(place[order].tolist(), height[order].tolist(), strict=True):
        while len(hull) > 1 and _is_above(hull[-1], hull[-2], (x, y)):
            hull.pop()
        hull.append((x, y))
    right = next(i for i, (x, _) in enumerate(hull) if x >= 0)
    (x0, y0), (x1, y1) = hull[max(right, 1) - 1], hull[max(right, 1)]
    slope = (y1 - y0) / (x1 - x0)
    return slope, y0 - slope * x0


def _is_above(point: tuple[float, float], before: tuple[float, float], after: tuple[float, float]) -> bool:
    along = (after[0] - before[0]) * (point[1] - before[1])
    return along >= (after[1] - before[1]) * (point[0] - before[0])
