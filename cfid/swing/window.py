"""Find the free swing in a record: rest, release, peaks and window, and readings that are held. Fits nothing.

This is section 2.4.4 of the thesis with its manual work replaced: the rest angle is taken from the end of the record
instead of its twentieth sample, the release is where the hand lets go instead of the highest sample, and the peaks on
the release's side are found, with the release as the first (as in table 2.3).
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.estimate.held_readings import first_rows, rows_a_reading
from cfid.estimate.signals import GRID_S, HalfSwing, check_dense, half_swings, resample, smooth, vertex
from cfid.findings import Finding, warning
from cfid.recordings.angle import AngleRecord
from cfid.recordings.gyro import SCALE_STD
from cfid.records.rig_file import EncoderScale
from cfid.swing.pendulum import NO_THREADS, Setup, Threads

Array = npt.NDArray[np.float64]

SMALLEST_PEAK_RAD = math.radians(1.0)
FEWEST_PEAKS = 4

_ENCODER = EncoderScale()  # of a rig about which nothing is known
_MOST_ROWS = 2_000_000  # half an hour at 1 kHz
_THRESHOLD_RAD = SMALLEST_PEAK_RAD / 2
_LOW_DEG = 10.0  # for a highest peak below this, a higher release gives more peaks
_GROWTH = 1.05  # a free swing's peaks only decrease
_STANDING_STILL = 0.05  # of the highest speed in the first fall
_HAND_GONE = 0.8  # of the release angle: at this angle, the fingers are open
_UPPERMOST = 0.95  # of a peak: above it lies an eighth of a period
_OFF_A_COSINE = 0.3  # of the amplitude: the largest distance from a cosine; a swing of 90 degrees has less
_GAP_S = 0.25  # between rows of a gyro: across a longer gap, its angle is unknown

# A frozen segment has at least this many equal readings, and lasts this many times as long as a reading usually does: a
# slow encoder repeats all of its readings.
_FEWEST, _LONGER = 4, 4.0
_SHORTEST = 1 / 40  # of a period: on a busy computer, readings may have time stamps within less
_AROUND = 1 / 8  # of a period on either side, in which a cubic describes a swing
# The largest distance between a cubic and equal readings, in steps of the encoder and in standard deviations of its
# noise.
_STEPS, _SCATTERS = 3.0, 5.0


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
    encoder: EncoderScale = _ENCODER
    findings: tuple[Finding, ...] = ()

    @property
    def release_s(self) -> float:
        """The time of the release."""
        return float(self.time_s[self.release])

    @property
    def timed_by(self) -> str:
        """Whose clock stamps the readings."""
        return "encoder" if self.rate_rad_per_s is None else "vehicle"

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


def swing_in(
    record: AngleRecord, threads: Threads = NO_THREADS, encoder: EncoderScale = _ENCODER, **window: Any
) -> FreeSwing:
    """Find the free swing of a recording; `threads` carry the body, `window` are arguments of `find_swing`.

    Of an encoder that repeats its readings, the first row of each counts: a row that repeats one shows an earlier
    angle. Raises DataError that names the file, also where readings stand still while the body swings.
    """
    time_s, angle_rad = record.time_s, record.angle_rad
    try:
        swing = find_swing(time_s, angle_rad, **window)
        window_rows = slice(swing.hand_gone, swing.end + 1)
        if record.rates is None and (rows := rows_a_reading(swing.angle_rad[window_rows])) > 1:
            rate_hz = (swing.end - swing.hand_gone) / float(np.ptp(swing.time_s[window_rows]))
            text = (
                f"each reading of the angle is repeated in about {rows} rows: {rate_hz:.3g} rows a second show "
                f"{rate_hz / rows:.3g} readings. The first row of each counts. Send a line only where the sensor has "
                "a new reading, and state that rate."
            )
            readings = first_rows(angle_rad, rows=rows)
            swing = find_swing(time_s[readings], angle_rad[readings], **window)
            swing = replace(swing, findings=(*swing.findings, warning("swing-angle-repeated", text, "swing.*")))
        if record.rates is None:
            _check_frozen(swing)
    except DataError as error:
        raise DataError(f"{record.path}: {error}{_unsummed(record)}") from None
    if record.rates is None:
        time_scale_std = math.hypot(record.time_scale_std, encoder.clock_std)
        return replace(swing, time_scale_std=time_scale_std, threads=threads, encoder=encoder)
    return replace(
        swing,
        time_scale_std=record.time_scale_std,
        threads=threads,
        rate_rad_per_s=record.rates.rate_rad_per_s,
        rate_scale_std=SCALE_STD,
    )


def check_peaks(peaks: int | Mapping[str, int] | None, axes: Iterable[str]) -> None:
    """Check numbers of peaks, one for all axes or one for each.

    Raises ConfigError for numbers below four, and for an axis without a swing.
    """
    axes = list(axes)
    if isinstance(peaks, Mapping):
        for axis in peaks.keys() - axes:
            known = ", ".join(axes) or "an axis without a name"
            raise ConfigError(f"peaks {axis}={peaks[axis]}: no swing is about '{axis}', but about {known}.")
    counts = peaks.values() if isinstance(peaks, Mapping) else () if peaks is None else (peaks,)
    for count in counts:
        if count < FEWEST_PEAKS:
            raise ConfigError(f"peaks {count}: a fit needs {FEWEST_PEAKS} peaks at least, the release being the first.")


def peaks_on(axis: str | None, peaks: int | Mapping[str, int] | None) -> int | None:
    """Return the number of peaks to use on an axis, None for all."""
    return peaks.get(axis or "") if isinstance(peaks, Mapping) else peaks


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
    if np.count_nonzero(kept) > _MOST_ROWS:
        raise DataError(
            f"{np.count_nonzero(kept)} rows are more than a fit takes ({_MOST_ROWS}): bound the swing by `from_s` and "
            "`to_s`; see it with `cfid show`."
        )
    check_dense(time[kept])
    first = int(np.flatnonzero(kept)[0])
    rest = _rest(angle_rad[kept])
    angle = angle_rad - rest
    _check_motion(time[kept], angle[kept])
    halves = half_swings(angle[kept], threshold_rad=_THRESHOLD_RAD)
    halves = [HalfSwing(h.first + first, h.last + first, h.extreme + first, h.side) for h in halves]
    halves = _completed(angle, halves, last=int(np.flatnonzero(kept)[-1]))
    if not halves:
        raise DataError(_no_swing(angle[kept]))
    taken = first > 0 and _falls_freely(time, angle, halves, first)
    begin = _by_hand(time, angle, halves, first) if taken else _let_go(time, angle, halves)
    moved = () if taken else _moved_again(time, angle, halves, begin)
    peak_time, peak_angle, grows = _peaks(time, angle, begin.peak, begin.later)
    used = _usable(peak_angle, peaks, max(smallest_peak_rad, SMALLEST_PEAK_RAD))
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
        findings=moved + grows,
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
        peak = _peak_of(time, angle, half)
        if abs(peak[1]) < SMALLEST_PEAK_RAD:
            break
        if len(peaks) > 1 and abs(peak[1]) > _GROWTH * abs(peaks[-1][1]):
            text = f"peak {len(peaks) + 1} is higher than the one before: the free swing ends there."
            findings = (warning("swing-peak-grows", text, "swing.*"),)
            break
        peaks.append(peak)
    times, angles = np.array(peaks).T
    return times, angles, findings


def _usable(peak_angle: Array, requested: int | None, smallest: float) -> int:
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
        return max(FEWEST_PEAKS, int(np.count_nonzero(np.abs(peak_angle) >= smallest)))
    if requested > found:
        raise DataError(f"{requested} peaks were requested; only {found} are at least 1 degree high.")
    return requested


class _Begin(NamedTuple):
    """The start of a swing: samples of the release and of hands off, first peak, later half-swings of its side."""

    release: int
    hand_gone: int
    peak: tuple[float, float]
    later: list[HalfSwing]


def _let_go(time: Array, angle: Array, halves: list[HalfSwing]) -> _Begin:
    """Find the release: the first peak, in the half-swing that reaches farthest among those that enough peaks follow.

    Where the body was moved again shortly before the end, the earlier swing is used.
    """
    followed = [i for i in range(len(halves)) if _peaks_from(angle, halves, i) >= FEWEST_PEAKS]
    start = max(followed or range(len(halves)), key=lambda i: abs(angle[halves[i].extreme]))
    release = _release(time, angle, halves[start])
    below = np.flatnonzero(np.abs(angle[release:]) < _HAND_GONE * abs(angle[release]))
    hand_gone = release + int(below[0]) if len(below) else release
    peak = float(time[release]), float(angle[release])
    return _Begin(release, hand_gone, peak, _same_side(halves, start))


def _peaks_from(angle: Array, halves: list[HalfSwing], start: int) -> int:
    """Return the number of decreasing peaks on one side from a half-swing on, including its own."""
    sizes = [abs(float(angle[half.extreme])) for half in (halves[start], *_same_side(halves, start))]
    ends = (i for i, (one, other) in enumerate(pairwise(sizes), 1) if other > _GROWTH * one)
    peaks = sizes[: next(ends, len(sizes))]
    return sum(size >= SMALLEST_PEAK_RAD for size in peaks)


def _moved_again(time: Array, angle: Array, halves: list[HalfSwing], begin: _Begin) -> tuple[Finding, ...]:
    """Warn of a half-swing that reaches farther than the release in use, but comes too late to be fitted."""
    farthest = max(halves, key=lambda half: abs(angle[half.extreme]))
    if farthest.first <= begin.release or abs(angle[farthest.extreme]) <= _GROWTH * abs(begin.peak[1]):
        return ()
    text = (
        f"the body was moved again at {time[farthest.first]:.1f} s, too late to be fitted: the swing that was released "
        f"at {time[begin.release]:.1f} s is taken."
    )
    return (warning("swing-moved-again", text, "swing.*"),)


def _completed(angle: Array, halves: list[HalfSwing], *, last: int) -> list[HalfSwing]:
    """Return the half-swings, without a last one that the window cuts before its peak has passed."""
    if not halves:
        return []
    final = halves[-1]
    passed = np.abs(angle[final.extreme : last + 1]) < _UPPERMOST * abs(angle[final.extreme])
    return halves if passed.any() else halves[:-1]


def _falls_freely(time: Array, angle: Array, halves: list[HalfSwing], first: int) -> bool:
    """Return whether the body swings freely at the window's first sample, instead of being at rest or in a hand.

    It swings freely where it follows a cosine about the first standstill.
    """
    still = _release(time, angle, halves[0])
    if still <= first or len(halves) < 2:
        return True
    half_period_s = float(np.median(np.diff(time[[half.extreme for half in halves]])))
    phase = math.pi * float(time[still] - time[first]) / half_period_s
    return bool(abs(angle[first] - angle[still] * math.cos(min(phase, math.pi))) < _OFF_A_COSINE * abs(angle[still]))


def _by_hand(time: Array, angle: Array, halves: list[HalfSwing], first: int) -> _Begin:
    """Start at the requested sample; the first peak is the first that the window does not cut."""
    start = next((i for i, half in enumerate(halves) if _rises_to(angle, half, first)), 0)
    return _Begin(first, first, _peak_of(time, angle, halves[start]), _same_side(halves, start))


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


def _peak_of(time: Array, angle: Array, half: HalfSwing) -> tuple[float, float]:
    """Return time and angle of a half-swing's peak, from a parabola through its uppermost part."""
    inside = slice(half.first, half.last + 1)
    high = np.abs(angle[inside]) > _UPPERMOST * abs(angle[half.extreme])
    at = np.flatnonzero(high) + half.first
    if len(at) < 5:
        return float(time[half.extreme]), float(angle[half.extreme])
    return vertex(time[at], angle[at])


def _unsummed(record: AngleRecord) -> str:
    """Return a sentence on the longest gap in a gyro's rows, which may explain a strange angle; "" for none."""
    steps = np.diff(record.time_s)
    if record.rates is None or not len(steps) or steps.max() < _GAP_S:
        return ""
    at_s = float(record.time_s[int(np.argmax(steps))])
    return (
        f" The gyro has no rows for {steps.max():.2g} s, after {at_s:.3g} s: the angle that its rates sum up to is not "
        "known across that. Record again with fewer losses."
    )


def _check_frozen(swing: FreeSwing) -> None:
    """Raise DataError where readings stand still for a part of the swing that the motion does not lead through.

    At a turning point, a coarse encoder repeats its readings too.
    """
    angle = swing.angle_rad[swing.hand_gone :]
    edges = swing.hand_gone + np.flatnonzero(np.diff(angle)) + 1
    lasts_s = np.diff(swing.time_s[edges])
    in_window = edges[:-1] <= swing.end
    if not in_window.any():
        return
    least_s = max(_LONGER * float(np.median(lasts_s[in_window])), _SHORTEST * swing.period_s)
    for i in np.flatnonzero((np.diff(edges) >= _FEWEST) & (lasts_s >= least_s) & in_window):
        first, last = int(edges[i]), int(edges[i + 1]) - 1
        if _leads_elsewhere(swing, first, last):
            raise DataError(
                f"the angle stands still for {swing.time_s[last] - swing.time_s[first]:.2g} s, after "
                f"{swing.time_s[first]:.3g} s, while the body swings: the encoder froze, or something held the body. "
                "Check the encoder's cable and swing again, or fit one part, bounded by `from_s` and `to_s`."
            )


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
    around, inside = np.vander(place[near], 4), np.vander(place[first : last + 1], 4)
    cubic = np.linalg.lstsq(around, angle[near], rcond=1e-9)[0]  # the solution of least norm, for repeated time stamps
    remainder = angle[near] - around @ cubic
    scatter = float(np.sqrt(remainder @ remainder / (len(near) - 4)))
    off = float(np.max(np.abs(inside @ cubic - angle[first])))
    return off > _STEPS * swing.resolution_rad + _SCATTERS * scatter
