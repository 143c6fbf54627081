"""Reduce the record of a thrust staircase to one mean for each command, with tare and uncertainty. Fits no map."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError, FitError
from cfid.estimate.blocks import block_means
from cfid.estimate.onsets import Onset, onsets
from cfid.estimate.signals import SMOOTHED_S, Slow, quiet_mean
from cfid.estimate.staircase_points import Level, Point, Staircase
from cfid.estimate.two_levels import other_level
from cfid.estimate.windows import (
    LAGS,
    Interval,
    StandSignals,
    Stretch,
    Words,
    changes_seen,
    commanded_intervals,
    level,
    prepared,
    steady_stretch,
)
from cfid.units import DEAD_COMMAND

Array = npt.NDArray[np.float64]
Window = tuple[float, float]

FZ = 2

# The first two are for a window, relative to a step's height; the last is for a baseline, relative to the highest step.
_DRIFT, _WAVE, _BASELINE_WAVE = 0.05, 0.005, 0.001
_LEAST_HEIGHT = 0.02  # of the highest step: limits for lower steps do not become narrower
_FEWEST_IN_BASELINE = 2  # readings: an uncertain tare is better than none
_SEEN, _SILENT = 3.0, "no thrust is seen"  # the first is in standard uncertainties
_DROPS_OUT = ": an instrument that drops out or repeats a reading"
_UNDER_WAY = "it was under way when the record began"


class NeverRanError(DataError):
    """A record does not show any running motor."""


class NoBaselineError(DataError):
    """A record starts with a command."""


def reduce_staircase(
    *,
    time_s: Array,
    channels: Array,
    command_time_s: Array | None = None,
    commands: Array | None = None,
    status: Words | None = None,
    thrust: int = FZ,
    lag_s: float | None = None,
    window_override: Sequence[Window | None] | None = None,
    tared: bool = True,
) -> Staircase:
    """Reduce channels (n, k) in any unit at times (n,); the channel `thrust` shows where the motors run.

    Commands (m, 4) hold from `command_time_s` (m,) on, by the same clock; without them, changes of thrust are searched.
    `lag_s` is the rotors' time constant, if it need not be found. `window_override` has an entry for each step: a given
    window, or None where it is to be found. `status` (n,) are the load cell's words. What `tared` channels show in
    pauses is subtracted; other channels, such as speeds, are zero where nothing runs.

    Raises DataError for a record that is too short, out of order, not finite or faulty, that has no baseline, or that
    shows no motor running.
    """
    record = prepared(time_s, channels, status=status, thrust=thrust)
    if command_time_s is None or commands is None:
        intervals = changes_seen(record.slow)
    else:
        first_s, last_s = record.slow.time_s[[0, -1]].tolist()
        intervals = commanded_intervals(command_time_s, commands, begin_s=first_s, end_s=last_s)
    return _reduced(record, intervals, lag_s=lag_s, windows=window_override, tared=tared)


def reduce_single(
    *,
    time_s: Array,
    channels: Array,
    command: int | None = None,
    motors: tuple[int, ...] = (),
    status: Words | None = None,
    thrust: int = FZ,
    lag_s: float | None = None,
    window: Window | None = None,
) -> Staircase:
    """Reduce a record of one command between two pauses, as in the thesis; otherwise as `reduce_staircase`.

    Raises FitError when more than one step is found, unless a window selects one.
    """
    record = prepared(time_s, channels, status=status, thrust=thrust)
    intervals = changes_seen(record.slow)
    steps = [interval for interval in intervals if not interval.pause]
    meant = [window is None or step.begin_s <= sum(window) / 2 <= step.end_s for step in steps]
    if steps and sum(meant) != 1:
        seen = ", ".join(f"{step.begin_s:.4g} to {step.end_s:.4g} s" for step in steps)
        rows = record.held * record.block
        few = (
            f" Readings repeat in about {rows} rows: the scatter of so few may look like steps."
            if record.held > 1
            else ""
        )
        raise FitError(f"expected one step between two pauses, found {seen}.{few} Give its window, or the command log.")
    found = _reduced(record, intervals, lag_s=lag_s, windows=[window if one else None for one in meant])
    return replace(found, points=(replace(found.points[meant.index(True)], command=command, motors=motors),))


def mean_in_windows(points: Sequence[Point], time_s: Array, value: Array) -> Array:
    """Return the means (p,) of another instrument's `value` (n,) at times (n,), in the windows of points.

    By the clock of the commands, the windows are earlier by the delay of the thrust. NaN where nothing was recorded.
    """
    late_s = np.array([point.delay_s or 0.0 for point in points])
    begin, end = (np.array([getattr(point, name) for point in points]) - late_s for name in ("begin_s", "end_s"))
    first, last = np.searchsorted(time_s, begin), np.searchsorted(time_s, end, side="right")
    windows = [value[i:j] for i, j in zip(first, last, strict=True)]
    return np.array([window.mean() if len(window) else math.nan for window in windows])


def _reduced(
    record: StandSignals,
    intervals: Sequence[Interval],
    *,
    lag_s: float | None,
    windows: Sequence[Window | None] | None,
    tared: bool = True,
) -> Staircase:
    steps = [i for i, interval in enumerate(intervals) if not interval.pause]
    if not steps:
        raise NeverRanError("the motors never run in this record: no command, or no change of thrust above its noise.")
    by_hand = [None] * len(steps) if windows is None else windows
    if len(by_hand) != len(steps):
        raise DataError(
            f"{counted(len(by_hand), 'window is', 'windows are')} given for {len(steps)} steps: one each, or None."
        )
    levels = np.array([level(record.slow, interval.begin_s, interval.end_s) for interval in intervals])
    rest = next((levels[i] for i, interval in enumerate(intervals) if interval.pause), levels[0])
    begun = onsets(record.slow, intervals, baseline=rest, lag_s=lag_s)
    bounds = _bounds(intervals, begun)
    heights = np.abs(levels - rest)
    baselines = _baselines(
        record,
        [bounds[i] for i in range(len(bounds)) if i not in steps],
        wave=_BASELINE_WAVE * heights.max(),
        tared=tared,
    )
    if not tared:
        baselines = [one._replace(mean=0 * one.mean, std=0 * one.std, slope=0 * one.slope) for one in baselines]
    driven = bool(baselines) and baselines[0].time_s > bounds[steps[0]][0]
    if not baselines or (driven and steps == [0]):
        raise NoBaselineError("no baseline before the first command: log for some seconds before the motors start.")
    points = []
    for i, window in zip(steps, by_hand, strict=True):
        height = max(heights[i], _LEAST_HEIGHT * heights.max())
        stretch = Stretch(*window) if window else _steady(record, baselines, bounds[i], height=height)
        tare = float(_tare(baselines, sum(stretch[:2]) / 2)[0][record.thrust])
        stretch = stretch._replace(reason=_UNDER_WAY if not i else stretch.reason or _mixed(record, stretch, tare))
        points.append(_point(record, baselines, intervals[i], begun[max(i - 1, 0)], stretch))
    reasons = [point.reason for point in points if (point.command or 0) > DEAD_COMMAND]
    if reasons and all(reason.startswith(_SILENT) for reason in reasons):
        raise DataError(
            f"no motor is felt: {reasons[-1]}. Is the vehicle armed, its battery charged? Where motors turned, the "
            "load cell did not feel them: see to its cable, its mount, and the axis of thrust."
        )
    _refuse_two_levels(points)
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


def _refuse_two_levels(points: Sequence[Point]) -> None:
    """Raise DataError where half of the steps mix two levels: in the others, this may only be harder to see."""
    mixed = [point for point in points if point.reason.endswith(_DROPS_OUT)]
    if 2 * len(mixed) >= len(points) and mixed:
        at = "" if mixed[-1].command is None else f" at command {mixed[-1].command}"
        raise DataError(
            f"the readings are of two levels in {len(mixed)} of {counted(len(points), 'step')}:{at} "
            f"{mixed[-1].reason}. Its mean is of neither: check its wires and its amplifier, and record again."
        )


def _bounds(intervals: Sequence[Interval], begun: Sequence[Onset]) -> list[Window]:
    """Return where each interval may be steady: from five lags after its onset to just before the next onset."""
    begins = [intervals[0].begin_s, *(onset.time_s + LAGS * onset.lag_s for onset in begun)]
    ends = [*(onset.time_s - SMOOTHED_S / 2 for onset in begun), intervals[-1].end_s]
    return list(zip(begins, ends, strict=True))


def _baselines(record: StandSignals, bounds: Sequence[Window], *, wave: float, tared: bool) -> list[Level]:
    """Average the baselines of two readings or more, including those of a drifting load cell.

    Raises DataError if each of the baselines to subtract mixes readings of two levels.
    """
    limits = {"drift": math.inf, "wave": wave, "hold_s": record.held / record.rate_hz}
    found = [steady_stretch(record.slow, each, **limits, fewest=_FEWEST_IN_BASELINE) for each in bounds]
    steady = [one for one in found if not one.reason]
    mixed = [_mixed(record, one) if tared else "" for one in steady]
    if steady and all(mixed):
        raise DataError(f"in the pauses {mixed[0]}. Check its wires and its amplifier, and record again.")
    return [_averaged(record, one) for one, reason in zip(steady, mixed, strict=True) if not reason]


def _mixed(record: StandSignals, stretch: Stretch, tare: float = 0.0) -> str:
    """Return why the readings of a steady segment, less a tare, have no mean, "" if they have one level."""
    first, last = np.searchsorted(record.time_s, stretch[:2])
    off = other_level(record.value[record.thrust, first:last] - tare, finest=float(record.finest[record.thrust]))
    return f"{off}{_DROPS_OUT}" if off else ""


def _averaged(record: StandSignals, stretch: Stretch) -> Level:
    first, last = np.searchsorted(record.time_s, stretch[:2])
    value = record.value[:, first:last]
    value = value if record.held == 1 else block_means(value, length=record.held)
    if value.shape[1] < _FEWEST_IN_BASELINE:
        raise DataError(f"fewer than two readings from {stretch.begin_s:.4g} to {stretch.end_s:.4g} s: no mean.")
    mean, std, slope, samples = quiet_mean(value, rate_hz=record.rate_hz / record.held)
    exact = std < record.finest
    std, samples = np.where(exact, record.finest, std), np.where(exact, value.shape[1], samples)
    return Level((stretch.begin_s + stretch.end_s) / 2, mean, std, slope, samples * record.block)


def _tare(baselines: Sequence[Level], time_s: float) -> tuple[Array, Array, Array]:
    """Return the tare (k,) on the line between the baselines around a time, its shares (r, k) and its slope."""
    place = float(np.interp(time_s, [one.time_s for one in baselines], range(len(baselines))))
    before, after, part = baselines[math.floor(place)], baselines[math.ceil(place)], place % 1
    rise = after.mean - before.mean
    slope = rise / (after.time_s - before.time_s) if part else np.zeros_like(rise)
    shares = np.zeros((len(baselines), len(rise)))
    shares[math.floor(place)] = (1 - part) * before.std
    shares[math.ceil(place)] += part * after.std
    return before.mean + part * rise, shares, slope


def _steady(record: StandSignals, baselines: Sequence[Level], bounds: Window, *, height: float) -> Stretch:
    """Find the steady segment of a step, after subtracting the drift of the load cell as far as it is known."""
    drift = _DRIFT * height + _SEEN * float(np.linalg.norm(_tare(baselines, sum(bounds) / 2)[1][:, record.thrust]))
    time_s, value = record.slow.between(*bounds)
    tare = np.interp(time_s, [one.time_s for one in baselines], [one.mean[record.thrust] for one in baselines])
    flat, hold_s = Slow(time_s, value - tare), record.held / record.rate_hz
    return steady_stretch(flat, bounds, drift=drift, wave=_WAVE * height, hold_s=hold_s, height=height)


def _point(
    record: StandSignals, baselines: Sequence[Level], interval: Interval, onset: Onset, stretch: Stretch
) -> Point:
    command, motors = _command(interval)
    tare, shares, drift = _tare(baselines, (stretch.begin_s + stretch.end_s) / 2)
    std_of_tare = np.linalg.norm(shares, axis=0)
    found = Level(math.nan, *[np.full_like(tare, math.nan)] * 4) if stretch.reason else _averaged(record, stretch)
    mean, std, reason = found.mean - tare, np.hypot(found.std, std_of_tare), stretch.reason
    if (command or 0) > DEAD_COMMAND and abs(mean[record.thrust]) < _SEEN * std[record.thrust]:
        reason = f"{_SILENT} at command {command}: {mean[record.thrust]:.2g} +- {std[record.thrust]:.2g} N"
    return Point(
        command=command,
        motors=motors,
        begin_s=stretch.begin_s,
        end_s=stretch.end_s,
        mean=mean,
        std_of_mean=std,
        effective_samples=found.effective_samples,
        slope=found.slope - drift,
        tare=tare,
        std_of_tare=std_of_tare,
        tare_shares=shares,
        onset_s=onset.time_s,
        lag_s=onset.lag_s,
        delay_s=None if command is None else onset.time_s - interval.begin_s,
        reason=reason,
    )


def _command(interval: Interval) -> tuple[int | None, tuple[int, ...]]:
    """Return the one command of the running motors, and the numbers of these motors."""
    running = {motor: command for motor, command in enumerate(interval.commands or (), start=1) if command}
    if len(set(running.values())) > 1:
        raise DataError(f"at {interval.begin_s:.4g} s motors have different commands, {interval.commands}: not a step.")
    return next(iter(running.values()), None), tuple(running)
