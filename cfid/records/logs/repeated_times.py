"""Refuse logs whose rows repeat their times, since they show neither lags nor rates."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError

Array = npt.NDArray[np.float64]

_MOST = 0.1  # of rows
_EVEN = 0.5  # of the times, which may have another number of rows than usual where times are rounded
_TURNS = "Where several recordings take turns, write the rows of each into a file of its own."


def refuse_repeated_times(path: Path, time_s: Array) -> None:
    """Raise DataError where many times (n,) repeat the one before: they are rounded, or of two recordings."""
    steps_s = np.diff(time_s)
    repeated = int(np.count_nonzero(steps_s == 0))
    if repeated <= _MOST * len(time_s):
        return
    text = f"{path}: {repeated} of {len(time_s)} rows of commands repeat the time of the one before"
    begins = np.flatnonzero(np.diff(time_s, prepend=-np.inf))
    rows = np.diff(begins)[:-1]  # the first and the last time may have more rows outside the log
    if len(rows) > 1 and np.median(rows) > 1 and np.mean(np.abs(rows - np.median(rows)) <= 1) > 1 - _EVEN:
        step_s = float(np.median(steps_s[steps_s > 0]))
        rate_hz = (len(time_s) - 1) / float(time_s[-1] - time_s[0])
        raise DataError(
            f"{text}. Where times are rounded to {step_s:.3g} s, write more of their digits, or give a table's "
            f"`rate_hz` ({rate_hz:.4g} on average). {_TURNS}"
        )
    raise DataError(f"{text}. {_TURNS} Delete rows that were written twice.")
