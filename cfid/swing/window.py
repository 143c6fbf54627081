"""Find the free swing in a record: rest, release, peaks and window. Fits nothing.

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
from cfid.estimate.signals import GRID_S, check_dense, resample, smooth
from cfid.findings import Finding, warning
from cfid.recordings.angle import AngleRecord
from cfid.recordings.gyro import SCALE_STD
from cfid.records.rig_file import EncoderScale
from cfid.swing.pendulum import NO_THREADS, Setup, Threads

Array = npt.NDArray[np.float64]

SMALLEST_PEAK_RAD = math.radians(1.0)
FEWEST_PEAKS = 4

_ENCODER = EncoderScale()  # of a rig about which nothing is known
_CABLE_STD = 5e-4  # of gravity's stiffness, of a cable that is led along the axis
_MOST_ROWS = 2_000_000  # half an hour at 1 kHz
_THRESHOLD_RAD = SMALLEST_PEAK_RAD / 2
_LOW_DEG = 10.0  # for a highest peak below this, a higher release gives more peaks
_GROWTH = 1.05  # a free swing's peaks only decrease
_STANDING_STILL = 0.05  # of the highest speed in the first fall
_HAND_GONE = 0.8  # of the release angle: at this angle, the fingers are open
_UPPERMOST = 0.95  # of a peak: above it lies an eighth of a period
_GAP_S = 0.25  # between rows of a gyro: across a longer gap, its angle is unknown


@dataclass(frozen=True, kw_only=True)
class FreeSwing:
    """A record with the free swing found in it.

    `time_s` and `angle_rad` (n,) are the whole record, from its first sample and about rest. The free swing runs from
    sample `release` to sample `end` (inclusive); the default fit uses it from `hand_gone` on. Peaks are those on the
    release's side, the release first; in a window with given limits, those that lie in it. `time_scale_std` is the
    relative standard uncertainty of the times' scale. A gyro's `rate_rad_per_s` (n,) is about the axis, with the
    relative standard uncertainty `rate_scale_std`; the angle is its integral. It does not show a cable: the stiffness
    of one, over gravity's, has the standard deviation `unseen_cable_std`. `threads` describe those that carry the body.
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
    unseen_cable_std: float = 0.0
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
    angle. Raises DataError that names the file.
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
        unseen_cable_std=_CABLE_STD if encoder.cable_std is None else encoder.cable_std,
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
    at least `smallest_peak_rad`. `from_s` and `to_s`, since the first sample, cut the record.

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
    first, last = (int(np.flatnonzero(kept)[place]) for place in (0, -1))
    rest = _rest(angle_rad[kept])
    angle = angle_rad - rest
    _check_motion(time[kept], angle[kept])
    halves = _half_swings(angle, first, last)
    if halves and np.all(np.abs(angle[halves[-1].extreme : last + 1]) >= _UPPERMOST * abs(angle[halves[-1].extreme])):
        halves.pop()  # the window cuts it before its peak has passed
    if not halves:
        raise DataError(_no_swing(angle[kept]))
    # The half-swing that reaches farthest among those that enough peaks follow: where the body was moved again shortly
    # before the end, the earlier swing is used.
    followed = [i for i in range(len(halves)) if _peaks_from(angle, halves[i:]) >= FEWEST_PEAKS]
    start = max(followed or range(len(halves)), key=lambda i: abs(angle[halves[i].extreme]))
    release = _release(time, angle, halves[start])
    below = np.flatnonzero(np.abs(angle[release:]) < _HAND_GONE * abs(angle[release]))
    peak_time, peak_angle, findings = _peaks(time, angle, release, halves[start:])
    used = _usable(peak_angle, peaks, max(smallest_peak_rad, SMALLEST_PEAK_RAD))
    end = int(np.searchsorted(time, peak_time[used - 1], side="right")) - 1
    _check_gaps(time[release : end + 1])
    return FreeSwing(
        time_s=time,
        angle_rad=angle,
        rest_rad=rest,
        release=release,
        hand_gone=release + int(below[0]) if len(below) else release,
        end=end,
        peak_time_s=peak_time,
        peak_angle_rad=peak_angle,
        peaks_used=used,
        period_s=float((peak_time[used - 1] - peak_time[1]) / (used - 2)),
        resolution_rad=_resolution(angle[kept]),
        findings=findings,
    )


class _HalfSwing(NamedTuple):
    """Samples first..last (inclusive) on one side of the rest angle; `extreme` is the farthest of them."""

    first: int
    last: int
    extreme: int
    side: int


def _half_swings(angle: Array, first: int, last: int) -> list[_HalfSwing]:
    """Cut samples first..last of an angle from rest (n,) into half-swings.

    A side counts once the angle is beyond the threshold there, so that noise about zero makes no half-swings.
    """
    side = np.where(np.abs(angle) > _THRESHOLD_RAD, np.sign(angle), 0)
    beyond = first + np.flatnonzero(side[first : last + 1])
    halves = []
    for half in np.split(beyond, np.flatnonzero(np.diff(side[beyond])) + 1) if len(beyond) else ():
        begin, end = int(half[0]), int(half[-1])
        extreme = begin + int(np.argmax(np.abs(angle[begin : end + 1])))
        halves.append(_HalfSwing(begin, end, extreme, int(side[begin])))
    return halves


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
    halves = _half_swings(angle - rest, 0, len(angle) - 1)
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
    time: Array, angle: Array, release: int, halves: list[_HalfSwing]
) -> tuple[Array, Array, tuple[Finding, ...]]:
    """Return times and angles of the peaks from the release in the first half-swing on, as long as they decrease."""
    peaks = [(float(time[release]), float(angle[release]))]
    findings: tuple[Finding, ...] = ()
    for half in _same_side(halves)[1:]:
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


def _peaks_from(angle: Array, halves: list[_HalfSwing]) -> int:
    """Return the number of decreasing peaks on the side of the first half-swing, including its own."""
    sizes = [abs(float(angle[half.extreme])) for half in _same_side(halves)]
    ends = (i for i, (one, other) in enumerate(pairwise(sizes), 1) if other > _GROWTH * one)
    peaks = sizes[: next(ends, len(sizes))]
    return sum(size >= SMALLEST_PEAK_RAD for size in peaks)


def _same_side(halves: list[_HalfSwing]) -> list[_HalfSwing]:
    return [half for half in halves if half.side == halves[0].side]


def _release(time: Array, angle: Array, half: _HalfSwing) -> int:
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


def _peak_of(time: Array, angle: Array, half: _HalfSwing) -> tuple[float, float]:
    """Return time and angle of a half-swing's peak, from a parabola through its uppermost part."""
    inside = slice(half.first, half.last + 1)
    high = np.abs(angle[inside]) > _UPPERMOST * abs(angle[half.extreme])
    at = np.flatnonzero(high) + half.first
    if len(at) < 5:
        return float(time[half.extreme]), float(angle[half.extreme])
    middle, span = float(time[at].mean()), float(np.ptp(time[at])) or 1.0
    place = (time[at] - middle) / span
    # The solution of least norm: where time stamps repeat so often that no parabola is determined, it is flat.
    curve, slope, level = np.linalg.lstsq(np.vander(place, 3), angle[at], rcond=1e-9)[0]
    top = float(np.clip(-slope / (2 * curve), place[0], place[-1])) if curve else 0.0
    return middle + span * top, float(level + slope * top + curve * top**2)


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
