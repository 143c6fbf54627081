"""Find the free swing in an encoder record: rest, release, peaks, window. Fits nothing.

This is section 2.4.4 of the thesis with its manual work replaced: the rest angle is taken from the end of the record
instead of its twentieth sample, the release is where the hand lets go instead of the highest sample, and the peaks on
the release's side are found, with the release as the first (as in table 2.3).
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.estimate.signals import HalfSwing, check_dense, half_swings
from cfid.findings import Finding, note, warning
from cfid.swing.collocation import NO_THREADS, Threads
from cfid.swing.model import Setup
from cfid.swing.release import (
    FEWEST_PEAKS,
    GROWTH,
    SMALLEST_PEAK_RAD,
    by_hand,
    completed,
    falls_freely,
    let_go,
    moved_again,
    peak_of,
)

Array = npt.NDArray[np.float64]


_THRESHOLD_RAD = SMALLEST_PEAK_RAD / 2
_LOW_DEG = 10.0  # for a highest peak below this, a higher release gives more peaks


@dataclass(frozen=True, kw_only=True)
class FreeSwing:
    """A record with the free swing found in it.

    `time_s` and `angle_rad` (n,) are the whole record, from its first sample and about rest. The free swing runs from
    sample `release` to sample `end` (inclusive); the default fit uses it from `hand_gone` on. Peaks are those on the
    release's side, the release first; in a window with given limits, those that lie in it. `time_scale_std` is the
    relative standard uncertainty of the times' scale. A gyro's `rate_rad_per_s` (n,) is about the axis, with the
    relative standard uncertainty `rate_scale_std`; the angle is its integral. `threads` describe those that carry the
    body.
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
        """The time of the release."""
        return float(self.time_s[self.release])

    @property
    def free(self) -> tuple[Array, Array]:
        """The times and angles from the release on, which the thesis fits."""
        window = slice(self.release, self.end + 1)
        return self.time_s[window], self.angle_rad[window]

    @property
    def setup(self) -> Setup:
        """What the model contains in addition to a pendulum with an encoder."""
        return Setup(self.threads, None if self.rate_rad_per_s is None else 2 * math.pi / self.period_s)

    @property
    def readings_rad(self) -> Array:
        """The fitted readings, from when the hand has certainly let go: angles, or a gyro's rates as in `Setup`."""
        window, per_s = slice(self.hand_gone, self.end + 1), self.setup.gyro_per_s
        if self.rate_rad_per_s is None or per_s is None:
            return self.angle_rad[window]
        return self.rate_rad_per_s[window] / per_s

    @property
    def hands_off(self) -> tuple[Array, Array]:
        """The times and angles from when the hand has certainly let go."""
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

    `peaks` ends the window at that peak, with the release as the first; otherwise the window ends at the last peak of
    at least `smallest_peak_rad`. `from_s` and `to_s` (since the first sample) are given limits of the window; a body
    that is still at rest or held at `from_s` swings from its release on.

    Raises DataError when the angle never moves, goes over the top, or shows fewer than four peaks, or when there are
    too few samples for their time.
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
    _check_motion(time[kept], angle[kept])
    halves = half_swings(angle[kept], threshold_rad=_THRESHOLD_RAD)
    halves = [HalfSwing(h.first + first, h.last + first, h.extreme + first, h.side) for h in halves]
    halves = completed(angle, halves, last=int(np.flatnonzero(kept)[-1]))
    if not halves:
        raise DataError(_no_swing(angle[kept]))
    taken = first > 0 and falls_freely(time, angle, halves, first)
    begin = by_hand(time, angle, halves, first) if taken else let_go(time, angle, halves)
    moved = () if taken else moved_again(time, angle, halves, begin)
    peak_time, peak_angle, grows = _peaks(time, angle, begin.peak, begin.later)
    used, fewer = _usable(peak_angle, peaks, max(smallest_peak_rad, SMALLEST_PEAK_RAD))
    end = int(np.searchsorted(time, peak_time[used - 1], side="right")) - 1
    _check_gaps(time[begin.release : end + 1])
    return FreeSwing(
        time_s=time,
        angle_rad=angle,
        rest_rad=rest,
        release=begin.release,
        hand_gone=begin.hand_gone,
        end=end,
        peak_time_s=peak_time,
        peak_angle_rad=peak_angle,
        peaks_used=used,
        period_s=float((peak_time[used - 1] - peak_time[1]) / (used - 2)),
        resolution_rad=_resolution(angle[kept]),
        findings=moved + grows + fewer,
    )


def _no_swing(angle: Array) -> str:
    """Return why angles from rest (n,) contain no half-swing."""
    farthest = float(angle[np.argmax(np.abs(angle))])
    if abs(farthest) < _THRESHOLD_RAD:
        return "no swing: the angle never stays off rest by half a degree. Look at it with `cfid show`."
    return (
        f"no release found: the angle goes {math.degrees(farthest):.3g} degrees from rest and does not swing back "
        "before the record ends. Let the body go, and record until it hardly swings."
    )


def _rest(angle: Array) -> float:
    """Return the angle of the body at rest: the median of the record's last third.

    Where it still swings at the end, the median depends on where the record was cut; the weighted mean of three
    successive extremes does not, and is not affected by a steady decay.
    """
    rest = float(np.median(angle[-max(len(angle) // 3, 1) :]))
    halves = half_swings(angle - rest, threshold_rad=_THRESHOLD_RAD)
    if len(halves) < 4 or halves[-1].first < len(angle) - (halves[-1].first - halves[-3].first):
        return rest
    before, middle, after = (float(angle[half.extreme]) for half in halves[-4:-1])
    return (before + 2 * middle + after) / 4


def _check_motion(time: Array, angle: Array) -> None:
    if np.ptp(angle) == 0:
        raise DataError("the angle never changes: is the encoder powered, and is this the right column?")
    if np.ptp(angle) < SMALLEST_PEAK_RAD:
        raise DataError(
            f"the angle moves by {math.degrees(np.ptp(angle)):.2g} degrees in all: no swing. "
            "Let it go from 20 degrees or more; if it swung, check the unit of the angle or of the gyro, and an "
            "encoder's counts per turn."
        )
    farthest = float(np.max(np.abs(angle)))
    if farthest > math.pi:
        steps = np.abs(np.diff(angle))
        place = int(np.argmax(steps))
        raise DataError(
            f"a swing of {farthest:.3g} rad goes over the top: the angle's unit or the counts per turn are wrong, the "
            "body turned, as under a falling weight, or readings are wrong (the largest step, "
            f"{steps[place]:.3g} rad, is at {time[place]:.4g} s)."
        )


def _check_gaps(time: Array) -> None:
    """Raise DataError where a gap in a free swing (n,) is longer than everything that was recorded of it."""
    steps = np.diff(time)
    longest = int(np.argmax(steps))
    if 2 * steps[longest] > time[-1] - time[0]:
        raise DataError(
            f"nothing was recorded for {steps[longest]:.3g} s of the swing, after {time[longest]:.4g} s: was the clock "
            "set? Fit one part, bounded by `from_s` and `to_s`."
        )


def _resolution(angle: Array) -> float:
    """Return the smallest step between neighbouring readings of a coarse encoder; 0 for a fine one."""
    steps = np.abs(np.diff(angle))
    moving = steps[steps > 1e-12]
    # A quantized angle often repeats from one sample to the next; a fine one never does.
    return float(np.min(moving)) if len(moving) < 0.98 * len(steps) and len(moving) else 0.0


def _peaks(
    time: Array, angle: Array, begin: tuple[float, float], later: list[HalfSwing]
) -> tuple[Array, Array, tuple[Finding, ...]]:
    """Return times and angles of the peaks from the first one on, as long as they decrease."""
    peaks = [begin]
    findings: tuple[Finding, ...] = ()
    for half in later:
        peak = peak_of(time, angle, half)
        if abs(peak[1]) < SMALLEST_PEAK_RAD:
            break
        if len(peaks) > 1 and abs(peak[1]) > GROWTH * abs(peaks[-1][1]):
            text = f"peak {len(peaks) + 1} is higher than the one before: the free swing ends there."
            findings = (warning("swing-peak-grows", text, "swing.*"),)
            break
        peaks.append(peak)
    times, angles = np.array(peaks).T
    return times, angles, findings


def _usable(peak_angle: Array, requested: int | None, smallest: float) -> tuple[int, tuple[Finding, ...]]:
    found = len(peak_angle)
    if found < FEWEST_PEAKS:
        highest_deg = math.degrees(np.abs(peak_angle).max())
        remedy = "Release higher" if highest_deg < _LOW_DEG else "Record longer after the release"
        raise DataError(
            f"{counted(found, 'usable peak')} of at least 1 degree, the highest {highest_deg:.2g}: a fit needs "
            f"{FEWEST_PEAKS}. {remedy} and let it swing until it stops; look at it with `cfid show`; check the angle's "
            "unit and the counts per turn."
        )
    if requested is None:
        return max(FEWEST_PEAKS, int(np.count_nonzero(np.abs(peak_angle) >= smallest))), ()
    if requested > found:
        text = f"{requested} peaks were requested; only {found} are at least 1 degree high."
        return found, (note("swing-fewer-peaks", text, "swing.*"),)
    return requested, ()
