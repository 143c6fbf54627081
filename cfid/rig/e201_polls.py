"""Polls an E201 on a grid of times, and assigns each answer to its poll, or to none."""

import math
from collections.abc import Callable
from typing import Any

from twisted.internet.base import DelayedCall

from cfid.rig.e201_port import SLOWEST_REPLY_S
from cfid.wire import e201

_LATEST_S = 0.01  # largest delay of a poll by a busy computer, or by the system's queue before a port
_NAME_S = 0.05  # without a name, after which it is requested again
_LAST_NAME_S = 0.1  # after a name: one that was requested later would have arrived by then
_SETTLE_S = 0.005  # after the last name, in case it has a second line


class Polls:
    """Positions of an E201, polled one at a time.

    An answer does not identify its poll, but answers come in the order of the polls. So whenever an answer is late,
    garbled or unexpected, this class requests the device's name: once the name has arrived, no older answer can be on
    its way.

    A grid point that is more than ten milliseconds, and a whole period, in the past is skipped; a poll that is less
    late is made up for. `sent` and `answered` count polls, `skipped` grid points, `late` answers to polls that were
    given up, and `unasked` answers without a poll.
    """

    def __init__(
        self,
        reader: e201.PositionReader,
        *,
        command: bytes,
        period_s: float,
        send: Callable[[bytes], None],
        loop: Any,
    ) -> None:
        """Take the polling command and the period of the grid."""
        self.sent = self.answered = self.skipped = self.late = self.unasked = 0
        self._reader, self._command, self._send, self._loop = reader, command, send, loop
        self._period_s, self._latest_s = period_s, max(period_s, _LATEST_S)
        self._waiting = self._resyncing = self._ended = False
        self._unnamed = 0  # names that were requested and have not arrived
        self._timer: DelayedCall | None = None
        self._begun_s = self._polled_s = 0.0
        self._place = 0

    @property
    def waiting(self) -> bool:
        """Whether an answer may still come."""
        return self._waiting

    @property
    def unanswered(self) -> int:
        """How many polls got no position, not counting one that may still get it."""
        return self.sent - self.answered - (self._waiting and not self._ended)

    def begin(self) -> None:
        """Poll from now on: this is the first point of a new grid."""
        self._cancel()
        self._resyncing = self._ended = False
        self._begun_s, self._place = self._loop.seconds(), 0
        self._poll()

    def end(self) -> None:
        """Stop polling; the last answer still counts if it arrives."""
        self._ended = True
        self._cancel()

    def received(self, data: bytes) -> e201.EncoderReading | None:
        """Return the position that answers the poll, if these bytes complete it."""
        if self._waiting and self._loop.seconds() - self._polled_s >= SLOWEST_REPLY_S:
            self._resync()
        names, rejected = self._reader.names, self._reader.rejected
        readings = self._reader.feed(data)
        garbled = self._reader.rejected > rejected
        if self._resyncing:
            self.late += len(readings)
            self._take_names(self._reader.names - names)
            return None
        if self._waiting and len(readings) == 1 and not garbled:
            self._waiting = False
            self.answered += 1
            self._wait_for_next(self._latest_s)
            return readings[0]
        if readings or garbled:
            self.unasked += len(readings)
            self._resync()
        return None

    def _poll(self) -> None:
        self.sent += 1
        self._waiting = True
        self._polled_s = self._loop.seconds()
        self._send(self._command)
        self._later(SLOWEST_REPLY_S, self._resync)

    def _wait_for_next(self, latest_s: float) -> None:
        """Poll at the next grid point that is at most `latest_s` in the past, at once if its time has come."""
        now_s = self._loop.seconds()
        oldest = math.ceil((now_s - self._begun_s - latest_s) / self._period_s)
        place = max(self._place + 1, oldest)
        self.skipped += place - self._place - 1
        self._place = place
        wait_s = self._begun_s + place * self._period_s - now_s
        if wait_s > 0:
            self._later(wait_s, self._poll)
        elif not self._ended:
            self._poll()

    def _resync(self) -> None:
        """Give up the poll under way, and discard answers until the device has sent its name."""
        self._waiting = False
        self._resyncing = not self._ended
        self._unnamed = 0
        if self._resyncing:
            self._request_name()

    def _request_name(self) -> None:
        self._unnamed += 1
        self._send(e201.VERSION)
        self._later(_NAME_S, self._request_name)

    def _take_names(self, count: int) -> None:
        if not count:
            return
        self._unnamed -= count
        more = self._unnamed > 0  # further names are on their way, or were lost
        self._later(_LAST_NAME_S if more else _SETTLE_S, self._resume)

    def _resume(self) -> None:
        self._resyncing = False
        self._wait_for_next(self._period_s)

    def _later(self, delay_s: float, act: Callable[[], None]) -> None:
        """Schedule an action in place of the previous one."""
        self._cancel()
        if not self._ended:
            self._timer = self._loop.callLater(delay_s, act)

    def _cancel(self) -> None:
        if self._timer is not None and self._timer.active():
            self._timer.cancel()
