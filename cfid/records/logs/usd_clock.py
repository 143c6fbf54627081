"""What the microseconds of a uSD-card log are of real time, by the log itself or by the setting `clock`.

The timer of a Crazyflie 2.x runs at 84/85 of real time with firmware up to 2026.08. The rows of a fixed frequency are
triggered by other clocks, that of the scheduler or of the gyro: by a slow timer they lie 84/85 of whole milliseconds
apart.
"""

from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

Clock = Literal["true", "84/85"]

MOST_ROWS = 1 << 18  # enough to know a clock by
FIXED_FREQUENCY = "fixedFrequency"  # the event whose rows the scheduler triggers

_SLOW = 84 / 85
_FEWEST_ROWS = 100
_CLOSE = 4e-3  # of the interval: a gyro's rate is off by 2e-3 in public logs, the slow timer by 1.2e-2
UNDECIDED = "the log does not show whether they run at 84/85 of real time"
_STATED = "times are the vehicle's microseconds"


class MicrosecondClock(NamedTuple):
    """How long a microsecond of the log is, in s, and a clause on how that is known."""

    second_s: float
    text: str


def microsecond_clock(stamps: npt.NDArray[np.uint64], given: Clock | None) -> MicrosecondClock:
    """Return the clock of stamps (n,) in microseconds of the rows of a fixed frequency, or the given one."""
    if given is not None:
        how = "corrected by 85/84" if given == "84/85" else "not corrected"
        return MicrosecondClock(1e-6 / (_SLOW if given == "84/85" else 1.0), f"{_STATED}, {how} (`clock` {given})")
    interval_ms = _interval_ms(stamps)
    true, slow = (_is_whole(interval_ms / rate) for rate in (1.0, _SLOW))
    if slow and not true:
        return MicrosecondClock(
            1e-6 / _SLOW,
            f"{_STATED}, corrected by 85/84: rows of {interval_ms / _SLOW:.0f} ms lie {interval_ms:.3f} ms apart by "
            "them (`clock` true: not corrected)",
        )
    if true and not slow:
        return MicrosecondClock(1e-6, f"{_STATED}, not corrected: rows lie whole milliseconds apart by them")
    return MicrosecondClock(
        1e-6,
        f"{_STATED}, not corrected: {UNDECIDED}, as on a Crazyflie 2.x with firmware up to 2026.08 (`clock` 84/85)",
    )


def _interval_ms(stamps: npt.NDArray[np.uint64]) -> float:
    """Return the interval of rows of which some may be missing, NaN where there are too few."""
    time_ms = (stamps - stamps[:1]).astype(np.float64) * 1e-3
    steps = np.diff(time_ms)
    usual = float(np.median(steps)) if len(stamps) >= _FEWEST_ROWS else 0.0
    if usual <= 0:
        return np.nan
    place = np.concatenate([[0.0], np.cumsum(np.rint(steps / usual))])
    return float(np.polyfit(place, time_ms, 1)[0]) if np.ptp(place) > 0 else np.nan


def _is_whole(interval_ms: float) -> bool:
    return bool(np.rint(interval_ms) >= 1 and abs(interval_ms / np.rint(interval_ms) - 1) < _CLOSE)
