"""Relate the times of a uSD-card log, or of a table made of one, to real time, by the rows or by `clock`.

The timer of a Crazyflie 2.x runs at 84/85 of real time with firmware up to 2026.08. The rows of a fixed frequency are
triggered by other clocks, that of the scheduler or of the gyro: a slow timer shows them 84/85 of whole milliseconds
apart.
"""

from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

Clock = Literal["true", "84/85"]

MOST_ROWS = 1 << 18  # enough to identify a clock
FIXED_FREQUENCY = "fixedFrequency"  # the event whose rows the scheduler triggers

_SLOW = 84 / 85
_FEWEST_ROWS = 100
_CLOSE = 4e-3  # of the interval: a gyro's rate is off by 2e-3 in public logs, the slow timer by 1.2e-2
UNDECIDED = "the log does not show whether they run at 84/85 of real time"
_STATED = "times are the vehicle's microseconds"


class MicrosecondClock(NamedTuple):
    """How many microseconds of the log are a second, and a clause on how that is known."""

    per_s: float
    text: str


def microsecond_clock(stamps: npt.NDArray[np.uint64], given: Clock | None) -> MicrosecondClock:
    """Return the given clock, or that of stamps (n,) in microseconds of the rows of a fixed frequency."""
    if given is not None:
        return MicrosecondClock(1e6 * _rate(given), f"{_STATED}, {_how(given)} (`clock` {given})")
    interval_ms = _interval_ms((stamps - stamps[:1]).astype(np.float64) * 1e-3)
    true, slow = _is_whole(interval_ms), _is_slow(interval_ms)
    if slow:
        return MicrosecondClock(1e6 * _SLOW, f"{_STATED}, {_corrected(interval_ms)}")
    if true:
        return MicrosecondClock(1e6, f"{_STATED}, not corrected: rows lie whole milliseconds apart by them")
    return MicrosecondClock(
        1e6,
        f"{_STATED}, not corrected: {UNDECIDED}, as on a Crazyflie 2.x with firmware up to 2026.08 (`clock` 84/85)",
    )


def decoded_clock(time_s: npt.NDArray[np.float64], given: Clock | None) -> tuple[float, str]:
    """Return the length of a second in a vehicle's table with times (n,), and a clause where it is not 1.

    A program that decodes a uSD-card log leaves its clock as it is; a table without a fixed frequency may have any.
    """
    if given is not None:
        return 1 / _rate(given), f"{_how(given)} (`clock` {given})"
    interval_ms = _interval_ms(1e3 * (time_s - time_s[:1]))
    return (1 / _SLOW, _corrected(interval_ms)) if _is_slow(interval_ms) else (1.0, "")


def _rate(clock: Clock) -> float:
    return _SLOW if clock == "84/85" else 1.0


def _how(clock: Clock) -> str:
    return "corrected by 85/84" if clock == "84/85" else "not corrected"


def _corrected(interval_ms: float) -> str:
    return (
        f"corrected by 85/84: rows of {interval_ms / _SLOW:.0f} ms lie {interval_ms:.3f} ms apart by them (`clock` "
        "true: not corrected)"
    )


def _interval_ms(time_ms: npt.NDArray[np.float64]) -> float:
    """Return the interval of rows at times (n,), of which some may be missing, NaN where there are too few."""
    steps = np.diff(time_ms)
    usual = float(np.median(steps)) if len(time_ms) >= _FEWEST_ROWS else 0.0
    if usual <= 0:
        return np.nan
    place = np.concatenate([[0.0], np.cumsum(np.rint(steps / usual))])
    return float(np.polyfit(place, time_ms, 1)[0]) if np.ptp(place) > 0 else np.nan


def _is_whole(interval_ms: float) -> bool:
    return bool(np.rint(interval_ms) >= 1 and abs(interval_ms / np.rint(interval_ms) - 1) < _CLOSE)


def _is_slow(interval_ms: float) -> bool:
    """Return whether rows lie 84/85 of whole milliseconds apart, and not whole ones."""
    return _is_whole(interval_ms / _SLOW) and not _is_whole(interval_ms)
