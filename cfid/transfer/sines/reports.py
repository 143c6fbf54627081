"""Match the reports of a sine's crossings with the requested sine: find the sample of each, or what is wrong.

The vehicle reports its first sample, each crossing of the middle, and, with the value 0, that the motors are off
(C.2.4). cfid's app adds sample and time on board; the module of 2015 does not, and its omega is a float32.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.transfer.sines.plan import SAMPLE_S, Sine

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

_LONGEST = 10_000_000  # samples, five and a half hours
_SLACK_S = 0.3  # the time that the radio may add to a run
_DENSE_S = 0.1  # between crossings that may be confused with each other
_UNRESOLVED_S = 0.03  # between crossings that times cannot separate; the radio may lose most of them
_SAME, _AS_GOOD = 0.4, 0.7  # of a period; of the largest coherence
_EARLY = 10.0  # how many times less likely a report is early than late by the same amount
_LOST, _LOST_DENSE = 0.5, 0.9  # share of reports that may be missing


class Reports(NamedTuple):
    """Reports (m,) of one sine as they arrived: host's time in s, command; sample and microseconds from cfid's app."""

    host_s: Array
    command: Array
    sample: Array | None = None
    vehicle_us: Array | None = None


class Matched(NamedTuple):
    """Reports (k,) with known samples; from the module of 2015 without the last, which comes a sample early."""

    sample: Array
    host_s: Array
    vehicle_us: Array | None


def match_reports(sine: Sine, reports: Reports) -> Matched:
    """Return the samples of a sine's reports.

    Raises DataError when there are too few reports, when the run was cut short, or when they are those of another N or
    l.
    """
    if sine.samples > _LONGEST:
        hours = sine.samples * SAMPLE_S / 3600
        raise DataError(f"N = {sine.samples} would last {hours:.0f} hours: state the N it was played with.")
    commands = sine.commands()
    expected = _expected_samples(sine, commands)
    _check_ends(sine, reports, len(expected) + 1, commands[0])
    place = _places(reports)
    _check_length(sine, place, expected, exact=reports.sample is not None)
    if reports.sample is not None:
        return Matched(reports.sample, reports.host_s, reports.vehicle_us)
    rows, sample = _by_order(sine, place[:-1], expected)
    # An exact middle may be one unit too low on board: the sine then crosses one sample later.
    step = sine.amplitude * sine.omega_rad
    late = (commands[sample] == sine.middle) & (reports.command[rows] - sine.middle > 0.5 * step)
    return Matched((sample + late).astype(np.float64), reports.host_s[rows], None)


def _places(reports: Reports) -> Array:
    """Return the positions of the reports in the sine, in samples: exact, or from their times."""
    if reports.sample is not None:
        return reports.sample
    return np.asarray((reports.host_s - reports.host_s[0]) / SAMPLE_S)


def _expected_samples(sine: Sine, commands: Array) -> Rows:
    before = np.append(0.0, commands[:-1])
    falling = (before > sine.middle) & (commands <= sine.middle)
    return np.flatnonzero(falling | ((before < sine.middle) & (commands >= sine.middle)))


def _check_ends(sine: Sine, reports: Reports, expected: int, first: float) -> None:
    count = len(reports.host_s)
    lost = _LOST if sine.half_period_s > _UNRESOLVED_S else _LOST_DENSE
    if count < max(min(3, expected), (1 - lost) * expected):
        raise DataError(
            f"too few crossings: {counted(count, 'report')}, where a sine with l = {sine.periods} makes {expected}. "
            "Record it again, or look whether its file is that of another run."
        )
    if reports.command[-1] != 0:
        raise DataError(
            f"cut short: its last report is {reports.command[-1]:.0f} and not the 0 that "
            "reports the motors off. Record it again."
        )
    is_first = reports.sample is None or reports.sample[0] == 0
    if is_first and abs(reports.command[0] - first) > 1:
        raise DataError(
            f"it began with {reports.command[0]:.0f}, a sine of amplitude {sine.amplitude:.0f} begins "
            f"with {first:.0f}: state its amplitude, or record it again if its first report was lost."
        )


def _check_length(sine: Sine, place: Array, expected: Rows, *, exact: bool) -> None:
    """Compare the number of samples played, and of periods in them, with N and l."""
    played, missing = float(place[-1]), len(expected) + 1 - len(place)
    lasts = abs(played - sine.samples) <= (0 if exact else _SLACK_S / SAMPLE_S)
    if lasts and missing == 0 and _is_even(sine, place[:-1] - expected):
        return
    rate, fits = _rate_of(place[1:-1], sine)
    if exact:
        fits = bool(np.isin(place[:-1], expected).all())
    if lasts and missing >= 0 and (fits or (not exact and sine.half_period_s < _UNRESOLVED_S)):
        # The radio lost reports; the times of the fastest sines' reports do not show their frequency.
        return
    periods = rate * played / sine.samples
    found = f"it played {played:.0f} samples with {periods:.3g} periods"
    if fits and played < sine.samples:
        raise DataError(f"{found}, where N is {sine.samples} and l {sine.periods}: it was cut short. Record it again.")
    if not lasts and abs(periods - sine.periods) < _SAME + 0.01 * sine.periods:
        raise DataError(f"{found}: its N is not {sine.samples}. State the one it was played with.")
    raise DataError(
        f"{found}: its crossings are not those of l = {sine.periods} and N = {sine.samples}. Were two runs swapped?"
    )


def _is_even(sine: Sine, lag: Array) -> bool:
    """Return whether reports in their order have about the same delay, as far as their times can show."""
    return sine.half_period_s < _DENSE_S or float(np.ptp(lag)) * SAMPLE_S < 0.5 * sine.half_period_s


def _rate_of(crossings: Array, sine: Sine) -> tuple[float, bool]:
    """Return the number of periods in N samples that puts crossings at equal phases, and whether l fits as well.

    Some crossings may be missing; a single one fits any number.
    """
    if len(crossings) < 2:
        return float(sine.periods), True
    counted = sine.samples * (len(crossings) - 1) / (2 * max(float(np.ptp(crossings)), 1.0))
    tried = np.arange(0.8 * counted, 1.8 * counted, min(0.1, counted / 20))
    phases = 4j * np.pi / sine.samples * np.append(tried, sine.periods)[:, None] * crossings
    coherence = np.abs(np.exp(phases).mean(axis=1))
    best = int(coherence[:-1].argmax())
    as_good = tried[0] <= sine.periods <= tried[-1] and coherence[-1] > _AS_GOOD * coherence[best]
    return float(tried[best]), bool(as_good or abs(tried[best] - sine.periods) < _SAME)


def _by_order(sine: Sine, place: Array, expected: Rows) -> tuple[Rows, Rows]:
    """Return rows whose sample is certain, and the samples: all reports in order, except near missing ones."""
    missing = len(expected) - len(place)
    if missing == 0:
        return np.arange(len(place)), expected
    if sine.half_period_s < _UNRESOLVED_S:
        return np.array([0]), expected[:1]  # the others might be confused with their neighbours
    skipped = _skipped(place, expected, missing, half_period=sine.half_period_s / SAMPLE_S)
    # Near a gap it is uncertain which report is missing, over more reports the denser they are.
    reach = max(1, math.ceil(_DENSE_S / sine.half_period_s))
    gaps = np.flatnonzero(np.diff(skipped, prepend=0))
    near = np.abs(np.arange(len(place))[:, None] - gaps + 0.5).min(axis=1, initial=math.inf) < reach
    rows = np.flatnonzero(~near)
    rows = rows if len(rows) else np.array([0])
    return rows, expected[rows + skipped[rows]]


def _skipped(place: Array, expected: Rows, missing: int, *, half_period: float) -> Rows:
    """Return the number of reports lost before each one that arrived, so that all have the most uniform delay.

    The delay itself is varied; for each one, the result is the cheapest path through reports and numbers lost, which
    never decrease.
    """
    late = place[:, None] - np.lib.stride_tricks.sliding_window_view(expected, missing + 1)
    coarse = half_period * np.arange(-1, missing + 1.1, 0.2)
    best = _cheapest(late, coarse)[-1].min(axis=1).argmin()
    fine = coarse[best] + half_period * np.arange(-0.2, 0.21, 0.02)
    costs = _cheapest(late, fine)
    path = costs[1:, int(costs[-1].min(axis=1).argmin())]
    skipped = np.empty(len(place), dtype=np.intp)
    most = missing
    for at in range(len(place) - 1, -1, -1):
        most = int(path[at, : most + 1].argmin())
        skipped[at] = most
    return skipped


def _cheapest(late: Array, tried: Array) -> Array:
    """Return the costs (reports + 1, tried, lost + 1) of the cheapest paths up to each report and number lost."""
    costs = np.zeros((1 + len(late), len(tried), late.shape[1]))
    for place, row in enumerate(late):
        over = row - tried[:, None]
        away = np.where(over > 0, over, -_EARLY * over)
        costs[place + 1] = np.minimum.accumulate(costs[place], axis=1) + away
    return costs
