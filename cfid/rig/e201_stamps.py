"""Unwraps the stamps that an E201 gives its positions, and compares them with the times of arrival."""

from collections import deque

import numpy as np
import numpy.typing as npt

from cfid.rig.clock import REMEMBERED_BLOCKS, Array
from cfid.rig.e201_port import SLOWEST_REPLY_S
from cfid.wire.e201 import STAMP_BITS

_WRAP = 1 << STAMP_BITS
_LARGEST_JUMP_US = 1 << 31
_STEADY_S = 0.01  # largest difference between the quickest answers, if stamps count microseconds at all

Microseconds = npt.NDArray[np.int64]


class Stamps:
    """Compares the device's clock with the host's.

    No manual states that stamps count microseconds: they are used only as long as they agree with the host's clock.
    """

    def __init__(self) -> None:
        """Start with no stamp known."""
        self._last_us: int | None = None
        self._quickest: deque[float] = deque(maxlen=REMEMBERED_BLOCKS)

    def forget(self) -> None:
        """Expect another offset between the two clocks: the device lost its power."""
        self._quickest.clear()

    def unwrapped(self, stamps_us: list[int]) -> Microseconds:
        """Unwrap 32-bit stamps (n,); no answer is late by half of their range."""
        begin_us = stamps_us[0] if self._last_us is None else self._last_us
        steps = (np.diff(stamps_us, prepend=begin_us % _WRAP) + _LARGEST_JUMP_US) % _WRAP - _LARGEST_JUMP_US
        continued = begin_us + np.cumsum(steps)
        self._last_us = int(continued[-1])
        return np.asarray(continued)

    def late(self, stamps_us: Microseconds, came_s: Array) -> npt.NDArray[np.bool_]:
        """Return which positions (n,) arrived too long after they were taken to answer their polls."""
        behind_s = came_s - 1e-6 * stamps_us
        known = self._quickest
        steady = len(known) == REMEMBERED_BLOCKS and max(known) - min(known) < _STEADY_S
        late = behind_s > (min(known) + SLOWEST_REPLY_S if steady else np.inf)
        known.append(float(behind_s.min()))
        return np.asarray(late)
