"""Notes when this program itself was suspended or kept waiting: what it missed then is no device's fault."""

import math
from typing import Any

STOOD = "cfid itself was suspended or kept waiting"

_STALL_S = 0.2  # between two notes, which come every 0.05 s
_RECENT_S = 5.0  # a silence that follows shows up to 3 s later
_KEPT_S = 20.0


class Stalls:
    """The stalls of the last moments, on a loop's clock; `note` has to be called with every block of rows."""

    def __init__(self, loop: Any) -> None:
        """Start without a stall."""
        self._loop, self._ran_s = loop, math.inf
        self._stalls: list[tuple[float, float]] = []  # when each ended, and how long it was

    def begin(self) -> None:
        """Forget all stalls; a pause before a recording is no stall."""
        self._ran_s, self._stalls = math.inf, []

    def note(self) -> None:
        """Note that this program runs, and a stall if there was one since the last call."""
        now_s = self._loop.seconds()
        if now_s - self._ran_s > _STALL_S:
            self._stalls = [stall for stall in self._stalls if now_s - stall[0] < _KEPT_S]
            self._stalls.append((now_s, now_s - self._ran_s))
        self._ran_s = now_s

    def since(self, since_s: float) -> float:
        """Return for how many seconds since a time this program did not run.

        A little of each stall does not count, so that even a program that is always late notices a silent device.
        """
        lengths_s = (min(length_s, ended_s - since_s) for ended_s, length_s in self._stalls)
        return sum(max(length_s - _STALL_S, 0.0) for length_s in lengths_s)

    @property
    def recent(self) -> str:
        """How long this program did not run a moment ago, in words; empty if it always ran."""
        recent = [length_s for ended_s, length_s in self._stalls if self._loop.seconds() - ended_s <= _RECENT_S]
        return f"{STOOD} for {max(recent):.1f} s" if recent else ""
