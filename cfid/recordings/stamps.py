"""Time samples by the stamps of the device that took them: a busy computer receives them late, never early."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cfid.findings import Finding, finding
from cfid.recordings.outliers import outliers
from cfid.recordings.recording import Array, Series
from cfid.records.rig_file import STAMP

CLOCK_CODES = ("stamps-no-clock", "stamps-wrong")  # of findings of `by_stamps`

_PARTS, _FEWEST_OF_A_PART = 12, 8  # of a recording, each with one quickest arrival
_FEWEST_PARTS = 4
_WRONG_S, _MOST_WRONG = 0.1, 0.1  # by which a stamp is off those around it; with more than this share, no clock
_LARGEST_SKEW = 1e-3  # of two crystals, with margin: beyond it, stamps count something other than microseconds
_LARGEST_SCATTER_S = 2e-3  # of the quickest arrivals about a line: beyond it the device's clock jumped


class StampedTimes(NamedTuple):
    """Times (n,) in s on this computer's clock, and the relative standard uncertainty of their scale."""

    time_s: Array
    scale_std: float


def by_stamps(series: Series) -> tuple[Series, float]:
    """Return a series of cfid's own with times by its column of stamps, and the uncertainty of their scale.

    Rows whose stamp is wrong are left out. Times stay those of arrival, with a finding, where stamps are no steady
    clock in microseconds.
    """
    if STAMP not in series.names or series.time_s is None:
        return series, 0.0
    findings = list[Finding]()
    stamp_us = series.column(STAMP).values
    wrong = outliers(series.time_s - 1e-6 * stamp_us, _WRONG_S, most_share=_MOST_WRONG)
    if wrong.any():
        line = series.line_number(int(np.argmax(wrong)))
        findings.append(finding("stamps-wrong", count=int(wrong.sum()), rows=series.rows, line=line))
        series = series.kept(~wrong)
        stamp_us = series.column(STAMP).values
    arrival_s = np.zeros(0) if series.time_s is None else series.time_s
    times = stamped_times(arrival_s, stamp_us)
    kept = series.findings
    if times is not None:
        begin_s = None if series.begin_s is None else series.begin_s + float(times.time_s[0])
        series = replace(series, time_s=times.time_s - times.time_s[0], begin_s=begin_s)
        kept = tuple(one for one in kept if one.code != "time-repeats")
    elif len(stamp_us) >= _FEWEST_OF_A_PART * _FEWEST_PARTS:
        device_s, here_s = 1e-6 * float(stamp_us[-1] - stamp_us[0]), float(arrival_s[-1] - arrival_s[0])
        findings.append(finding("stamps-no-clock", device_s=device_s, here_s=here_s))
    name = f"{series.path.resolve().parent.name}/{series.path.name}"
    series = replace(series, findings=(*kept, *(one.at(name) for one in findings)))
    return series, 0.0 if times is None else times.scale_std


def stamped_times(arrival_s: Array, stamp_us: Array) -> StampedTimes | None:
    """Return when samples (n,) were taken, by a line through the quickest arrivals over the device's stamps.

    The quickest arrivals at both ends may differ by the lateness of the median arrival, which makes the line's slope
    uncertain. None where the stamps are not a steady clock in microseconds: after a loss of power, a new count starts.
    """
    parts = min(len(arrival_s) // _FEWEST_OF_A_PART, _PARTS)
    device_s = 1e-6 * (stamp_us - stamp_us[0])
    span_s = float(device_s[-1])
    if parts < _FEWEST_PARTS or not np.all(np.diff(stamp_us) > 0):
        return None
    late_s = arrival_s - arrival_s[0] - device_s
    quickest = np.array([rows[late_s[rows].argmin()] for rows in np.array_split(np.arange(len(late_s)), parts)])
    skew, level_s = np.polyfit(device_s[quickest], late_s[quickest], 1)
    above_s = late_s - level_s - skew * device_s
    if abs(skew) > _LARGEST_SKEW or np.ptp(above_s[quickest]) > _LARGEST_SCATTER_S:
        return None
    median_s = float(np.median(above_s) - above_s.min())
    return StampedTimes(arrival_s + above_s.min() - above_s, median_s / span_s)
