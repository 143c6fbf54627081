"""Gaps of rows in which a command changed unseen: the speeds that follow are left out until its effect has decayed."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.findings import Finding, note
from cfid.motors.lag.model import InputLag, LogSegment
from cfid.motors.lag.plausibility import without

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

_LONG, _LONG_S = 2.5, 5e-3  # usual intervals between rows, and seconds: shorter gaps hardly affect rotors
_USUAL = 0.1  # of the intervals: where more are long, rows are irregular, such as one for each change
_FORGOTTEN = (3.0, 2.0, 1.0)  # time constants left out after a gap; fewer where that would be more than _MOST
_MOST = 0.5  # of the speeds


class Gaps(NamedTuple):
    """The number of gaps between rows, their total length, and the longest, in s."""

    number: int = 0
    total_s: float = 0.0
    longest_s: float = 0.0

    def and_of(self, time_s: Array, value: Array) -> "Gaps":
        """Return these gaps plus those between rows at times (n,) before or after which commands (n,) drive a rotor."""
        on = (value[1:] > 0) | (value[:-1] > 0)
        more_s = np.diff(time_s)[gaps(time_s) & on]
        longest_s = float(more_s.max(initial=self.longest_s))
        return Gaps(self.number + len(more_s), self.total_s + float(more_s.sum()), longest_s)

    def findings(self) -> tuple[Finding, ...]:
        """Return a note where there are gaps."""
        if not self.number:
            return ()
        text = (
            f"{counted(self.number, 'gap')} of rows, {self.total_s:.2g} s together, the longest "
            f"{1e3 * self.longest_s:.3g} ms: speeds are left out for up to {_FORGOTTEN[0]:g} time constants after "
            "those in which a command changed."
        )
        return (note("lag-rows-missing", text, "dynamics.*"),)


def gaps(time_s: Array) -> Flags:
    """Return which intervals (n - 1,) between rows at times (n,) are much longer than usual."""
    steps_s = np.diff(time_s)
    long = steps_s > max(_LONG * float(np.median(steps_s)), _LONG_S) if len(steps_s) else np.zeros(0, bool)
    return long if len(long) and np.mean(long) <= _USUAL else np.zeros(len(long), bool)


def without_after_gaps(pieces: Sequence[LogSegment], lag: InputLag) -> list[LogSegment]:
    """Return pieces without the speeds within some time constants after a gap in which a drive changed."""
    for forgotten in _FORGOTTEN:
        long_s = lag.delay_s + forgotten * max(lag.rising_s, lag.falling_s)
        flags = [_follow(piece.measured.time_s, piece.gaps_s, long_s) for piece in pieces]
        if np.mean(np.concatenate(flags)) <= _MOST:
            break
    left = without([piece.measured for piece in pieces], np.concatenate(flags))
    each = zip(pieces, left, strict=True)
    return [piece._replace(measured=one, gaps_s=np.zeros((0, 2))) for piece, one in each]


def _follow(time_s: Array, gaps_s: Array, long_s: float) -> Flags:
    """Return which times (n,) lie in gaps (k, 2), each from start to end, or follow one by less than `long_s`."""
    from_s, to_s = gaps_s.T
    at = np.searchsorted(from_s, time_s) - 1
    if not len(gaps_s):
        return np.zeros(len(time_s), bool)
    return np.asarray((at >= 0) & (time_s < to_s[np.maximum(at, 0)] + long_s))
