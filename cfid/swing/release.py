"""Find where a swing starts: at the half-swing in which a hand let go, or at a given time, and the peaks that follow.

Fits nothing.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.estimate.signals import GRID_S, HalfSwing, resample, smooth, vertex
from cfid.findings import Finding, warning

Array = npt.NDArray[np.float64]

SMALLEST_PEAK_RAD = math.radians(1.0)
FEWEST_PEAKS = 4
GROWTH = 1.05  # a free swing's peaks only decrease

_STANDING_STILL = 0.05  # of the highest speed in the first fall
_HAND_GONE = 0.8  # of the release angle: at this angle, the fingers are open
_UPPERMOST = 0.95  # of a peak: above it lies an eighth of a period
_OFF_A_COSINE = 0.3  # of the amplitude: the largest distance from a cosine; a swing of 90 degrees has less


class Begin(NamedTuple):
    """The start of a swing: samples of the release and of hands off, first peak, later half-swings of its side."""

    release: int
    hand_gone: int
    peak: tuple[float, float]
    later: list[HalfSwing]


def let_go(time: Array, angle: Array, halves: list[HalfSwing]) -> Begin:
    """Find the release: the first peak, in the half-swing that reaches farthest among those that enough peaks follow.

    Where the body was moved again shortly before the end, the earlier swing is used.
    """
    followed = [i for i in range(len(halves)) if _peaks_from(angle, halves, i) >= FEWEST_PEAKS]
    start = max(followed or range(len(halves)), key=lambda i: abs(angle[halves[i].extreme]))
    release = _release(time, angle, halves[start])
    below = np.flatnonzero(np.abs(angle[release:]) < _HAND_GONE * abs(angle[release]))
    hand_gone = release + int(below[0]) if len(below) else release
    peak = float(time[release]), float(angle[release])
    return Begin(release, hand_gone, peak, _same_side(halves, start))


def _peaks_from(angle: Array, halves: list[HalfSwing], start: int) -> int:
    """Return the number of decreasing peaks on one side from a half-swing on, including its own."""
    sizes = [abs(float(angle[half.extreme])) for half in (halves[start], *_same_side(halves, start))]
    ends = (i for i, (one, other) in enumerate(pairwise(sizes), 1) if other > GROWTH * one)
    peaks = sizes[: next(ends, len(sizes))]
    return sum(size >= SMALLEST_PEAK_RAD for size in peaks)


def moved_again(time: Array, angle: Array, halves: list[HalfSwing], begin: Begin) -> tuple[Finding, ...]:
    """Warn of a half-swing that reaches farther than the release in use, but comes too late to be fitted."""
    farthest = max(halves, key=lambda half: abs(angle[half.extreme]))
    if farthest.first <= begin.release or abs(angle[farthest.extreme]) <= GROWTH * abs(begin.peak[1]):
        return ()
    text = (
        f"the body was moved again at {time[farthest.first]:.1f} s, too late to be fitted: the swing that was released "
        f"at {time[begin.release]:.1f} s is taken."
    )
    return (warning("swing-moved-again", text, "swing.*"),)


def completed(angle: Array, halves: list[HalfSwing], *, last: int) -> list[HalfSwing]:
    """Return the half-swings, without a last one that the window cuts before its peak has passed."""
    if not halves:
        return []
    final = halves[-1]
    passed = np.abs(angle[final.extreme : last + 1]) < _UPPERMOST * abs(angle[final.extreme])
    return halves if passed.any() else halves[:-1]


def falls_freely(time: Array, angle: Array, halves: list[HalfSwing], first: int) -> bool:
    """Return whether the body swings freely at the window's first sample, instead of being at rest or in a hand.

    It swings freely where it follows a cosine about the first standstill.
    """
    still = _release(time, angle, halves[0])
    if still <= first or len(halves) < 2:
        return True
    half_period_s = float(np.median(np.diff(time[[half.extreme for half in halves]])))
    phase = math.pi * float(time[still] - time[first]) / half_period_s
    return bool(abs(angle[first] - angle[still] * math.cos(min(phase, math.pi))) < _OFF_A_COSINE * abs(angle[still]))


def by_hand(time: Array, angle: Array, halves: list[HalfSwing], first: int) -> Begin:
    """Start at the requested sample; the first peak is the first that the window does not cut."""
    start = next((i for i, half in enumerate(halves) if _rises_to(angle, half, first)), 0)
    return Begin(first, first, peak_of(time, angle, halves[start]), _same_side(halves, start))


def _rises_to(angle: Array, half: HalfSwing, first: int) -> bool:
    """Return whether the window contains the rise to a half-swing's peak."""
    return bool(np.any(np.abs(angle[first : half.extreme]) < _UPPERMOST * abs(angle[half.extreme])))


def _same_side(halves: list[HalfSwing], start: int) -> list[HalfSwing]:
    return [half for half in halves[start + 1 :] if half.side == halves[start].side]


def _release(time: Array, angle: Array, half: HalfSwing) -> int:
    """Return the last sample at which the body stood still before its first fall.

    A hand may lift, hold and tremble: all of that lies before the last moment without speed.
    """
    begin, fallen = half.first, min(half.last + 1, len(time) - 1)
    grid, held = resample(time[begin : fallen + 1], angle[begin : fallen + 1], step_s=GRID_S)
    if len(grid) < 9:
        return half.extreme
    speed = np.abs(smooth(held, length=9, step_s=GRID_S).first)
    still = np.flatnonzero(speed < _STANDING_STILL * speed[-9:].max())
    at = grid[still[-1]] if len(still) else grid[0]
    return int(np.searchsorted(time, at))


def peak_of(time: Array, angle: Array, half: HalfSwing) -> tuple[float, float]:
    """Return time and angle of a half-swing's peak, from a parabola through its uppermost part."""
    inside = slice(half.first, half.last + 1)
    high = np.abs(angle[inside]) > _UPPERMOST * abs(angle[half.extreme])
    at = np.flatnonzero(high) + half.first
    if len(at) < 5:
        return float(time[half.extreme]), float(angle[half.extreme])
    return vertex(time[at], angle[at])
