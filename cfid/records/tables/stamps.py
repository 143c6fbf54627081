"""Time samples by the stamps of the device that took them: a busy computer receives them late, never early."""

from typing import NamedTuple

import numpy as np

from cfid.counted import counted
from cfid.records.tables.lone import Rows, lone_readings
from cfid.records.tables.table import Array, CsvTable

_PARTS, _FEWEST_OF_A_PART = 12, 8  # of a recording, each with one quickest arrival
_FEWEST_PARTS = 4
_WRONG_S, _MOST_WRONG = 0.1, 0.1  # by which a stamp is off those around it; with more than this share, no clock
_MOST_RESTARTS = 3  # of a board in a recording: a count that starts anew more often is not a clock
_ALIKE = 0.05  # of the time here, within which a count of milliseconds agrees with it
_LARGEST_SKEW = 1e-3  # of two crystals, with margin: beyond it, stamps count something other than microseconds
_LARGEST_SCATTER_S = 2e-3  # of the quickest arrivals about a line: beyond it the device's clock jumped


class StampedTimes(NamedTuple):
    """Times (n,) in s on this computer's clock, and the relative standard uncertainty of their scale."""

    time_s: Array
    scale_std: float


class StampedRows(NamedTuple):
    """A run's table and its values (n, k) without rows whose stamp is wrong, times by the other stamps, and notes.

    `times` is None where the device's clock shows none.
    """

    table: CsvTable
    values: Array
    times: StampedTimes | None
    notes: tuple[str, ...]


def stamped_rows(table: CsvTable, values: Array, column: str) -> StampedRows:
    """Return the rows (n, k) of a run, whose first value is the time of arrival, with times by a column of stamps."""
    if column not in table.names:
        return StampedRows(table, values, None, ())
    stamp_us = table.numbers([column])[:, 0]
    wrong, notes = wrong_stamps(values[:, 0], stamp_us), tuple[str, ...]()
    if len(wrong):
        line, are = table.line_of_row(int(wrong[0])), "is" if len(wrong) == 1 else "are"
        what = f"{counted(len(wrong), 'row')} of {len(values)} whose {column} is off that of the rows around"
        notes = (f"{what} (first: line {line}) {are} left out: did the line lose a letter? Send a checksum with it.",)
        table, values, stamp_us = table.without(wrong), np.delete(values, wrong, axis=0), np.delete(stamp_us, wrong)
    if len(anew := restarts(stamp_us)):
        line, often = table.line_of_row(int(anew[0])), "" if len(anew) == 1 else f" {len(anew)} times"
        notes += (
            f"{column} starts anew{often} (first: line {line}, from {stamp_us[anew[0] - 1]:.0f} to "
            f"{stamp_us[anew[0]]:.0f}): the device was restarted. Times on both sides are joined by when rows arrived.",
        )
        stamp_us = _joined(values[:, 0], stamp_us, anew)
    times = stamped_times(values[:, 0], stamp_us)
    if times is None and len(stamp_us) >= _FEWEST_OF_A_PART * _FEWEST_PARTS:
        gone_s, here_s = 1e-6 * (stamp_us[-1] - stamp_us[0]), values[-1, 0] - values[0, 0]
        in_ms = abs(1e3 * gone_s - here_s) < _ALIKE * here_s
        cause = "it counts milliseconds, name it device_ms in rig.toml" if in_ms else "it jumps, or counts another unit"
        notes += (
            f"{column} is no steady clock in microseconds, it went {gone_s:.4g} s in {here_s:.4g} s: {cause}. "
            "Times are those of arrival, which a busy computer makes late.",
        )
    return StampedRows(table, values, times, notes)


def restarts(stamp_us: Array) -> Rows:
    """Return the places of the first samples (n,) after a restart of the device, which sets its stamps back.

    There are none where restarts are too many, or where a side has too few samples to join them.
    """
    anew = np.flatnonzero(np.diff(stamp_us) < 0) + 1
    shortest = np.diff(np.r_[0, anew, len(stamp_us)]).min()
    sure = len(anew) <= _MOST_RESTARTS and shortest >= _FEWEST_OF_A_PART * _FEWEST_PARTS
    return anew if sure else anew[:0]


def _joined(arrival_s: Array, stamp_us: Array, anew: Rows) -> Array:
    """Return stamps (n,) that continue over each restart, so that the quickest arrivals on both sides are as late."""
    late_us = 1e6 * (arrival_s - arrival_s[0]) - stamp_us
    shifts = [float(part.min()) for part in np.split(late_us, anew)]
    return np.asarray(stamp_us + np.repeat(shifts, np.diff(np.r_[0, anew, len(stamp_us)])))


def wrong_stamps(arrival_s: Array, stamp_us: Array) -> Rows:
    """Return the places of samples (n,) whose stamp alone, compared with its arrival, is off those around it."""
    wrong = lone_readings(arrival_s - 1e-6 * stamp_us, _WRONG_S)
    return wrong if len(wrong) <= _MOST_WRONG * len(stamp_us) else wrong[:0]


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
