"""Records the encoder: polls its interface or takes its continuous output, and finds it after its plug was pulled."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from twisted.internet.threads import deferToThreadPool
from twisted.python.failure import Failure

from cfid.errors import DeviceError
from cfid.rig.clock import HostClock
from cfid.rig.e201_polls import Polls
from cfid.rig.e201_port import SLOWEST_REPLY_S, FoundPort
from cfid.rig.e201_stamps import Stamps
from cfid.rig.recorder import Block, Say, no_rows, sleep
from cfid.rig.stalls import STOOD, Stalls
from cfid.wire import e201
from cfid.wire.rls import RLS_13BIT_IN_22, decode_words

_QUIET_S = 0.02  # without a position, after which the continuous output counts as off
_LOOK_S = 0.005
_STOPS = 3
_ABSENT_S = 3.0
_PAUSE_S = 0.25  # without a position, which is a gap
_PERIODS = 3  # of a slow rate: a shorter silence is neither absence nor gap
_SEARCH_S = 0.5
_FORMAT_SAMPLES = 50  # after which the words have another format if most fail their check


class SerialLine(Protocol):
    """An open serial port."""

    def write(self, data: bytes) -> None:
        """Send."""

    def close(self) -> None:
        """Close it; nothing is received afterwards."""


class Receiver(Protocol):
    """Takes the data of an open port."""

    def received(self, data: bytes) -> None:
        """Take received bytes."""

    def disconnected(self) -> None:
        """Note that the port is gone."""


OpenLine = Callable[[str, Receiver], SerialLine]
Find = Callable[[], FoundPort]


class Encoder:
    """An E201 that is polled at a rate, or that sends continuously.

    `open_line` opens a port, `find` looks for the interface again after its plug was pulled.
    """

    name = "encoder"

    def __init__(
        self,
        found: FoundPort,
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
        """Take the interface that was found, and how to sample it."""
        self._found, self._open_line, self._find = found, open_line, find
        self._checked = counts_per_turn == RLS_13BIT_IN_22
        self._period_s = 1 / rate_hz
        self._loop, self._clock, self._say = loop, clock, say
        self._stamps = Stamps() if found.stamped and not continuous else None
        stamped = None if continuous else found.stamped
        self._reader = e201.PositionReader(word_bits=found.word_bits, stamped=stamped)
        self._polls = None if continuous else self._new_polls()
        self._line: SerialLine | None = None
        self._times: list[float] = []
        self._readings: list[e201.EncoderReading] = []
        self._received_s = 0.0
        self._unanswered = self._skipped = 0  # the polls' counts when the last position arrived
        self._stalls = Stalls(loop)
        self._silent_places = 0  # grid points without a poll since the encoder was silent: lost, not skipped
        self._gone_s: float | None = None
        self._gaps: list[dict[str, float | str]] = []
        self._missing = self._late = self._failed_check = self._taken = self._counted = 0
        self._stopped = self._started = False

    @property
    def columns(self) -> tuple[str, ...]:
        """Time and counts, and the device's own stamps, unwrapped, if it sends any."""
        return ("t", "phi") if self._stamps is None else ("t", "phi", "device_us")

    def start(self) -> None:
        """Open the port and begin to sample."""
        self._received_s = self._loop.seconds()
        self._started = True
        self._attach()

    def received(self, data: bytes) -> None:
        """Take the bytes that the port received."""
        self._stalls.note()
        if self._polls is None:
            readings = self._reader.feed(data)
        else:
            reading = self._polls.received(data)
            readings = [] if reading is None else [reading]
        if readings:
            self._keep(readings, self._loop.seconds())

    def disconnected(self) -> None:
        """Note that the plug was pulled, and look for the interface until it is back."""
        self._line = None
        if self._stopped or self._gone_s is not None:
            return
        if self._polls is not None:
            self._polls.end()
        self._gone_s = self._loop.seconds()
        self._say(f"{self._found.port}: unplugged; waiting for the encoder {self._found.serial_number} to come back")
        self._search()

    def take(self) -> Block:
        """Return the new rows. Raises DeviceError when a plugged-in encoder is silent."""
        self._stalls.note()
        if not self._readings:
            self._watch()
            return Block(no_rows(len(self.columns)), self._newly_lost())
        times, readings = np.array(self._times), self._readings
        self._times, self._readings = [], []
        phi = np.array([reading.position for reading in readings], dtype=np.int64)
        columns = [self._clock.unix_s(times), phi]
        kept = np.ones(len(phi), dtype=np.bool_)
        if self._stamps is not None:
            stamps_us = self._stamps.unwrapped([reading.stamp_us or 0 for reading in readings])
            kept = ~self._stamps.late(stamps_us, times)
            columns.append(stamps_us)
        self._late += int(np.sum(~kept))
        self._taken += len(phi)
        if self._checked:
            valid = decode_words(phi).valid
            self._failed_check += int(np.sum(kept & ~valid))
            kept &= valid
        return Block([column[kept] for column in columns], self._newly_lost(), self._wrong_format())

    async def stop(self) -> None:
        """End the polling, or the continuous output and make sure that it ended; take what is on its way."""
        self._stopped = True
        if self._polls is not None:
            await self._last_answer(self._polls)
        elif self._line is not None:
            await self._quieten(self._line)
        now_s = self._loop.seconds()
        if self._started and now_s - self._received_s > self._longest(_PAUSE_S):
            self._note_gap(now_s, "silent at the end" if self._gone_s is None else "unplugged")
        if self._gone_s is not None:
            raise DeviceError(
                f"{self._found.port}: unplugged {now_s - self._gone_s:.0f} s before the end, and not plugged in again."
            )

    def close(self) -> None:
        """Close the port."""
        self._stopped = True
        if self._polls is not None:
            self._polls.end()
        if self._line is not None:
            line, self._line = self._line, None
            line.close()

    def facts(self) -> Mapping[str, Any]:
        """Return the numbers of polls and of skipped ones, losses by kind, and gaps."""
        polls = self._polls
        losses = {
            "missing_in_gaps": self._missing,
            "garbled_replies": self._reader.rejected,
            "device_errors": self._reader.errors,
            "failed_check": self._failed_check,
        }
        if polls is None:
            return {"losses": losses, "gaps": self._gaps}
        losses |= {
            "polls_without_position": polls.sent - polls.answered,
            "late_replies": polls.late + self._late,
            "unasked": polls.unasked,
        }
        skipped = polls.skipped - self._silent_places
        taken = {"polls": polls.sent, "skipped": skipped, "rate_hz": 1 / self._period_s}
        return {**taken, "losses": losses, "gaps": self._gaps}

    def _new_polls(self) -> Polls:
        command = e201.POSITION if self._stamps is None else e201.STAMPED_POSITION
        return Polls(self._reader, command=command, period_s=self._period_s, send=self._send, loop=self._loop)

    def _attach(self) -> None:
        self._line = self._open_line(self._found.port, self)
        self._reader.forget()
        if self._polls is None:
            self._send(e201.CONTINUOUS)
        else:
            self._polls.begin()

    def _send(self, command: bytes) -> None:
        if self._line is not None:
            self._line.write(command)

    async def _last_answer(self, polls: Polls) -> None:
        polls.end()
        end_s = self._loop.seconds() + SLOWEST_REPLY_S
        while polls.waiting and self._line is not None and self._loop.seconds() < end_s:
            await sleep(self._loop, _LOOK_S)

    async def _quieten(self, line: SerialLine) -> None:
        """Ask the interface to stop sending until it is quiet; report one that goes on."""
        for _ in range(_STOPS):
            line.write(e201.STOP_CONTINUOUS)
            await sleep(self._loop, _QUIET_S)
            came = len(self._readings)
            await sleep(self._loop, _QUIET_S)
            if len(self._readings) == came:
                return
        self._say(f"{self._found.port} keeps sending after {_STOPS} requests to stop: unplug it and plug it in again.")

    def _keep(self, readings: list[e201.EncoderReading], now_s: float) -> None:
        self._times += [now_s] * len(readings)
        self._readings += readings
        if now_s - self._received_s > self._longest(_PAUSE_S):
            self._note_gap(now_s, "no position came")
        self._note_position(now_s)

    def _note_position(self, now_s: float) -> None:
        self._received_s = now_s
        if self._polls is not None:
            self._unanswered, self._skipped = self._polls.unanswered, self._polls.skipped

    def _note_gap(self, end_s: float, reason: str) -> None:
        """Note a span without positions: samples implied by the rate are lost, or skipped if this program stood still.

        Each sample counts only once, as the one or the other.
        """
        stood = self._stalls.since(self._received_s) > (end_s - self._received_s) / 2
        begin_s, to_s = self._clock.unix_s(np.array([self._received_s, end_s])).tolist()
        self._gaps.append({"from_s": begin_s, "to_s": to_s, "reason": STOOD if stood else reason})
        if self._polls is None:
            return
        expected = round((end_s - self._received_s) / self._period_s) - 1
        skipped = self._polls.skipped - self._skipped
        counted = skipped if stood else 0
        self._silent_places += skipped - counted
        self._missing += max(expected - counted - (self._polls.unanswered - self._unanswered), 0)

    def _longest(self, usual_s: float) -> float:
        """Return how long a silence may be at this rate before it is significant."""
        return max(usual_s, _PERIODS * self._period_s)

    def _watch(self) -> None:
        silent_s = self._loop.seconds() - self._received_s - self._stalls.since(self._received_s)
        if self._gone_s is None and not self._stopped and silent_s > self._longest(_ABSENT_S):
            polled = "" if self._polls is None else ", though polled"
            if self._polls is not None and self._polls.late:
                polled += f" (its answers take longer than {1e3 * SLOWEST_REPLY_S:.0f} ms)"
            raise DeviceError(
                f"{self._found.port}: the encoder's interface sent no position for {silent_s:.0f} s{polled}: "
                "unplug it and plug it in again; `cfid rig check` looks for the cause."
            )

    def _newly_lost(self) -> int | None:
        """Count samples lost since the last block; in continuous output, which has no known rate, none are known."""
        if self._polls is None:
            return None
        lost = self._polls.unanswered + self._missing + self._late + self._failed_check
        newly, self._counted = lost - self._counted, lost
        return newly

    def _wrong_format(self) -> str:
        if self._taken < _FORMAT_SAMPLES or self._failed_check < self._taken / 2:
            return ""
        return (
            f"{self._found.port}: {self._failed_check} of {self._taken} words fail the check of a 13-bit position in "
            "22 bits: another encoder or word width. Set encoder.counts_per_turn in rig.toml to its counts per turn."
        )

    def _search(self) -> None:
        """Look for the interface on another thread, since an answer may take half a second."""
        if self._stopped:
            return
        search = deferToThreadPool(self._loop, self._loop.getThreadPool(), self._find)
        search.addCallback(self._back).addErrback(self._not_yet)  # it may be gone again before it is opened

    def _not_yet(self, failure: Failure) -> None:
        failure.trap(DeviceError)
        self._loop.callLater(_SEARCH_S, self._search)

    def _back(self, found: FoundPort) -> None:
        if self._stopped or self._gone_s is None:
            return
        now_s, self._found = self._loop.seconds(), found
        self._attach()
        self._note_gap(now_s, "unplugged")
        self._say(f"{found.port}: the encoder is back after {now_s - self._gone_s:.1f} s")
        self._gone_s = None
        self._note_position(now_s)
        if self._stamps is not None:
            self._stamps.forget()
