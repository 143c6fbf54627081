"""Reduce the record of a thrust staircase to one mean for each command, with tare and uncertainty. Fits no map.

An interval starts with a command, or where the thrust is seen to change. Thrust follows it after a delay, with a lag:
the onset. Five lags after that, it counts as steady if it also looks steady. The mean of the steady window, less the
tare of the pauses around it, is a point.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from cfid.counted import counted
from cfid.errors import DataError, FitError
from cfid.estimate.held_readings import rows_a_reading
from cfid.estimate.propagation import effective_freedom, widening
from cfid.estimate.signals import SMOOTHED_S, Mean, Runs, Slow, block_means, find_spikes, quiet_mean, slowed
from cfid.findings import Finding, warning
from cfid.large import PART_ROWS, differences, empty, stored
from cfid.lazy import later
from cfid.units import DEAD_COMMAND
from cfid.wire.rdt_status import Family, read_status

_find_peaks = later("scipy.signal", "find_peaks")  # imported only where no commands are known, because it takes long

Array = npt.NDArray[np.float64]
Words = npt.NDArray[np.uint32]
Window = tuple[float, float]
Four = tuple[int, int, int, int]

FZ = 2
LAGS = 5  # after which 0.7 % of a step remains

# Records
_FEWEST, _SHORTEST_S = 64, 1.0
_THINNED_HZ, _SCREENED_S = 1000.0, 0.2  # the latter for spikes, at once
_FAMILIES: tuple[Family, ...] = ("netft", "axia")
_SLOWEST_READING_S = 1.0
_RESOLVED = 1e-6  # of a channel's range: otherwise, means of exact numbers would outweigh all others

# Changes that are seen without a command log
_CHANGE_SEEN_S = 0.25  # duration of the two means that are compared
_SURE = 6.0  # standard deviations of the noise
_OF_RANGE, _OF_LEVEL = 0.004, 0.02  # the least change, relative to the record's range and to its level
_PAUSE_OF_RANGE, _BACK, _BACK_TO = 0.015, 0.1, 0.5
_OWN_PEAK = 0.3  # of its height: a change that stands out less from its neighbours is a part of these

# Onsets
_EARLY_S, _LATE_S = 0.1, 0.6  # limits of an onset relative to a stamped command
_STEP_S, _LEAST_LAG_S = 0.04, 0.01
_EXPLAINED, _FEWEST_SEEN = 0.9, 10
_LOOK_S, _USUAL_LAG_S = 2.0, 0.1

# Steady windows. The first two limits are relative to a step's height; the third is for a baseline, relative to the
# highest step.
_DRIFT, _WAVE, _BASELINE_WAVE = 0.05, 0.005, 0.001
_LEAST_HEIGHT = 0.02  # of the highest step: limits for lower steps do not become narrower
_FEWEST_BLOCKS, _MOST_BLOCKS = 3, 24
_FEWEST_IN_BASELINE = 2  # readings: an uncertain tare is better than none
_SEEN, _SILENT = 3.0, "no thrust is seen"  # the first is in standard uncertainties
# Standard deviations that the noise of 24 blocks exceeds in one of 1000 windows: of a slope, of von Neumann's ratio.
_SLOPE, _ALIKE = 4.0, 3.0

# Readings of another level
_FAR = 6.0  # times the median distance: four standard deviations of noise, and beyond any vibration's crest
_MOVED = 0.005  # of the level: a smaller distance of the mean from the median may be due to gusts and skewed noise
_MOST_SHARE = 0.02  # of the readings: the most that may be far on one side more than on the other, or repeat one value
# Times as often as any other of at least this many values, which does not occur in noise.
_OFTEN, _FEWEST_VALUES = 4.0, 10
_FEWEST_TIMES = 3  # the least returns of another level: a signal that settles or stands still reaches it once
_DROPS_OUT = ": an instrument that drops out or repeats a reading"


class NeverRanError(DataError):
    """A record does not show any running motor."""


class NoBaselineError(DataError):
    """A record starts with a command."""


class Level(NamedTuple):
    """The mean of the channels (k,) in a window about a time."""

    time_s: float
    of: Mean

    @property
    def mean(self) -> Array:
        """The means (k,)."""
        return self.of.value

    @property
    def std(self) -> Array:
        """The standard uncertainties of the means (k,)."""
        return self.of.std


@dataclass(frozen=True, kw_only=True, eq=False)
class Point:
    """One command: means (k,) of its steady window less the tare, with standard uncertainties that include the tare's.

    Means are NaN if the step never settled: `reason` states why it did not, or why the point should not be used.
    `tare_shares` (r, k) is the effect of one standard uncertainty of each of the record's r baselines on the tare.
    `slope` is the remaining change per second in the window; `motors`, 1 to 4, are those that ran. The thrust started
    to follow at `onset_s`, with the time constant `lag_s`, and `delay_s` after its command: data of other instruments,
    by the clock of the commands, are earlier by that delay. Delay, command and motors are unknown without a command
    log.
    """

    command: int | None
    motors: tuple[int, ...]
    begin_s: float
    end_s: float
    mean: Array
    std_of_mean: Array
    effective_samples: Array
    slope: Array
    tare: Array
    tare_shares: Array
    onset_s: float
    lag_s: float
    delay_s: float | None
    reason: str

    @property
    def settled(self) -> bool:
        """Whether the mean is valid."""
        return not self.reason


@dataclass(frozen=True, kw_only=True, eq=False)
class Staircase:
    """A reduced record: its points in order, and the load cell's baselines, with the motors off.

    `tare_after`, and the `drift` (k,) per second up to it, are None where no baseline follows the last step.
    `begins_driven` states that the first baseline, `tare_before`, comes after a step.
    """

    points: tuple[Point, ...]
    tare_before: Level
    tare_after: Level | None
    drift: Array | None
    spikes: int
    begins_driven: bool = False

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The findings about its means: steps that are left out, an unknown drift."""
        found = [
            warning("step-left-out", f"command {point.command}: {point.reason}; it is left out.")
            for point in self.points
            if not point.settled
        ]
        if self.begins_driven:
            text = (
                "the record begins with the motors driven: thrust counts from the rest after them, and how far the "
                "load cell drifted until then is not known."
            )
            found.insert(0, warning("no-baseline-before", text))
        elif self.tare_after is None:
            text = "no steady baseline after the last command: how far the load cell drifted is not known."
            found.insert(0, warning("no-baseline-after", text))
        return tuple(found)

    @property
    def rest_s(self) -> float:
        """Until when the motors are off at the beginning of the record, 0 where it begins with the motors driven."""
        return 0.0 if self.begins_driven else float(self.points[0].onset_s)

    def steady(self) -> tuple[Point, ...]:
        """Return the points that settled. Raises FitError when none did."""
        steady = tuple(point for point in self.points if point.settled)
        if not steady:
            first = self.points[0]
            raise FitError(
                f"none of {counted(len(self.points), 'step')} settles. The first, from {first.onset_s:.3g} s on: "
                f"{first.reason}. Hold each command longer, or give the windows by hand."
            )
        return steady


def reduce_staircase(
    *,
    time_s: Array,
    channels: Array,
    command_time_s: Array | None = None,
    commands: Array | None = None,
    status: Words | None = None,
    thrust: int = FZ,
    tared: bool = True,
) -> Staircase:
    """Reduce channels (n, k) in any unit at times (n,); the channel `thrust` shows where the motors run.

    Commands (m, 4) hold from `command_time_s` (m,) on, by the same clock; without them, changes of thrust are searched.
    `status` (n,) are the load cell's words. What `tared` channels show in pauses is subtracted; other channels, such as
    speeds, are zero where nothing runs.

    Raises DataError for a record that is too short, out of order, not finite or faulty, that has no baseline, or that
    shows no motor running.
    """
    record = prepared(time_s, channels, status=status, thrust=thrust)
    if command_time_s is None or commands is None:
        intervals = changes_seen(record.slow)
    else:
        first_s, last_s = record.slow.time_s[[0, -1]].tolist()
        intervals = commanded_intervals(command_time_s, commands, begin_s=first_s, end_s=last_s)
    return _reduced(record, intervals, tared=tared)


def reduce_single(
    *,
    time_s: Array,
    channels: Array,
    command: int | None = None,
    status: Words | None = None,
    window: Window | None = None,
) -> Staircase:
    """Reduce a record of one command between two pauses, as in the thesis; otherwise as `reduce_staircase`.

    Raises FitError when more than one step is found, unless a window selects one.
    """
    record = prepared(time_s, channels, status=status, thrust=FZ)
    intervals = changes_seen(record.slow)
    steps = [i for i, interval in enumerate(intervals) if not interval.pause]
    middle_s = math.nan if window is None else sum(window) / 2
    meant = [i for i in steps if window is None or intervals[i].begin_s <= middle_s <= intervals[i].end_s]
    if steps and len(meant) != 1:
        times = ", ".join(f"{intervals[i].begin_s:.4g} to {intervals[i].end_s:.4g} s" for i in steps)
        rows = record.held * record.block
        few = (
            f" Readings repeat in about {rows} rows: the scatter of so few may look like steps."
            if record.held > 1
            else ""
        )
        raise FitError(
            f"expected one step between two pauses, found {times}.{few} Give its window, or the command log."
        )
    staircase = _reduced(record, intervals, windows={} if window is None else dict.fromkeys(meant, window))
    point = staircase.points[steps.index(meant[0])]
    return replace(staircase, points=(replace(point, command=command),))


def mean_in_windows(points: Sequence[Point], time_s: Array, value: Array) -> Array:
    """Return the means (p,) of another instrument's `value` (n,) at times (n,), in the windows of points.

    By the clock of the commands, the windows are earlier by the delay of the thrust. NaN where nothing was recorded.
    """
    late_s = np.array([point.delay_s or 0.0 for point in points])
    begin, end = (np.array([getattr(point, name) for point in points]) - late_s for name in ("begin_s", "end_s"))
    first, last = np.searchsorted(time_s, begin), np.searchsorted(time_s, end, side="right")
    windows = [value[i:j] for i, j in zip(first, last, strict=True)]
    return np.array([window.mean() if len(window) else math.nan for window in windows])


# The record


@dataclass(frozen=True, kw_only=True, eq=False)
class StandSignals:
    """Channels (k, m) without spikes at times (m,), averaged over `block` samples to about 1 kHz; smoothed thrust.

    `held` neighbours repeat one reading. `finest` (k,) is the least standard uncertainty of a mean.
    """

    time_s: Array
    value: Array
    rate_hz: float
    block: int
    slow: Slow
    thrust: int
    held: int
    finest: Array
    spikes: int


def prepared(time_s: Array, channels: Array, *, status: Words | None, thrust: int) -> StandSignals:
    """Check channels (n, k) at times (n,), whose `thrust` shows where motors run, and remove their spikes.

    Raises DataError for a record that is too short, out of order, not finite or faulty.
    """
    _check(time_s, channels, status)
    rate_hz = (len(time_s) - 1) / float(time_s[-1] - time_s[0])
    block, length = max(round(rate_hz / _THINNED_HZ), 1), max(round(_SCREENED_S * rate_hz), _FEWEST)
    time_s = stored(block_means(time_s, length=block))
    rate_hz /= block
    value = empty(channels.shape[1], len(time_s))
    spikes: set[int] = set()
    # One by one, because together they may not fit into memory.
    for means, channel in zip(value, channels.T, strict=True):
        means[:] = block_means(channel, length=block)
        if not np.isfinite(means).all():
            raise DataError("the record has samples that are no numbers: cut those lines.")
        place, instead = _spikes(channel, length=length)
        whole = place < len(means) * block
        np.add.at(means, place[whole] // block, ((instead - channel[place]) / block)[whole])
        spikes.update(place.tolist())
    return StandSignals(
        time_s=time_s,
        value=value,
        rate_hz=rate_hz,
        block=block,
        slow=slowed(time_s, value[thrust], rate_hz=rate_hz),
        thrust=thrust,
        held=rows_a_reading(value[thrust, :PART_ROWS], longest=_SLOWEST_READING_S * rate_hz),
        finest=_RESOLVED * np.ptp(value, axis=1),
        spikes=len(spikes),
    )


def _spikes(channel: Array, *, length: int) -> tuple[npt.NDArray[np.intp], Array]:
    """Return places and replacements of a channel's spikes as `find_spikes` does, in parts if it is long.

    Parts overlap by two blocks of `length`, more than a limit depends on.
    """
    step = -(-PART_ROWS // length) * length
    found = []
    for begin in range(0, len(channel), step):
        low, end = max(begin - 2 * length, 0), begin + step
        part = np.ascontiguousarray(channel[low : end + 2 * length], np.float64)
        _, place, instead = find_spikes(part[np.newaxis], length=length)
        inside = (low + place >= begin) & (low + place < end)
        found.append((low + place[inside], instead[inside]))
    places, values = zip(*found, strict=True)
    return np.concatenate(places), np.concatenate(values)


def _check(time_s: Array, channels: Array, status: Words | None) -> None:
    if len(time_s) != len(channels):
        raise DataError(f"{len(time_s)} times belong to {len(channels)} samples: they should be as many.")
    falls = next(
        (begin + int(np.argmin(step >= 0)) for begin, step in differences(time_s) if not np.all(step >= 0)), None
    )
    if falls is not None:
        raise DataError(f"after sample {falls + 1} the times do not rise: out of order, or two in one.")
    if len(time_s) < _FEWEST or np.ptp(time_s) < _SHORTEST_S:
        raise DataError(
            f"the record is too short: {counted(len(time_s), 'sample')}, where {_SHORTEST_S} s are the least."
        )
    if status is None or not status.any():
        return
    bad = [word for word in np.unique(status).tolist() if all(read_status(word, family).faults for family in _FAMILIES)]
    faulty = np.flatnonzero(np.isin(status, bad))
    if len(faulty):
        raise DataError(
            f"{len(faulty)} of {len(status)} samples are saturated or faulty (status 0x{bad[0]:08x}), the first after "
            f"{time_s[faulty[0]] - time_s[0]:.3g} s: they are no forces. Load the cell less, or cut them off."
        )


# Intervals


class Interval(NamedTuple):
    """Commands (None if unknown) that hold from one time to another; `pause` where no motor is on."""

    begin_s: float
    end_s: float
    pause: bool
    commands: Four | None = None


def commanded_intervals(command_time_s: Array, commands: Array, *, begin_s: float, end_s: float) -> list[Interval]:
    """Return the intervals of equal commands (m, 4), given from times (m,) on, within a record.

    Before the first command, all motors stand still; repeated commands count as one. Raises DataError for an invalid
    log.
    """
    if commands.shape != (len(command_time_s), 4):
        raise DataError(f"a command log of {len(command_time_s)} times needs as many rows of four: {commands.shape}.")
    if not (np.isfinite(commands).all() and (commands >= 0).all() and (np.diff(command_time_s) >= 0).all()):
        raise DataError("the command log has commands that are no numbers or below zero, or its times do not rise.")
    times = np.concatenate([[-math.inf], command_time_s])
    rows = np.vstack([np.zeros(4), commands]).astype(int)
    changes = np.flatnonzero(np.append(True, (np.diff(rows, axis=0) != 0).any(axis=1)))
    ends = pairwise(np.append(times[changes].clip(begin_s, end_s), end_s).tolist())
    fours = [(row[0], row[1], row[2], row[3]) for row in rows[changes].tolist()]
    return [Interval(*span, not any(four), four) for span, four in zip(ends, fours, strict=True) if span[1] > span[0]]


def changes_seen(slow: Slow) -> list[Interval]:
    """Return the intervals between fast changes of a smoothed thrust, without their commands.

    A change is a peak of the difference between the means of a quarter of a second after and before. It exceeds the
    noise and parts of the record's range and of its level there, which excludes a sagging battery, and stands out from
    its neighbours, which excludes a ramp.
    """
    step_s = (slow.time_s[-1] - slow.time_s[0]) / (len(slow.time_s) - 1)
    width, gap = max(round(_CHANGE_SEEN_S / step_s), 2), math.ceil(SMOOTHED_S / step_s / 2)
    steps = median_filter(slow.value, size=4 * gap + 1, mode="nearest")  # the rest of a removed spike is not a change
    total = np.concatenate([[0.0], np.cumsum(steps)])
    mean = (total[width:] - total[:-width]) / width
    before, after = mean[: -width - 2 * gap], mean[width + 2 * gap :]
    change, noise, span = np.abs(after - before), _noise(slow, width, 2 * gap - 1), np.ptp(before)
    least = np.maximum(_OF_LEVEL * np.abs(before - before[0]), max(_SURE * noise, _OF_RANGE * span))
    peaks, shape = _find_peaks(change, height=least, prominence=_SURE * noise, distance=width)
    peaks = peaks[shape["prominences"] > _OWN_PEAK * change[peaks]]
    times = [float(slow.time_s[0]), *slow.time_s[peaks + width + gap].tolist(), float(slow.time_s[-1])]
    levels = [level(slow, begin, end) for begin, end in pairwise(times)]
    pauses = _pauses(levels, near=max(_SURE / 2 * noise, _PAUSE_OF_RANGE * span))
    return [Interval(begin, end, pause) for (begin, end), pause in zip(pairwise(times), pauses, strict=True)]


def level(slow: Slow, begin_s: float, end_s: float) -> float:
    """Return the median of the second half of an interval, or the nearest sample."""
    first, last = np.searchsorted(slow.time_s, ((begin_s + end_s) / 2, end_s))
    return float(np.median(slow.value[min(first, len(slow.value) - 1) : max(last, first + 1)]))


def _pauses(levels: Sequence[float], *, near: float) -> list[bool]:
    """Return which levels are of pauses: the first, and those that are close to the level of the last pause.

    The last level is also a pause where it undoes nine tenths of the one before, or falls to half of the lowest level
    of a staircase: the load cell may have drifted.
    """
    baseline, pauses = levels[0], [True]
    for here in levels[1:]:
        pauses.append(abs(here - baseline) < near)
        baseline = here if pauses[-1] else baseline
    heights = [abs(here - baseline) for here, pause in zip(levels, pauses, strict=True) if not pause]
    if len(heights) > 1:
        *others, last = heights
        pauses[-1] |= last < max(_BACK * others[-1], _BACK_TO * min(others) * (len(others) > 2))
    return pauses


def _noise(slow: Slow, width: int, apart: int) -> float:
    """Return the standard deviation of the difference of two means of `width` samples, for white noise.

    It is estimated from second differences of samples `apart`, which are means over two thirds of that; steps and
    slopes hardly affect these.
    """
    bend = float(np.median(np.abs(np.diff(slow.value[::apart], n=2))))
    return 1.4826 * bend / math.sqrt(6) * math.sqrt(2 * max(apart * 2 / 3, 1) / width)


# Onsets


class Onset(NamedTuple):
    """The time at which thrust started to follow a change, its time constant, and the variance explained by them."""

    time_s: float
    lag_s: float
    explained: float


def onsets(slow: Slow, intervals: Sequence[Interval], *, baseline: float) -> list[Onset]:
    """Return the onset of each interval except the first, which has none.

    Thrust above `baseline` is the square of a first-order speed. Where no onset explains the record (a step in the
    noise, or one that is shorter than its onset), the median lag of the others is used instead, and after a command
    also their median delay.
    """
    speeds = [
        0.0 if interval.pause else math.sqrt(abs(level(slow, interval.begin_s, interval.end_s) - baseline))
        for interval in intervals
    ]
    steps = [
        (before, after, v / (v + w) if v + w else 0.5)
        for (before, after), (v, w) in zip(pairwise(intervals), pairwise(speeds), strict=True)
    ]
    found = [_onset(slow, *step) for step in steps]
    sure = [
        (onset.time_s - interval.begin_s, onset.lag_s)
        for (_, interval, _), onset in zip(steps, found, strict=True)
        if onset.explained > _EXPLAINED
    ]
    delay_s, usual_s = np.median(sure, axis=0).tolist() if sure else (0.0, _USUAL_LAG_S)
    for i, (step, onset) in enumerate(zip(steps, found, strict=True)):
        if onset.explained <= _EXPLAINED and step[1].commands is None:
            found[i] = _onset(slow, *step, lag_s=usual_s)
        elif onset.explained <= _EXPLAINED:
            found[i] = Onset(step[1].begin_s + delay_s, usual_s, onset.explained)
    return found


def _onset(slow: Slow, before: Interval, interval: Interval, share: float, *, lag_s: float | None = None) -> Onset:
    """Fit onset and lag of a step by a search that becomes finer and narrower.

    `share` is the speed before the step relative to the sum of those before and after. A given lag is kept.
    """
    seen_change = interval.commands is None  # the time lies in the middle of the rise, as does that of the next change
    early_s, late_s = (_LATE_S, _EARLY_S) if seen_change else (_EARLY_S, _LATE_S)
    begin_s, length_s = interval.begin_s, interval.end_s - interval.begin_s
    from_s = max(begin_s - early_s, (before.begin_s + before.end_s) / 2)
    to_s = begin_s + min(_LOOK_S, max(length_s - seen_change * _CHANGE_SEEN_S, length_s / 2))
    times = np.arange(from_s, begin_s + min(late_s, length_s / 2), _STEP_S)
    lags = np.geomspace(_LEAST_LAG_S, max(length_s / 2, 2 * _LEAST_LAG_S), 8) if lag_s is None else np.array([lag_s])
    best = Onset(begin_s, lag_s or _USUAL_LAG_S, 0.0)
    for finer in (None, 1.0, 1.0, 0.3, 0.1):
        if finer is not None:
            near = finer * np.linspace(-1, 1, 5)
            times, lags = best.time_s + _STEP_S * near, best.lag_s * 1.8**near if lag_s is None else lags
        seen = slow.between(times[0] - 2 * _EARLY_S, to_s)
        if len(seen.value) < _FEWEST_SEEN or np.ptp(seen.value) == 0:
            return best
        best = _search(seen, times, lags, share)
    return best


def _search(seen: Slow, times: Array, lags: Array, share: float) -> Onset:
    """Return the onset that explains most of the observed variance, among the given times and lags."""
    time_s, value = seen.time_s[::2], seen.value[::2] - seen.value[::2].mean()
    gone = 1 - np.exp(-np.maximum(time_s - times[:, np.newaxis], 0)[:, np.newaxis] / lags[:, np.newaxis])
    response = 2 * share * gone + (1 - 2 * share) * gone**2
    response -= response.mean(axis=-1, keepdims=True)
    explained = (response @ value) ** 2 / np.maximum(np.einsum("tln,tln->tl", response, response), 1e-300)
    at, lag = np.unravel_index(np.argmax(explained), explained.shape)
    return Onset(float(times[at]), float(lags[lag]), float(explained[at, lag] / max(value @ value, 1e-300)))


# Steady windows


class Stretch(NamedTuple):
    """A steady window, or the reason why none was found between the two times."""

    begin_s: float
    end_s: float
    reason: str = ""


def steady_stretch(
    slow: Slow,
    window: Window,
    *,
    drift: float,
    wave: float,
    hold_s: float,
    height: float | None = None,
    fewest: int = _FEWEST_BLOCKS,
) -> Stretch:
    """Return the longest steady segment in a window of a smoothed thrust whose samples repeat for `hold_s`.

    A segment is steady if it would change by at most `drift` over the whole window, and its variation about that line
    is at most `wave`. The whole window may also change as much as its noise explains, and vary if von Neumann's ratio
    [vN] identifies that as white; a part of it must be steady beyond noise, and at least a quarter of the window. A
    window shorter than three readings, or blocks of 50 ms, is not steady, unless `fewest` accepts it. The reason states
    parts of a step's `height` if that is given.
    """
    from_s, to_s = window
    block_s = max(SMOOTHED_S, hold_s, (to_s - from_s) / _MOST_BLOCKS)
    inside = slow.between(from_s, to_s)
    count = min(max(round((to_s - from_s) / block_s), 0), len(inside.value))
    if count < _FEWEST_BLOCKS:
        left = f"{len(inside.value)} samples in " if block_s * len(inside.value) < to_s - from_s else ""
        short = f"only {left}{max(to_s - from_s, 0):.2g} s of it are left after {LAGS} time constants"
        return Stretch(from_s, max(from_s, to_s), short if count < fewest else "")
    length = len(inside.value) // count
    runs = Runs.of(block_means(inside.value, length=length)[:count], fewest=_FEWEST_BLOCKS)
    whole = runs.size == count
    change, spread = np.abs(runs.slope) * count, runs.slope_std * count
    flat = np.where(whole, (change <= drift) | (change <= _SLOPE * spread), change + 2 * spread <= drift)
    steady = flat & ((runs.wave <= wave) | whole & (runs.alike <= _ALIKE)) & (4 * runs.size >= count)
    if not steady.any():
        changed, waved = (
            f"{size:.2g}" if height is None else f"{100 * size / height:.2g} % of its height"
            for size in (float(change[whole][0]), float(runs.wave[whole][0]))
        )
        much = f"changes by {changed} in {to_s - from_s:.2g} s, {waved} about a line"
        return Stretch(from_s, to_s, f"{LAGS} time constants after its onset it still {much}")
    best = int(np.argmax(np.where(steady, runs.size * count + runs.first, -1)))
    first, last = runs.first[best], runs.first[best] + runs.size[best]
    end_s = to_s if last == count else float(inside.time_s[last * length])
    return Stretch(float(inside.time_s[first * length]), end_s)


def other_level(value: Array, *, finest: float = 0.0) -> str:
    """Return how many of the readings (n,) of a steady level show another one, and which, "" where they do not.

    These readings are repeatedly far from the others on one side: if they are far on both sides, as in a vibration that
    comes and goes, the mean is still right, and so it is if they are not far enough, as in gusts. Or the readings
    repeat one value between others, even within a vibration. Steps of a coarse scale, and distances below `finest`, are
    not far. A signal that is still settling reaches no level repeatedly.
    """
    if not len(value):
        return ""
    values, counts = np.unique(value, return_counts=True)
    middle, steps = float(np.median(value)), np.diff(values)
    off, step = value - middle, float(steps[steps > finest].min(initial=np.inf))
    limit = _FAR * max(float(np.median(np.abs(off))), step if np.isfinite(step) else 0.0, finest)
    above, below = off > limit, off < -limit
    high, low = int(np.count_nonzero(above)), int(np.count_nonzero(below))
    far = above if high > low else below
    moved = abs(float(np.mean(value)) - middle) > _MOVED * abs(middle)
    if moved and abs(high - low) > _MOST_SHARE * len(value) and _comes_back(far):
        return (
            f"{100 * (high + low) / len(value):.0f} % of its readings lie far from the others, at about "
            f"{np.median(value[far]):.3g} where those show {middle:.3g}"
        )
    if len(values) >= _FEWEST_VALUES:
        usual, most = np.sort(counts)[-2:]
        one = float(values[np.argmax(counts)])
        if most >= _OFTEN * usual and most > _MOST_SHARE * len(value) and _comes_back(value == one):
            return f"{100 * most / len(value):.0f} % of its readings repeat {one:.3g} between others"
    return ""


def _comes_back(those: npt.NDArray[np.bool_]) -> bool:
    """Return whether these readings (n,) recur between others."""
    return bool(np.count_nonzero(np.diff(those, prepend=False, append=False)) >= 2 * _FEWEST_TIMES)


# Baselines and points


class _Tare(NamedTuple):
    """The tare (k,) at a time, the part of each baseline's scatter in it (r, k), its uncertainty and its slope (k,)."""

    value: Array
    shares: Array
    std: Array
    slope: Array


def _reduced(
    record: StandSignals,
    intervals: Sequence[Interval],
    *,
    windows: Mapping[int, Window] = {},
    tared: bool = True,
) -> Staircase:
    """Return the points of the intervals in which motors run; some intervals may have given windows, by their index."""
    steps = [i for i, interval in enumerate(intervals) if not interval.pause]
    if not steps:
        raise NeverRanError("the motors never run in this record: no command, or no change of thrust above its noise.")
    levels = np.array([level(record.slow, interval.begin_s, interval.end_s) for interval in intervals])
    rest = next((levels[i] for i, interval in enumerate(intervals) if interval.pause), levels[0])
    begun = onsets(record.slow, intervals, baseline=rest)
    # Each interval may be steady from five lags after its onset to just before the next onset.
    begins = [intervals[0].begin_s, *(onset.time_s + LAGS * onset.lag_s for onset in begun)]
    ends = [*(onset.time_s - SMOOTHED_S / 2 for onset in begun), intervals[-1].end_s]
    bounds = list(zip(begins, ends, strict=True))
    heights = np.abs(levels - rest)
    pauses = [bounds[i] for i in range(len(bounds)) if i not in steps]
    baselines = _baselines(record, pauses, wave=_BASELINE_WAVE * heights.max(), tared=tared)
    driven = bool(baselines) and baselines[0].time_s > bounds[steps[0]][0]
    if not baselines or (driven and steps == [0]):
        raise NoBaselineError("no baseline before the first command: log for some seconds before the motors start.")
    parts = []
    for i in steps:
        height = max(heights[i], _LEAST_HEIGHT * heights.max())
        stretch = Stretch(*windows[i]) if i in windows else _steady(record, baselines, bounds[i], height=height)
        if i == 0:
            stretch = stretch._replace(reason="it was under way when the record began")
        elif not stretch.reason:
            tare = _tare(baselines, (stretch.begin_s + stretch.end_s) / 2).value[record.thrust]
            stretch = stretch._replace(reason=_mixed(record, stretch, float(tare)))
        parts.append(_point(record, baselines, intervals[i], begun[max(i - 1, 0)], stretch))
    points = _widened(parts)
    _refuse_silent_or_mixed(points)
    before, ended = baselines[0], baselines[-1].time_s > bounds[steps[-1]][1]
    after = baselines[-1] if ended and len(baselines) > driven else None
    return Staircase(
        points=tuple(points),
        tare_before=before,
        tare_after=after,
        drift=(after.mean - before.mean) / (after.time_s - before.time_s) if after else None,
        spikes=record.spikes,
        begins_driven=driven,
    )


def _refuse_silent_or_mixed(points: Sequence[Point]) -> None:
    """Raise DataError where no step shows thrust, or where half of them mix two levels.

    In the other half, this may only be harder to see.
    """
    reasons = [point.reason for point in points if (point.command or 0) > DEAD_COMMAND]
    if reasons and all(reason.startswith(_SILENT) for reason in reasons):
        raise DataError(
            f"no motor is felt: {reasons[-1]}. Is the vehicle armed, its battery charged? Where motors turned, the "
            "load cell did not feel them: see to its cable, its mount, and the axis of thrust."
        )
    mixed = [point for point in points if point.reason.endswith(_DROPS_OUT)]
    if 2 * len(mixed) >= len(points):
        at = "" if mixed[-1].command is None else f" at command {mixed[-1].command}"
        raise DataError(
            f"the readings are of two levels in {len(mixed)} of {counted(len(points), 'step')}:{at} "
            f"{mixed[-1].reason}. Its mean is of neither: check its wires and its amplifier, and record again."
        )


def _baselines(record: StandSignals, bounds: Sequence[Window], *, wave: float, tared: bool) -> list[Level]:
    """Average the baselines of two readings or more, including those of a drifting load cell.

    Channels without a tare are exactly zero there. Raises DataError if each of the baselines to subtract mixes readings
    of two levels.
    """
    limits = {"drift": math.inf, "wave": wave, "hold_s": record.held / record.rate_hz}
    found = [steady_stretch(record.slow, window, **limits, fewest=_FEWEST_IN_BASELINE) for window in bounds]
    steady = [stretch for stretch in found if not stretch.reason]
    if not tared:
        zero, exact = np.zeros(len(record.value)), np.full(len(record.value), np.inf)
        return [Level((begin_s + end_s) / 2, Mean(zero, zero, exact, zero, exact)) for begin_s, end_s, _ in steady]
    mixed = [_mixed(record, stretch) for stretch in steady]
    if steady and all(mixed):
        raise DataError(f"in the pauses {mixed[0]}. Check its wires and its amplifier, and record again.")
    sound = [stretch for stretch, reason in zip(steady, mixed, strict=True) if not reason]
    return [Level((stretch.begin_s + stretch.end_s) / 2, _averaged(record, stretch)) for stretch in sound]


def _mixed(record: StandSignals, stretch: Stretch, tare: float = 0.0) -> str:
    """Return why the readings of a steady segment, less a tare, have no mean, "" if they have one level."""
    first, last = np.searchsorted(record.time_s, stretch[:2])
    off = other_level(record.value[record.thrust, first:last] - tare, finest=float(record.finest[record.thrust]))
    return f"{off}{_DROPS_OUT}" if off else ""


def _averaged(record: StandSignals, stretch: Stretch) -> Mean:
    first, last = np.searchsorted(record.time_s, stretch[:2])
    value = record.value[:, first:last]
    value = value if record.held == 1 else block_means(value, length=record.held)
    count = value.shape[1]
    if count < _FEWEST_IN_BASELINE:
        raise DataError(f"fewer than two readings from {stretch.begin_s:.4g} to {stretch.end_s:.4g} s: no mean.")
    mean = quiet_mean(value, rate_hz=record.rate_hz / record.held)
    exact = mean.scatter_std < record.finest
    return mean._replace(
        scatter_std=np.where(exact, record.finest, mean.scatter_std),
        freedom=np.where(exact, np.inf, mean.freedom),
        effective_samples=np.where(exact, count, mean.effective_samples) * record.block,
    )


def _tare(baselines: Sequence[Level], time_s: float) -> _Tare:
    """Return the tare on the line between the baselines around a time."""
    place = float(np.interp(time_s, [one.time_s for one in baselines], range(len(baselines))))
    before, after, part = baselines[math.floor(place)], baselines[math.ceil(place)], place % 1
    rise = after.mean - before.mean
    slope = rise / (after.time_s - before.time_s) if part else np.zeros_like(rise)
    shares = np.zeros((len(baselines), len(rise)))
    shares[math.floor(place)] = (1 - part) * before.of.scatter_std
    shares[math.ceil(place)] += part * after.of.scatter_std
    return _Tare(before.mean + part * rise, shares, _together(shares, [one.of.freedom for one in baselines]), slope)


def _together(parts: Array, freedom: Sequence[Array]) -> Array:
    """Return the standard uncertainty (k,) of a sum of errors (p, k), widened for its degrees of freedom."""
    return np.asarray(widening(effective_freedom(parts, np.array(freedom))) * np.linalg.norm(parts, axis=0))


def _steady(record: StandSignals, baselines: Sequence[Level], bounds: Window, *, height: float) -> Stretch:
    """Find the steady segment of a step, after subtracting the drift of the load cell as far as it is known."""
    drift = _DRIFT * height + _SEEN * float(_tare(baselines, sum(bounds) / 2).std[record.thrust])
    time_s, value = record.slow.between(*bounds)
    tare = np.interp(time_s, [one.time_s for one in baselines], [one.mean[record.thrust] for one in baselines])
    flat, hold_s = Slow(time_s, value - tare), record.held / record.rate_hz
    return steady_stretch(flat, bounds, drift=drift, wave=_WAVE * height, hold_s=hold_s, height=height)


def _point(
    record: StandSignals, baselines: Sequence[Level], interval: Interval, onset: Onset, stretch: Stretch
) -> tuple[Point, Mean]:
    """Return a step's point with the tare's shares before they are widened, and the mean of its window."""
    running = {motor: command for motor, command in enumerate(interval.commands or (), start=1) if command}
    if len(set(running.values())) > 1:
        raise DataError(f"at {interval.begin_s:.4g} s motors have different commands, {interval.commands}: not a step.")
    command, reason = next(iter(running.values()), None), stretch.reason
    tare = _tare(baselines, (stretch.begin_s + stretch.end_s) / 2)
    found = Mean(*[np.full_like(tare.value, math.nan)] * 5) if reason else _averaged(record, stretch)
    mean = found.value - tare.value
    parts = np.vstack([found.scatter_std, tare.shares])
    std = _together(parts, [found.freedom, *(one.of.freedom for one in baselines)])
    if (command or 0) > DEAD_COMMAND and abs(mean[record.thrust]) < _SEEN * std[record.thrust]:
        reason = f"{_SILENT} at command {command}: {mean[record.thrust]:.2g} +- {std[record.thrust]:.2g} N"
    point = Point(
        command=command,
        motors=tuple(running),
        begin_s=stretch.begin_s,
        end_s=stretch.end_s,
        mean=mean,
        std_of_mean=std,
        effective_samples=found.effective_samples,
        slope=found.slope - tare.slope,
        tare=tare.value,
        tare_shares=tare.shares,
        onset_s=onset.time_s,
        lag_s=onset.lag_s,
        delay_s=None if command is None else onset.time_s - interval.begin_s,
        reason=reason,
    )
    return point, found


def _widened(parts: Sequence[tuple[Point, Mean]]) -> list[Point]:
    """Return the points with what they share of a tare widened alike, so that it stays one error of all of them.

    The factor is the usual one of the points, for the degrees of freedom of window and tare together.
    """
    shared = [np.linalg.norm(point.tare_shares, axis=0) for point, _ in parts]
    together = [np.hypot(mean.scatter_std, tare) for (_, mean), tare in zip(parts, shared, strict=True)]
    factors = [
        point.std_of_mean / std
        for (point, _), std in zip(parts, together, strict=True)
        if np.all(std > 0)  # also false for NaN
    ]
    usual = np.median(factors, axis=0) if factors else 1.0
    return [
        replace(point, std_of_mean=np.hypot(mean.std, usual * tare), tare_shares=usual * point.tare_shares)
        for (point, mean), tare in zip(parts, shared, strict=True)
    ]
