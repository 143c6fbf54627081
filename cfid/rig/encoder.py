"""The encoder as an instrument: polls its interface, or listens to it, and finds it again after a pulled plug."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from twisted.internet.base import DelayedCall
from twisted.internet.threads import deferToThreadPool
from twisted.python.failure import Failure

from cfid.errors import DeviceError
from cfid.rig.clock import HostClock
from cfid.rig.e201_port import SLOWEST_REPLY_S, Found
from cfid.rig.recorder import Block, Say, no_rows, sleep
from cfid.wire import e201
from cfid.wire.rls import RLS_13BIT_IN_22, decode_words

_RESYNC_S = 0.02  # of silence, after which no old reply comes any more
_ABSENT_S = 3.0
_SEARCH_S = 0.5
_FORMAT_SAMPLES = 50  # after which words that all fail their check are of another kind
_LARGEST_JUMP_US = 1 << 31


class Line(Protocol):
    """An open serial port."""

    def write(self, data: bytes) -> None:
        """Send."""

    def close(self) -> None:
        """Close it; nothing is received afterwards."""


class Receiver(Protocol):
    """What an open port talks to."""

    def received(self, data: bytes) -> None:
        """Take what came."""

    def disconnected(self) -> None:
        """The port is gone."""


OpenLine = Callable[[str, Receiver], Line]
Find = Callable[[], Found]


class Encoder:
    """An E201 that is polled at a rate, or that sends by itself.

    `open_line` opens a port, `find` looks for the interface again after its plug was pulled.
    """

    name = "encoder"

    def __init__(
        self,
        found: Found,
        *,
        open_line: OpenLine,
        find: Find,
        counts_per_turn: float | str,
        rate_hz: float,
        continuous: bool,
        loop: Any,
        clock: HostClock,
        say: Say,
    ) -> None:
        """Take what was found and how to sample it."""
        self._found, self._open_line, self._find = found, open_line, find
        self._checked = counts_per_turn == RLS_13BIT_IN_22
        self._period_s = 1 / rate_hz
        self._continuous = continuous
        self._stamped = found.stamped and not continuous
        self._loop, self._clock, self._say = loop, clock, say
        self._reader = self._new_reader()
        self._line: Line | None = None
        self._timer: DelayedCall | None = None
        self._due_s = self._asked_s = self._heard_s = 0.0
        self._waiting = self._resyncing = self._unsure = False
        self._held: list[e201.Reading] = []
        self._held_s = 0.0
        self._gone_s: float | None = None
        self._times: list[float] = []
        self._readings: list[e201.Reading] = []
        self._stamp_us: int | None = None
        self._counted = 0
        self._polls = self._answers = self._unasked = self._failed_check = self._taken = 0
        self._rejected_before = self._errors_before = 0
        self._gaps: list[dict[str, float | str]] = []
        self._stopped = False

    @property
    def columns(self) -> tuple[str, ...]:
        """Time and counts; the device's own stamps, unwrapped, if it gives any."""
        return ("t", "phi", "device_us") if self._stamped else ("t", "phi")

    def start(self) -> None:
        """Open the port and begin to sample."""
        self._heard_s = self._loop.seconds()
        self._attach()

    def received(self, data: bytes) -> None:
        """Take what the port received; one reply answers one poll."""
        self._give_up_late_reply()
        self._give_up_late_reply()
        if self._resyncing:
            return
        now_s = self._loop.seconds()
        rejected_before = self._reader.rejected
        readings = self._reader.feed(data)
        if self._continuous:
            self._keep(readings, now_s)
        elif self._waiting and self._unsure:
            self._hold(readings, now_s)
        elif self._waiting and (readings or self._reader.rejected > rejected_before):
            self._keep(readings[:1], now_s)
            self._answers += bool(readings)
            self._unasked += len(readings[1:])
            self._waiting = False
            self._wait_for_next(now_s)
        else:
            self._unasked += len(readings)

    def disconnected(self) -> None:
        """Note that the plug was pulled, and look for the interface until it is back."""
        if self._stopped or self._gone_s is not None:
            return
        self._cancel()
        self._line = None
        self._gone_s = self._loop.seconds()
        self._say(f"{self._found.port}: unplugged; waiting for the encoder {self._found.serial_number} to come back")
        self._search()

    def take(self) -> Block:
        """Hand over what came. Raises DeviceError when a plugged encoder is silent."""
        self._give_up_late_reply()
        if not self._readings:
            self._watch()
            return Block(no_rows(len(self.columns)), self._newly_lost())
        lost = self._newly_lost()
        times, readings = np.array(self._times), self._readings
        self._times, self._readings = [], []
        phi = np.array([reading.position for reading in readings], dtype=np.int64)
        columns = [self._clock.unix_s(times), phi]
        if self._stamped:
            columns.append(self._unwrapped([reading.stamp_us or 0 for reading in readings]))
        self._taken += len(phi)
        if self._checked:
            valid = decode_words(phi).valid
            failed = len(phi) - int(valid.sum())
            self._failed_check += failed
            lost += failed
            columns = [column[valid] for column in columns]
        return Block(columns, lost, self._wrong_format())

    async def stop(self) -> None:
        """Stop polling, or the continuous output, and wait for the last reply."""
        self._stopped = True
        if self._line is not None and self._continuous:
            self._line.write(e201.STOP_CONTINUOUS)
            await sleep(self._loop, _RESYNC_S)
        elif self._waiting:
            await sleep(self._loop, _RESYNC_S)
        self._cancel()
        if self._gone_s is not None:
            raise DeviceError(
                f"{self._found.port}: unplugged {self._loop.seconds() - self._gone_s:.0f} s before the end, and never "
                "back."
            )

    def close(self) -> None:
        """Close the port."""
        self._stopped = True
        self._cancel()
        if self._line is not None:
            line, self._line = self._line, None
            line.close()

    def facts(self) -> Mapping[str, Any]:
        """Return polls and losses by kind, and gaps."""
        return {
            "polls": self._polls,
            "losses": {
                "polls_without_position": self._polls - self._answers,
                "garbled_replies": self._unread(),
                "device_errors": self._errors_before + self._reader.errors,
                "unasked": self._unasked,
                "failed_check": self._failed_check,
            },
            "gaps": self._gaps,
        }

    def _attach(self) -> None:
        self._line = self._open_line(self._found.port, self)
        self._resyncing = self._waiting = self._unsure = False
        self._held = []
        if self._continuous:
            self._line.write(e201.CONTINUOUS)
        else:
            self._due_s = self._loop.seconds()
            self._poll()

    def _poll(self) -> None:
        if self._line is None or self._stopped:
            return
        self._polls += 1
        self._waiting = True
        self._asked_s = self._loop.seconds()
        self._line.write(e201.STAMPED_POSITION if self._stamped else e201.POSITION)

    def _wait_for_next(self, now_s: float) -> None:
        """Poll again on the grid of the rate: at once after a reply that came late, but without a burst."""
        self._cancel()
        self._due_s = max(self._due_s + self._period_s, now_s - self._period_s)
        self._timer = self._loop.callLater(max(self._due_s - now_s, 0), self._poll)

    def _give_up_late_reply(self) -> None:
        """Give a reply up, and let old ones run out before the next poll: it must not get one of them."""
        late = self._loop.seconds() - self._asked_s >= SLOWEST_REPLY_S
        if not late or not self._waiting or self._held or self._stopped:
            return
        self._waiting, self._resyncing, self._unsure = False, True, True
        self._reader.forget()
        self._timer = self._loop.callLater(_RESYNC_S, self._poll_after_silence)

    def _poll_after_silence(self) -> None:
        self._resyncing = False
        self._due_s = self._loop.seconds()
        self._poll()

    def _hold(self, readings: list[e201.Reading], now_s: float) -> None:
        """Wait for silence after a reply that may be that of the poll given up: the last one of all is this poll's."""
        if readings:
            self._unasked += len(self._held) + len(readings) - 1
            self._held, self._held_s = readings[-1:], now_s
            self._cancel()
            self._timer = self._loop.callLater(_RESYNC_S, self._take_held)

    def _take_held(self) -> None:
        self._keep(self._held, self._held_s)
        self._answers += 1
        self._held = []
        self._waiting = self._unsure = False
        self._due_s = self._loop.seconds()
        self._poll()

    def _keep(self, readings: list[e201.Reading], now_s: float) -> None:
        self._times += [now_s] * len(readings)
        self._readings += readings
        if readings:
            self._heard_s = now_s

    def _watch(self) -> None:
        silent_s = self._loop.seconds() - self._heard_s
        if self._gone_s is None and not self._stopped and silent_s > _ABSENT_S:
            raise DeviceError(
                f"{self._found.port}: the encoder's interface gives no position for {silent_s:.0f} s, though polled: "
                "plug it out and in again; `cfid rig check` asks it what is wrong."
            )

    def _newly_lost(self) -> int:
        """Count polls without a position; of a continuous output only what was garbled is known."""
        lost = self._unread() if self._continuous else self._polls - self._answers - self._waiting
        newly, self._counted = lost - self._counted, lost
        return newly

    def _unread(self) -> int:
        return self._rejected_before + self._reader.rejected

    def _wrong_format(self) -> str:
        if self._taken < _FORMAT_SAMPLES or self._failed_check < self._taken / 2:
            return ""
        return (
            f"{self._found.port}: {self._failed_check} of {self._taken} words fail the check of a 13-bit position in "
            "22 bits: another encoder or word width. Set encoder.counts_per_turn in rig.toml to its counts per turn."
        )

    def _unwrapped(self, stamps_us: list[int]) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Continue 32-bit stamps; a reply that is late by half a range does not exist."""
        wrap = 1 << e201.STAMP_BITS
        begin_us = stamps_us[0] if self._stamp_us is None else self._stamp_us
        steps = (np.diff(stamps_us, prepend=begin_us % wrap) + _LARGEST_JUMP_US) % wrap - _LARGEST_JUMP_US
        continued = begin_us + np.cumsum(steps)
        self._stamp_us = int(continued[-1])
        return np.asarray(continued)

    def _search(self) -> None:
        """Look for the interface beside the loop, since an answer may take half a second."""
        if self._stopped:
            return
        asked = deferToThreadPool(self._loop, self._loop.getThreadPool(), self._find)
        asked.addCallback(self._back).addErrback(self._not_yet)  # it may be gone again before it is opened

    def _not_yet(self, failure: Failure) -> None:
        failure.trap(DeviceError)
        self._loop.callLater(_SEARCH_S, self._search)

    def _back(self, found: Found) -> None:
        if self._stopped or self._gone_s is None:
            return
        now_s, self._found = self._loop.seconds(), found
        self._rejected_before, self._errors_before = self._unread(), self._errors_before + self._reader.errors
        self._reader = self._new_reader()
        self._attach()
        begin_s, end_s = self._clock.unix_s(np.array([self._gone_s, now_s])).tolist()
        self._gaps.append({"from_s": begin_s, "to_s": end_s, "reason": "unplugged"})
        self._say(f"{found.port}: the encoder is back after {end_s - begin_s:.1f} s")
        self._gone_s, self._heard_s = None, now_s

    def _new_reader(self) -> e201.PositionReader:
        return e201.PositionReader(word_bits=self._found.word_bits, stamped=None if self._continuous else self._stamped)

    def _cancel(self) -> None:
        if self._timer is not None and self._timer.active():
            self._timer.cancel()
