"""Polls an E201 at the places of a grid of times, and gives each answer to the poll that it answers, or to none."""

import math
from collections.abc import Callable
from typing import Any

from twisted.internet.base import DelayedCall

from cfid.rig.e201_port import SLOWEST_REPLY_S
from cfid.wire import e201

_LATEST_S = 0.01  # that a busy computer, or the system's own queue before a port, holds a poll up now and then
_NAME_S = 0.05  # without a name, after which it is asked for again
_LAST_NAME_S = 0.1  # after a name, in which one that was asked for later would have come too
_SETTLE_S = 0.005  # after the last name, should it have a second line


class Polls:
    """Positions of an E201, one asked for at a time.

    An answer does not say which question it answers, but answers come in the order of the questions. So
    whenever one is late, garbled or too many, the device is asked for its name: once that has come, no older
    answer is on its way.

    A place of the grid that is ten milliseconds, or a whole period, ago is not polled any more; what is less late
    is made up for. `sent` and `answered` count polls, `skipped` places, `late` answers to polls that were given
    up, `unasked` those that were one too many.
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
        """Take how to ask, and how far the places of the grid are apart."""
        self.sent = self.answered = self.skipped = self.late = self.unasked = 0
        self._reader, self._command, self._send, self._loop = reader, command, send, loop
        self._period_s, self._latest_s = period_s, max(period_s, _LATEST_S)
        self._waiting = self._in_doubt = self._ended = False
        self._unnamed = 0  # names that were asked for and have not come
        self._timer: DelayedCall | None = None
        self._begun_s = self._asked_s = 0.0
        self._place = 0

    @property
    def waiting(self) -> bool:
        """Whether an answer may still come."""
        return self._waiting

    @property
    def unanswered(self) -> int:
        """How many polls got no position, the one not counted that may still get it."""
        return self.sent - self.answered - (self._waiting and not self._ended)

    def begin(self) -> None:
        """Poll from now on: this is the first place of a new grid."""
        self._cancel()
        self._in_doubt = self._ended = False
        self._begun_s, self._place = self._loop.seconds(), 0
        self._poll()

    def end(self) -> None:
        """Poll no more; the last answer is still taken if it comes."""
        self._ended = True
        self._cancel()

    def received(self, data: bytes) -> e201.Reading | None:
        """Return the position that answers the poll, if these bytes complete it."""
        if self._waiting and self._loop.seconds() - self._asked_s >= SLOWEST_REPLY_S:
            self._doubt()
        names, rejected = self._reader.names, self._reader.rejected
        readings = self._reader.feed(data)
        garbled = self._reader.rejected > rejected
        if self._in_doubt:
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
            self._doubt()
        return None

    def _poll(self) -> None:
        self.sent += 1
        self._waiting = True
        self._asked_s = self._loop.seconds()
        self._send(self._command)
        self._later(SLOWEST_REPLY_S, self._doubt)

    def _wait_for_next(self, latest_s: float) -> None:
        """Poll at the next place of the grid that is not longer ago than that, at once if its time has come."""
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

    def _doubt(self) -> None:
        """Give up what is under way, and let it run out."""
        self._waiting = False
        self._in_doubt = not self._ended
        self._unnamed = 0
        if self._in_doubt:
            self._ask_name()

    def _ask_name(self) -> None:
        self._unnamed += 1
        self._send(e201.VERSION)
        self._later(_NAME_S, self._ask_name)

    def _take_names(self, count: int) -> None:
        if not count:
            return
        self._unnamed -= count
        more = self._unnamed > 0  # are on their way, or were lost
        self._later(_LAST_NAME_S if more else _SETTLE_S, self._trust)

    def _trust(self) -> None:
        self._in_doubt = False
        self._wait_for_next(self._period_s)

    def _later(self, delay_s: float, act: Callable[[], None]) -> None:
        """Do something later, instead of what was to be done before."""
        self._cancel()
        if not self._ended:
            self._timer = self._loop.callLater(delay_s, act)

    def _cancel(self) -> None:
        if self._timer is not None and self._timer.active():
            self._timer.cancel()
