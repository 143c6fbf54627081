"""Relate the microseconds of a Crazyflie's uSD-card log to real time, by the rows or by `clock`.

The timer of a Crazyflie 2.x runs at 84/85 of real time with firmware up to 2026.08. The firmware logs the rows of a
fixed frequency f, a whole number of Hz, every floor(1000/f) ms of other clocks, the scheduler's or the gyro's. These
periods differ by more than 1/85 from each other, but for the shortest ones, which differ by whole milliseconds.
"""

from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

Clock = Literal["true", "84/85"]

MOST_ROWS = 1 << 18  # enough to identify a clock
FIXED_FREQUENCY = "fixedFrequency"  # the event whose rows the scheduler triggers
RATES: dict[Clock, float] = {"true": 1.0, "84/85": 84 / 85}

_PERIODS_MS = np.unique(1000 // np.arange(1, 1001))
_FEWEST_ROWS = 50  # of 1 ms: one that is late by 1 ms changes the interval by 0.24 %
_CLOSE = 4e-3  # of the interval: a gyro's rate is off by 2e-3 in public logs, the slow timer by 1.2e-2
_STATED = "times are the vehicle's microseconds"


class MicrosecondClock(NamedTuple):
    """How many microseconds of the log are a second, and a clause on how that is known."""

    per_s: float
    text: str


def microsecond_clock(stamps: npt.NDArray[np.uint64], given: Clock | None) -> MicrosecondClock | None:
    """Return the given clock, or that of stamps (n,) of the rows of a fixed frequency; None where they fit neither."""
    if given is not None:
        return MicrosecondClock(1e6 * RATES[given], f"{_STATED}, {correction(given)} (`clock` {given})")
    interval_ms = _interval_ms((stamps - stamps[:1]).astype(np.float64) * 1e-3)
    for clock, rate in RATES.items():
        period_ms = _PERIODS_MS[np.argmin(np.abs(interval_ms / rate - _PERIODS_MS))]
        if abs(interval_ms / rate / period_ms - 1) < _CLOSE:
            rows = f"rows of {period_ms} ms lie {interval_ms:.3f} ms apart by them"
            return MicrosecondClock(1e6 * rate, f"{_STATED}, {correction(clock)}: {rows}")
    return None


def correction(clock: Clock) -> str:
    """Return what is done to the times of a clock."""
    return "not corrected" if clock == "true" else "corrected by 85/84"


def _interval_ms(time_ms: npt.NDArray[np.float64]) -> float:
    """Return the interval of rows at times (n,), of which some may be missing, NaN where there are too few."""
    steps = np.diff(time_ms)
    usual = float(np.median(steps)) if len(time_ms) >= _FEWEST_ROWS else 0.0
    if usual <= 0:
        return np.nan
    place = np.concatenate([[0.0], np.cumsum(np.rint(steps / usual))])
    return float(np.polyfit(place, time_ms, 1)[0]) if np.ptp(place) > 0 else np.nan
