"""Notice during the recording of a swing that nothing was released."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from cfid.wire.rls import turns_of

_RELEASED_WITHIN_S = 20.0
_MOVED_DEG = 4.0  # between extremes: a usable swing starts with more


class Release:
    """Look for motion in an encoder's rows, by extremes of the angle, in bounded memory; report at most once."""

    def __init__(self, turn: float | str) -> None:
        """Set one turn in the unit of the recorded angle, or as the name rig.toml has for that unit."""
        self._turn = turn
        self._begin_s = self._last = math.nan
        self._place = self._least = self._most = 0.0  # in turns from the first sample
        self._done = False

    def __call__(self, device: str, columns: Sequence[Any]) -> str:
        """Add new rows of the encoder, `t` and the angle; return what is wrong, "" for nothing."""
        if self._done or device != "encoder":
            return ""
        turns = turns_of(np.asarray(columns[1]), self._turn).turns
        first = turns[0] if math.isnan(self._last) else self._last
        steps = np.diff(turns, prepend=first)
        moved = self._place + np.cumsum((steps + 0.5) % 1 - 0.5)
        self._place, self._last = float(moved[-1]), float(turns[-1])
        self._least, self._most = min(self._least, float(moved.min())), max(self._most, float(moved.max()))
        if math.isnan(self._begin_s):
            self._begin_s = float(columns[0][0])
        between_deg = 360 * (self._most - self._least)
        if between_deg >= _MOVED_DEG:
            self._done = True
        elif columns[0][-1] - self._begin_s >= _RELEASED_WITHIN_S:
            self._done = True
            return (
                f"no release within {_RELEASED_WITHIN_S:.0f} s: the angle moved by {between_deg:.1f} degrees, and a "
                f"swing has {_MOVED_DEG:g} or more. Is the encoder coupled to the axis?"
            )
        return ""
