"""Turns of an axis where samples are missing, from its speed on both sides."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError

Array = npt.NDArray[np.float64]

_JUMP_RAD = math.pi / 2  # largest difference between one step and the next: no axis turns like that
_EVEN = 1.5  # times the usual step: beyond, samples are missing
_BESIDE = 7  # samples on each side that show the speed
_LONGEST_S = 0.5  # longest time that a speed is known to last
_APART_S = 5.0  # time that separates two recordings in one file
_EDGES_SHARE = 0.95  # least share of one-count steps in rows of an encoder's edges
_FEW_LOST = 3.5  # counts between two such rows, as a few may be lost, in which the axis hardly turned
_BEGIN_S = 0.05  # by which a fall may begin before it is fast


def counted_turns(time_s: Array, angle_rad: Array) -> tuple[Array, Sequence[int]]:
    """Return an angle (n,) with the turns that its speed shows where samples are missing, and the gaps that stay open.

    A reading within a turn does not show how many turns passed while none was taken. The speeds on both sides of the
    gap do, where they agree within half a turn; other gaps are returned by the index of the sample before them. Where
    an encoder writes a row at each of its counts, the axis hardly turned between two rows that are a few counts apart.
    Raises DataError for a gap that no recording of a fall has.
    """
    step_s, step = np.diff(time_s), np.diff(angle_rad)
    if step_s.max() > _APART_S:
        begin_s = time_s[int(np.argmax(step_s))]
        raise DataError(
            f"nothing was recorded for {step_s.max():.3g} s after the first {begin_s:.3g} s. Was the clock set? Fit a "
            "file of one part."
        )
    still_rad = _FEW_LOST * count_of_edges(angle_rad)
    even = step_s < _EVEN * np.median(step_s)
    speed = np.where(even, step / step_s, np.nan)
    turns, unclear = np.zeros(len(step)), []
    for place in np.flatnonzero(~even).tolist():
        before, after = _usual(speed[max(place - _BESIDE, 0) : place]), _usual(speed[place + 1 :][:_BESIDE])
        if step_s[place] > _LONGEST_S or abs(after - before) * step_s[place] > math.pi:
            if abs(step[place]) > still_rad:
                unclear.append(place)
        else:
            turns[place] = np.rint(((before + after) / 2 * step_s[place] - step[place]) / (2 * math.pi))
    return angle_rad + 2 * math.pi * np.concatenate([[0.0], np.cumsum(turns)]), unclear


def check_turns(time_s: Array, angle_rad: Array, unclear: Sequence[int], from_s: float, to_s: float) -> None:
    """Raise DataError where turns are miscounted between two times of a fall: the angle (n,) jumps or a gap is long."""
    late = [place for place in unclear if time_s[place] < to_s and time_s[place + 1] > from_s - _BEGIN_S]
    if late:
        begin, end = time_s[late[0]], time_s[late[0] + 1]
        raise DataError(
            f"samples are missing from {begin:.2f} to {end:.2f} s, within the fall: its turns cannot be counted. End "
            "what else keeps the computer busy."
        )
    fall = (time_s[1:-1] > from_s) & (time_s[1:-1] < to_s)
    step_s = np.diff(time_s)
    even = np.maximum(step_s[1:], step_s[:-1]) < _EVEN * np.median(step_s)
    jumps = np.flatnonzero(fall & even & (np.abs(np.diff(angle_rad, 2)) > _JUMP_RAD))
    if len(jumps):
        raise DataError(
            f"the angle jumps by more than a quarter of a turn at {time_s[jumps[0] + 1]:.2f} s, within the fall: its "
            "turns cannot be counted. See to the encoder's cable."
        )


def count_of_edges(angle_rad: Array) -> float:
    """Return an encoder's count in radians where rows (n,) are its changes by one count; 0 where it is polled.

    A few rows may have been lost, or repeat a count where the axis turned back.
    """
    steps = np.abs(np.diff(angle_rad))
    count = float(np.median(steps))
    return count if np.mean(np.isclose(steps, count)) > _EDGES_SHARE else 0.0


def _usual(speed: Array) -> float:
    known = speed[np.isfinite(speed)]
    return float(np.median(known)) if len(known) else 0.0
