"""Notice during the recording of a swing that nothing was released."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from cfid.wire.rls import RLS_13BIT_IN_22, STEPS_PER_TURN, decode_words

_RELEASED_WITHIN_S = 20.0
_MOVED_DEG = 4.0  # between extremes: a usable swing starts with more


class Release:
    """Look for motion in an encoder's rows, by extremes of the angle, in bounded memory; report at most once."""

    def __init__(self, turn: float | str) -> None:
        """Set one turn in the unit of the recorded angle, or as the name rig.toml has for that unit."""
        self._words = turn == RLS_13BIT_IN_22
        self._turn = float(STEPS_PER_TURN) if self._words else float(turn)
        self._begin_s = self._last = math.nan
        self._place = self._least = self._most = 0.0  # from the first sample, across turns
        self._done = False

    def __call__(self, device: str, columns: Sequence[Any]) -> str:
        """Add new rows of the encoder, `t` and the angle; return what is wrong, "" for nothing."""
        if self._done or device != "encoder":
            return ""
        counts = np.asarray(columns[1])
        if self._words:
            counts = decode_words(counts.astype(np.int64)).position
        first = counts[0] if math.isnan(self._last) else self._last
        steps = np.diff(counts, prepend=first)
        moved = self._place + np.cumsum((steps + self._turn / 2) % self._turn - self._turn / 2)
        self._place, self._last = float(moved[-1]), float(counts[-1])
        self._least, self._most = min(self._least, float(moved.min())), max(self._most, float(moved.max()))
        if math.isnan(self._begin_s):
            self._begin_s = float(columns[0][0])
        between_deg = 360 * (self._most - self._least) / self._turn
        if between_deg >= _MOVED_DEG:
            self._done = True
        elif columns[0][-1] - self._begin_s >= _RELEASED_WITHIN_S:
            self._done = True
            return (
                f"no release within {_RELEASED_WITHIN_S:.0f} s: the angle moved by {between_deg:.1f} degrees, and a "
                f"swing has {_MOVED_DEG:g} or more. Is the encoder coupled to the axis?"
            )
        return ""
