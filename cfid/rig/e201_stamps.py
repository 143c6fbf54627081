"""The stamps that an E201 gives its positions: unwrapped, and compared with when they came."""

from collections import deque

import numpy as np
import numpy.typing as npt

from cfid.rig.clock import Array
from cfid.rig.e201_port import SLOWEST_REPLY_S
from cfid.wire.e201 import STAMP_BITS

_WRAP = 1 << STAMP_BITS
_LARGEST_JUMP_US = 1 << 31
_REMEMBERED_BLOCKS = 40  # two seconds of them
_STEADY_S = 0.01  # by which the quickest answers of those differ, if stamps count microseconds at all

Microseconds = npt.NDArray[np.int64]


class Stamps:
    """The device's clock beside the host's.

    That stamps count microseconds no manual says: what follows from it is believed only while it is so.
    """

    def __init__(self) -> None:
        """Start with no stamp known."""
        self._last_us: int | None = None
        self._quickest: deque[float] = deque(maxlen=_REMEMBERED_BLOCKS)

    def forget(self) -> None:
        """Expect another offset between the two clocks: the device lost its power."""
        self._quickest.clear()

    def unwrapped(self, stamps_us: list[int]) -> Microseconds:
        """Continue 32-bit stamps (n,); an answer that is late by half a range does not exist."""
        begin_us = stamps_us[0] if self._last_us is None else self._last_us
        steps = (np.diff(stamps_us, prepend=begin_us % _WRAP) + _LARGEST_JUMP_US) % _WRAP - _LARGEST_JUMP_US
        continued = begin_us + np.cumsum(steps)
        self._last_us = int(continued[-1])
        return np.asarray(continued)

    def late(self, stamps_us: Microseconds, came_s: Array) -> npt.NDArray[np.bool_]:
        """Return which of the positions (n,) came too long after they were taken to be their polls' answers."""
        behind_s = came_s - 1e-6 * stamps_us
        known = self._quickest
        steady = len(known) == _REMEMBERED_BLOCKS and max(known) - min(known) < _STEADY_S
        late = behind_s > (min(known) + SLOWEST_REPLY_S if steady else np.inf)
        known.append(float(behind_s.min()))
        return np.asarray(late)
