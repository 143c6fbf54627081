"""Leave out the readings of an encoder that froze while the body swung, and report them."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.findings import Finding, joined, warning
from cfid.swing.free_swing import FreeSwing, find_swing

Array = npt.NDArray[np.float64]
Segment = tuple[int, int]

# A frozen segment has at least this many equal readings, and lasts this many times as long as a reading usually does: a
# slow encoder repeats all of its readings.
_FEWEST, _LONGER = 4, 4.0
_SHORTEST = 1 / 40  # of a period: on a busy computer, readings may have time stamps within less
_AROUND = 1 / 8  # of a period on either side, in which a cubic describes a swing
# The largest distance between a cubic and equal readings, in steps of the encoder and in standard deviations of its
# noise.
_STEPS, _SCATTERS = 3.0, 5.0


def find_moving_swing(time_s: Array, angle_rad: Array, **window: Any) -> FreeSwing:
    """Find the free swing in an encoder's record (n,) as `find_swing` does, without frozen readings.

    At a turning point, a coarse encoder repeats its readings too: a segment is frozen only if the motion on both sides
    does not lead through it. The first reading of a segment is kept. Raises DataError as `find_swing` does, also where
    too little remains.
    """
    swing = find_swing(time_s, angle_rad, **window)
    found = list[tuple[float, float, int]]()
    while segments := list(_frozen(swing)):
        found += [(float(time_s[first]), float(time_s[last] - time_s[first]), last - first) for first, last in segments]
        moving = np.ones(len(time_s), dtype=bool)
        for first, last in segments:
            moving[first + 1 : last + 1] = False
        time_s, angle_rad = time_s[moving], angle_rad[moving]
        try:
            swing = find_swing(time_s, angle_rad, **window)
        except DataError as error:
            raise DataError(joined([_finding(found).sentence, str(error)])) from None
    return replace(swing, findings=(*swing.findings, _finding(found))) if found else swing


def _frozen(swing: FreeSwing) -> Iterator[Segment]:
    """Yield the first and the last sample of each segment of the free swing with frozen readings."""
    angle = swing.angle_rad[swing.hand_gone :]
    edges = swing.hand_gone + np.flatnonzero(np.diff(angle)) + 1
    lasts_s = np.diff(swing.time_s[edges])
    shown = edges[:-1] <= swing.end
    if not shown.any():
        return
    least_s = max(_LONGER * float(np.median(lasts_s[shown])), _SHORTEST * swing.period_s)
    long = (np.diff(edges) >= _FEWEST) & (lasts_s >= least_s)
    for i in np.flatnonzero(long & shown):
        segment = int(edges[i]), int(edges[i + 1]) - 1
        if _leads_elsewhere(swing, *segment):
            yield segment


def _leads_elsewhere(swing: FreeSwing, first: int, last: int) -> bool:
    """Return whether a cubic through the readings on both sides of a segment is far from those in it."""
    time, angle = swing.time_s, swing.angle_rad
    around_s = min(time[last] - time[first], _AROUND * swing.period_s)
    begin = min(int(np.searchsorted(time, time[first] - around_s)), first - _FEWEST)
    end = max(int(np.searchsorted(time, time[last + 1] + around_s)), last + 1 + _FEWEST)
    near = np.r_[max(begin, 0) : first + 1, last + 1 : min(end, len(time))]
    if len(near) <= 2 * _FEWEST:
        return False
    place = (time - (time[first] + time[last + 1]) / 2) / swing.period_s
    beside, inside = np.vander(place[near], 4), np.vander(place[first : last + 1], 4)
    cubic = np.linalg.lstsq(beside, angle[near], rcond=1e-9)[0]  # the solution of least norm, for repeated time stamps
    left = angle[near] - beside @ cubic
    scatter = float(np.sqrt(left @ left / (len(near) - 4)))
    off = float(np.max(np.abs(inside @ cubic - angle[first])))
    return off > _STEPS * swing.resolution_rad + _SCATTERS * scatter


def _finding(found: list[tuple[float, float, int]]) -> Finding:
    at_s, longest_s, rows = min(found)[0], max(lasts_s for _, lasts_s, _ in found), sum(count for _, _, count in found)
    times = (
        f"for {longest_s:.2g} s, after {at_s:.3g} s,"
        if len(found) == 1
        else f"{len(found)} times, for up to {longest_s:.2g} s, the first time after {at_s:.3g} s,"
    )
    text = (
        f"the angle stands still {times} while the body swings: {counted(rows, 'row is', 'rows are')} left out. Either "
        "the encoder froze or something held the body: check the encoder's cable, and look at it with `cfid show`."
    )
    return warning("swing-angle-frozen", text, "swing.*")
