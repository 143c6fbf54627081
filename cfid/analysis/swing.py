"""From an encoder record to the free swing in it: rest, release, peaks, window. Fits nothing.

Section 2.4.4 of the thesis with its hand work replaced: rest is read from the end of the record instead of
its twentieth sample, the release is where the hand lets go instead of the highest sample, and the peaks on
the release's side are found, the release counting as the first (as in table 2.3).
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.analysis.signals import HalfSwing, half_swings, resample, smooth, vertex
from cfid.errors import DataError

Array = npt.NDArray[np.float64]

GRID_S = 0.004  # the thesis' sampling time, eq. 2.15
SMALLEST_PEAK_RAD = math.radians(1.0)
FEWEST_PEAKS = 4

_THRESHOLD_RAD = SMALLEST_PEAK_RAD / 2
_STANDING_STILL = 0.05  # of the first fall's highest speed
_HAND_GONE = 0.8  # of the release angle: by then the fingers are open
_GROWTH = 1.05  # a free swing's peaks only shrink


@dataclass(frozen=True, kw_only=True)
class FreeSwing:
    """A record with the free swing found in it.

    `time_s` and `angle_rad` (n,) are the whole record, from its first sample and about rest. The free swing
    runs from sample `release` to sample `end` (inclusive); the default fit looks at it from `hand_gone` on.
    Peaks are those on the release's side, the release first.
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
    warnings: tuple[str, ...] = ()

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
    `smallest_peak_rad` does. `from_s` and `to_s` (since the first sample) bound it by hand.

    Raises DataError when the angle never moves, goes over the top, or shows fewer than four peaks.
    """
    time = time_s - time_s[0]
    kept = (time >= (from_s or 0.0)) & (time <= (math.inf if to_s is None else to_s))
    if np.count_nonzero(kept) < 16:
        raise DataError(
            f"only {np.count_nonzero(kept)} samples lie in the window asked for; the record lasts {time[-1]:.3g} s."
        )
    first = int(np.flatnonzero(kept)[0])
    rest = _rest(angle_rad[kept])
    angle = angle_rad - rest
    _check_motion(angle[kept])
    halves = half_swings(angle[kept], threshold_rad=_THRESHOLD_RAD)
    halves = [HalfSwing(h.first + first, h.last + first, h.extreme + first, h.side) for h in halves]
    start = _largest(halves, angle) if from_s is None else 0
    same_side = [h for h in halves[start + 1 :] if h.side == halves[start].side] if halves else []
    release = first if from_s is not None else _release(time, angle, halves[start])
    peak_time, peak_angle, warnings = _peaks(time, angle, release, halves[start], same_side)
    used, warning = _usable(peak_angle, peaks, max(smallest_peak_rad, SMALLEST_PEAK_RAD))
    end = int(np.searchsorted(time, peak_time[used - 1], side="right")) - 1
    return FreeSwing(
        time_s=time,
        angle_rad=angle,
        rest_rad=rest,
        release=release,
        hand_gone=first if from_s is not None else _hand_gone(angle, release),
        end=end,
        peak_time_s=peak_time,
        peak_angle_rad=peak_angle,
        peaks_used=used,
        period_s=float((peak_time[used - 1] - peak_time[1]) / (used - 2)),
        resolution_rad=_resolution(angle[kept]),
        warnings=warnings + warning,
    )


def _rest(angle: Array) -> float:
    """Return the median of the record's last third: rest, or the middle of a swing that still goes on."""
    return float(np.median(angle[-max(len(angle) // 3, 1) :]))


def _check_motion(angle: Array) -> None:
    if np.ptp(angle) == 0:
        raise DataError("the angle never changes: is the encoder powered, and is this the right column?")
    if np.ptp(angle) < SMALLEST_PEAK_RAD:
        raise DataError(
            f"the angle moves by {math.degrees(np.ptp(angle)):.2g} degrees in all: no swing. "
            "Check the unit (--angle-unit, --counts-per-turn)."
        )
    farthest = float(np.max(np.abs(angle)))
    if farthest > math.pi:
        raise DataError(
            f"a swing of {farthest:.3g} rad goes over the top: the angle's unit is wrong "
            "(--angle-unit deg|rad|counts, --counts-per-turn), or the body turned."
        )


def _resolution(angle: Array) -> float:
    """Return the smallest step between neighbouring readings, as a coarse encoder shows it; 0 for a fine one."""
    steps = np.abs(np.diff(angle))
    moving = steps[steps > 1e-12]
    # A quantised angle often stands still from one sample to the next; a fine one never does.
    return float(np.min(moving)) if len(moving) < 0.98 * len(steps) and len(moving) else 0.0


def _largest(halves: list[HalfSwing], angle: Array) -> int:
    return max(range(len(halves)), key=lambda i: abs(angle[halves[i].extreme]), default=0)


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


def _hand_gone(angle: Array, release: int) -> int:
    below = np.flatnonzero(np.abs(angle[release:]) < _HAND_GONE * abs(angle[release]))
    return release + int(below[0]) if len(below) else release


def _peaks(
    time: Array, angle: Array, release: int, half: HalfSwing, later: list[HalfSwing]
) -> tuple[Array, Array, tuple[str, ...]]:
    times, angles = [float(time[release])], [float(angle[release])]
    spacing = float(np.median(np.diff([time[h.extreme] for h in (half, *later)]))) if later else 0.0
    for swing in later:
        near = np.abs(time[swing.first : swing.last + 1] - time[swing.extreme]) <= spacing / 16
        at = np.flatnonzero(near) + swing.first
        peak_time, peak_angle = (
            vertex(time[at], angle[at]) if len(at) >= 5 else (time[swing.extreme], angle[swing.extreme])
        )
        if abs(peak_angle) < SMALLEST_PEAK_RAD:
            break
        if len(angles) > 1 and abs(peak_angle) > _GROWTH * abs(angles[-1]):
            return (
                np.array(times),
                np.array(angles),
                (f"peak {len(angles) + 1} is higher than the one before: the free swing ends there.",),
            )
        times.append(float(peak_time))
        angles.append(float(peak_angle))
    return np.array(times), np.array(angles), ()


def _usable(peak_angle: Array, asked: int | None, smallest: float) -> tuple[int, tuple[str, ...]]:
    found = len(peak_angle)
    if found < FEWEST_PEAKS:
        raise DataError(
            f"{found} usable peaks of at least 1 degree: a fit needs {FEWEST_PEAKS}. "
            "Release higher, let it swing until it stops, or check the window (--from, --to)."
        )
    if asked is None:
        return max(FEWEST_PEAKS, int(np.count_nonzero(np.abs(peak_angle) >= smallest))), ()
    if asked > found:
        return found, (f"{asked} peaks were asked for; only {found} are at least 1 degree high.",)
    return asked, ()
