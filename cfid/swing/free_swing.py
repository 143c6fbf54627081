"""From an encoder record to the free swing in it: rest, release, peaks, window. Fits nothing.

Section 2.4.4 of the thesis with its manual work replaced: rest is read from the end of the record instead of
its twentieth sample, the release is where the hand lets go instead of the highest sample, and the peaks on
the release's side are found, the release counting as the first (as in table 2.3).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.estimate.signals import GRID_S, HalfSwing, check_dense, half_swings, resample, smooth, vertex
from cfid.findings import Finding, note, warning
from cfid.swing.collocation import NO_THREADS, Threads
from cfid.swing.model import Setup

Array = npt.NDArray[np.float64]

SMALLEST_PEAK_RAD = math.radians(1.0)
FEWEST_PEAKS = 4

_THRESHOLD_RAD = SMALLEST_PEAK_RAD / 2
_STANDING_STILL = 0.05  # of the first fall's highest speed
_HAND_GONE = 0.8  # of the release angle: by then the fingers are open
_UPPERMOST = 0.95  # of a peak: an eighth of a period around it
_OFF_A_COSINE = 0.3  # of the amplitude: a swing of 90 degrees is off by less
_GROWTH = 1.05  # a free swing's peaks only shrink


@dataclass(frozen=True, kw_only=True)
class FreeSwing:
    """A record with the free swing found in it.

    `time_s` and `angle_rad` (n,) are the whole record, from its first sample and about rest. The free swing
    runs from sample `release` to sample `end` (inclusive); the default fit looks at it from `hand_gone` on.
    Peaks are those on the release's side, the release first; in a window set by hand, those that lie in it.
    `time_scale_std` is the relative standard uncertainty of the times' scale. A gyro's `rate_rad_per_s` (n,) is about
    the axis, with the relative standard uncertainty `rate_scale_std`; its angle is the sum of it. `threads` are those
    that the body hangs on.
    """

    time_s: Array
    angle_rad: Array
    rest_rad: float
    release: int
    hand_gone: int
    end: int
    peak_time_s: Array
    peak_angle_rad: Array
    peaks_used: int
    period_s: float
    resolution_rad: float
    time_scale_std: float = 0.0
    rate_rad_per_s: Array | None = None
    rate_scale_std: float = 0.0
    threads: Threads = NO_THREADS
    findings: tuple[Finding, ...] = ()

    @property
    def release_s(self) -> float:
        """Time of the release."""
        return float(self.time_s[self.release])

    @property
    def free(self) -> tuple[Array, Array]:
        """Time and angle from the release on, as the thesis fits it."""
        window = slice(self.release, self.end + 1)
        return self.time_s[window], self.angle_rad[window]

    @property
    def setup(self) -> Setup:
        """What the model has beside a pendulum under an encoder."""
        return Setup(self.threads, None if self.rate_rad_per_s is None else 2 * math.pi / self.period_s)

    @property
    def readings_rad(self) -> Array:
        """What is fitted from when the hand is surely gone: angles, or a gyro's rates as `Setup` has them."""
        window, per_s = slice(self.hand_gone, self.end + 1), self.setup.gyro_per_s
        if self.rate_rad_per_s is None or per_s is None:
            return self.angle_rad[window]
        return self.rate_rad_per_s[window] / per_s

    @property
    def hands_off(self) -> tuple[Array, Array]:
        """Time and angle from when the hand is surely gone."""
        window = slice(self.hand_gone, self.end + 1)
        return self.time_s[window], self.angle_rad[window]


def find_swing(
    time_s: Array,
    angle_rad: Array,
    *,
    peaks: int | None = None,
    smallest_peak_rad: float = SMALLEST_PEAK_RAD,
    from_s: float | None = None,
    to_s: float | None = None,
) -> FreeSwing:
    """Find the free swing in a record (n,) of increasing times and a continuous angle.

    `peaks` ends the window at that peak, the release being the first; otherwise the last peak of at least
    `smallest_peak_rad` does. `from_s` and `to_s` (since the first sample) bound it by hand; a body
    that still rests or is held at `from_s` swings from its release on.

    Raises DataError when the angle never moves, goes over the top, or shows fewer than four peaks, or when the samples
    are too few for their time.
    """
    time = time_s - time_s[0]
    kept = (time >= (from_s or 0.0)) & (time <= (math.inf if to_s is None else to_s))
    if np.count_nonzero(kept) < 16:
        raise DataError(
            f"only {counted(int(np.count_nonzero(kept)), 'sample lies', 'samples lie')} in the window requested; "
            f"the record lasts {time[-1]:.3g} s."
        )
    check_dense(time[kept])
    first = int(np.flatnonzero(kept)[0])
    rest = _rest(angle_rad[kept])
    angle = angle_rad - rest
    _check_motion(angle[kept])
    halves = half_swings(angle[kept], threshold_rad=_THRESHOLD_RAD)
    halves = [HalfSwing(h.first + first, h.last + first, h.extreme + first, h.side) for h in halves]
    halves = _completed(angle, halves, last=int(np.flatnonzero(kept)[-1]))
    if not halves:
        raise DataError("no swing: the angle never stays off rest by half a degree. Look at it with `cfid show`.")
    by_hand = first > 0 and _falls_freely(time, angle, halves, first)
    begin = _by_hand(time, angle, halves, first) if by_hand else _let_go(time, angle, halves)
    peak_time, peak_angle, grows = _peaks(time, angle, begin.peak, begin.later)
    used, fewer = _usable(peak_angle, peaks, max(smallest_peak_rad, SMALLEST_PEAK_RAD))
    return FreeSwing(
        time_s=time,
        angle_rad=angle,
        rest_rad=rest,
        release=begin.release,
        hand_gone=begin.hand_gone,
        end=int(np.searchsorted(time, peak_time[used - 1], side="right")) - 1,
        peak_time_s=peak_time,
        peak_angle_rad=peak_angle,
        peaks_used=used,
        period_s=float((peak_time[used - 1] - peak_time[1]) / (used - 2)),
        resolution_rad=_resolution(angle[kept]),
        findings=grows + fewer,
    )


class _Begin(NamedTuple):
    """Where a swing begins: samples of the release and of hands off, first peak, later half-swings of its side."""

    release: int
    hand_gone: int
    peak: tuple[float, float]
    later: list[HalfSwing]


def _let_go(time: Array, angle: Array, halves: list[HalfSwing]) -> _Begin:
    """Find the release in the half-swing that reaches farthest; it counts as the first peak."""
    start = max(range(len(halves)), key=lambda i: abs(angle[halves[i].extreme]))
    release = _release(time, angle, halves[start])
    below = np.flatnonzero(np.abs(angle[release:]) < _HAND_GONE * abs(angle[release]))
    hand_gone = release + int(below[0]) if len(below) else release
    peak = float(time[release]), float(angle[release])
    return _Begin(release, hand_gone, peak, _same_side(halves, start))


def _completed(angle: Array, halves: list[HalfSwing], *, last: int) -> list[HalfSwing]:
    """Return the half-swings without one that the window's last sample cuts before its peak is passed."""
    if not halves:
        return []
    final = halves[-1]
    passed = np.abs(angle[final.extreme : last + 1]) < _UPPERMOST * abs(angle[final.extreme])
    return halves if passed.any() else halves[:-1]


def _falls_freely(time: Array, angle: Array, halves: list[HalfSwing], first: int) -> bool:
    """Return whether the body swings by itself at the window's first sample, instead of hanging at rest or in a hand.

    A free one is where a cosine about the first standstill has it.
    """
    still = _release(time, angle, halves[0])
    if still <= first or len(halves) < 2:
        return True
    half_period_s = float(np.median(np.diff(time[[half.extreme for half in halves]])))
    phase = math.pi * float(time[still] - time[first]) / half_period_s
    return bool(abs(angle[first] - angle[still] * math.cos(min(phase, math.pi))) < _OFF_A_COSINE * abs(angle[still]))


def _by_hand(time: Array, angle: Array, halves: list[HalfSwing], first: int) -> _Begin:
    """Begin at the sample requested; the first peak is the first that the window does not cut."""
    start = next((i for i, half in enumerate(halves) if _rises_to(angle, half, first)), 0)
    return _Begin(first, first, _peak(time, angle, halves[start]), _same_side(halves, start))


def _rises_to(angle: Array, half: HalfSwing, first: int) -> bool:
    """Return whether the way up to a half-swing's peak lies in the window too."""
    return bool(np.any(np.abs(angle[first : half.extreme]) < _UPPERMOST * abs(angle[half.extreme])))


def _same_side(halves: list[HalfSwing], start: int) -> list[HalfSwing]:
    return [half for half in halves[start + 1 :] if half.side == halves[start].side]


def _rest(angle: Array) -> float:
    """Return where the body hangs: the median of the record's last third.

    Where it still swings at the end, the median depends on where the record was cut; the weighted mean of
    three extremes in turn does not, and takes out a steady decay.
    """
    rest = float(np.median(angle[-max(len(angle) // 3, 1) :]))
    halves = half_swings(angle - rest, threshold_rad=_THRESHOLD_RAD)
    if len(halves) < 4 or halves[-1].first < len(angle) - (halves[-1].first - halves[-3].first):
        return rest
    before, middle, after = (float(angle[half.extreme]) for half in halves[-4:-1])
    return (before + 2 * middle + after) / 4


def _check_motion(angle: Array) -> None:
    if np.ptp(angle) == 0:
        raise DataError("the angle never changes: is the encoder powered, and is this the right column?")
    if np.ptp(angle) < SMALLEST_PEAK_RAD:
        raise DataError(
            f"the angle moves by {math.degrees(np.ptp(angle)):.2g} degrees in all: no swing. "
            "Check the angle's unit and the counts per turn."
        )
    farthest = float(np.max(np.abs(angle)))
    if farthest > math.pi:
        raise DataError(
            f"a swing of {farthest:.3g} rad goes over the top: the angle's unit or the counts per turn are wrong, or "
            "the body turned."
        )


def _resolution(angle: Array) -> float:
    """Return the smallest step between neighbouring readings, as a coarse encoder shows it; 0 for a fine one."""
    steps = np.abs(np.diff(angle))
    moving = steps[steps > 1e-12]
    # A quantised angle often stands still from one sample to the next; a fine one never does.
    return float(np.min(moving)) if len(moving) < 0.98 * len(steps) and len(moving) else 0.0


def _release(time: Array, angle: Array, half: HalfSwing) -> int:
    """Return the last sample at which the body stood still before its first fall.

    A hand may lift, hold and tremble: all of it lies before the last moment of no speed.
    """
    begin, fallen = half.first, min(half.last + 1, len(time) - 1)
    grid, held = resample(time[begin : fallen + 1], angle[begin : fallen + 1], step_s=GRID_S)
    if len(grid) < 9:
        return half.extreme
    speed = np.abs(smooth(held, length=9, step_s=GRID_S).first)
    still = np.flatnonzero(speed < _STANDING_STILL * speed[-9:].max())
    at = grid[still[-1]] if len(still) else grid[0]
    return int(np.searchsorted(time, at))


def _peak(time: Array, angle: Array, half: HalfSwing) -> tuple[float, float]:
    """Return time and angle of a half-swing's peak, by a parabola through its uppermost part."""
    inside = slice(half.first, half.last + 1)
    high = np.abs(angle[inside]) > _UPPERMOST * abs(angle[half.extreme])
    at = np.flatnonzero(high) + half.first
    if len(at) < 5:
        return float(time[half.extreme]), float(angle[half.extreme])
    return vertex(time[at], angle[at])


def _peaks(
    time: Array, angle: Array, begin: tuple[float, float], later: list[HalfSwing]
) -> tuple[Array, Array, tuple[Finding, ...]]:
    """Return times and angles of the peaks from the first one on, as long as they shrink."""
    peaks = [begin]
    findings: tuple[Finding, ...] = ()
    for half in later:
        peak = _peak(time, angle, half)
        if abs(peak[1]) < SMALLEST_PEAK_RAD:
            break
        if len(peaks) > 1 and abs(peak[1]) > _GROWTH * abs(peaks[-1][1]):
            text = f"peak {len(peaks) + 1} is higher than the one before: the free swing ends there."
            findings = (warning("swing-peak-grows", text, "swing.*"),)
            break
        peaks.append(peak)
    times, angles = np.array(peaks).T
    return times, angles, findings


def _usable(peak_angle: Array, requested: int | None, smallest: float) -> tuple[int, tuple[Finding, ...]]:
    found = len(peak_angle)
    if found < FEWEST_PEAKS:
        raise DataError(
            f"{counted(found, 'usable peak')} of at least 1 degree, the highest "
            f"{math.degrees(np.abs(peak_angle).max()):.2g}: a "
            f"fit needs {FEWEST_PEAKS}. Release higher and let it swing until it stops; look at it with `cfid show`; "
            "check the angle's unit and the counts per turn."
        )
    if requested is None:
        return max(FEWEST_PEAKS, int(np.count_nonzero(np.abs(peak_angle) >= smallest))), ()
    if requested > found:
        text = f"{requested} peaks were requested; only {found} are at least 1 degree high."
        return found, (note("swing-fewer-peaks", text, "swing.peaks_used"),)
    return requested, ()
