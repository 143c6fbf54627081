"""Records a device that sends lines of text unprompted; a port that is gone is opened again when it is back."""

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DeviceError
from cfid.records.line_devices import LineDevice
from cfid.rig.clock import HostClock
from cfid.rig.e201_stamps import Stamps
from cfid.rig.line_clock import Arrivals, DeviceClock, Line, Spacing
from cfid.rig.line_summary import OFF, UNLIKE, clock_apart, false_clock, rate_apart, repeated, restarted
from cfid.rig.listening import Listen, Port
from cfid.rig.recorder import Block, Say, no_rows
from cfid.rig.stalls import STOOD, Stalls
from cfid.wire.lines import printable

_ABSENT_S = 5.0  # without a line: a board that restarts when its port is opened takes two seconds
_BROKEN_S = 0.4  # without a line while motors run, after which they are stopped
_PAUSE_S = 0.25  # without a line, which is a gap
_PERIODS = 4  # of a slow rate: a shorter silence is neither absence nor gap
_SEARCH_S = 0.5
_LATE_S = 0.3  # after a gap, in which lines that the computer held back still come
_PROMPT, _CHUNK_S = 2, 0.02  # lines after a gap that are no burst; a USB adapter passes them on in chunks
_WRAP = 1 << 32  # of a device's clock
_FEWEST = 20  # lines that show a rate
_TICKS = 4  # fewest ticks of a device's clock in an interval by which lines are counted
_PROMPT_S = 0.05  # shortest interval by which arrivals are counted: a busy computer delays lines by less


class _Latest(NamedTuple):
    """A line's arrival by this computer's clock, the device's clock in it, and how many lines had not counted."""

    received_s: float
    ticks: int
    known: int


class Lines:
    """A device that sends lines, timed as they arrive.

    Without `patient` a pulled plug or a silence ends the run at once, as it must while motors run.
    """

    def __init__(
        self,
        name: str,
        device: LineDevice,
        *,
        listen: Listen,
        loop: Any,
        clock: HostClock,
        say: Say,
        patient: bool = True,
    ) -> None:
        """Take the device as rig.toml states it, and what opens its port; nothing is opened yet."""
        self.name, self.columns = name, device.columns
        self._device, self._listen, self._loop, self._clock, self._say = device, listen, loop, clock, say
        self._patient = patient
        self._reader = device.reader()
        self._stamps = Stamps()
        self._clocked, self._spacing = self._judges()
        self._known = 0  # lines that did not match, or had a false clock, as reported to the spacing
        self._port: Port | None = None
        self._lines: list[Line] = []
        self._received_s = 0.0
        self._begun = self._stopped = False  # begun with the first line
        self._gone_s: float | None = None
        self._gaps: list[dict[str, float | str]] = []
        self._missing = self._counted = self._sent = 0
        self._owed = 0  # lines that the last gap should have had, until those that come late are known
        self._late = 0  # lines since the end of that gap
        self._paid_s: float | None = None  # when that gap ended
        self._latest: _Latest | None = None  # the latest line
        self._before: _Latest | None = None  # the latest line before that gap
        self._restarted = False  # the device's clock disagreed with this computer's across a gap
        self._stalls = Stalls(loop)
        self._sending_s = 0.0  # without gaps
        self._first: tuple[float, int] | None = None  # by this computer's clock, and the device's, in microseconds
        self._last = (0.0, 0)

    @property
    def begun(self) -> bool:
        """Whether a matching line has come."""
        return self._begun

    def start(self) -> None:
        """Open the port. Raises DeviceError naming why it cannot be opened."""
        self._received_s = self._loop.seconds()
        self._port = self._listen(self._device.port, self)

    def received(self, data: bytes) -> None:
        """Take the bytes that the port received."""
        self._stalls.note()
        readings, now_s = self._reader.feed(data), self._loop.seconds()
        if not readings:
            return
        if self._begun and now_s - self._received_s > self._longest(_PAUSE_S):
            self._note_gap(now_s, "no line came")
        elif self._begun and self._paid_s is None:  # lines that come late show no rate
            self._sent, self._sending_s = self._sent + len(readings), self._sending_s + now_s - self._received_s
        self._begun, self._received_s = True, now_s
        lines = self._clocked.credible(now_s, readings)
        known = self._reader.rejected + self._clocked.false
        if self._paid_s is None:
            self._spacing.add([line.step_s for line in lines if line.step_s is not None], known=known - self._known)
        self._known = known
        if not lines:
            return
        if (stamp := self._device.stamp) is not None:
            ticks = int(lines[-1].numbers[self._device.in_order().index(stamp)])
            self._latest = _Latest(now_s, ticks, known)
        if self._paid_s is not None and not self._is_timely(len(lines), now_s - self._paid_s):
            return
        self._lines += lines

    def disconnected(self) -> None:
        """Note that the plug was pulled, and look for the port until it is back."""
        self._port = None
        if self._stopped or self._gone_s is not None:
            return
        self._gone_s = self._loop.seconds()
        if self._patient:
            self._say(f"{self._device.port}: unplugged; waiting for the {self.name} to come back")
            self._loop.callLater(_SEARCH_S, self._search)

    def take(self) -> Block:
        """Return the new rows. Raises DeviceError for a silent device, and for an unplugged one while motors run."""
        self._stalls.note()
        self._watch()
        self._settle(after_s=_LATE_S)
        if not self._lines:
            return Block(no_rows(len(self.columns)), self._newly_lost())
        times_s = np.array([line.received_s for line in self._lines])
        readings = [line.numbers for line in self._lines]
        numbers, self._lines = dict(zip(self._names, zip(*readings, strict=True), strict=True)), []
        measured = [self._device.factor(value) * np.array(numbers[value.name]) for value in self._device.measured]
        columns: list[npt.NDArray[Any]] = [self._clock.unix_s(times_s), *measured]
        if (stamp := self._device.stamp) is not None:
            ticks = self._stamps.unwrapped([int(number) for number in numbers[stamp.name]])
            device_us = ticks * round(self._device.factor(stamp))
            columns.append(device_us)
            self._first = self._first or (times_s[0], int(device_us[0]))
            self._last = times_s[-1], int(device_us[-1])
        return Block(columns, self._newly_lost())

    async def stop(self) -> None:
        """Expect no further line. Raises DeviceError when the device was gone or silent."""
        self._stopped = True
        now_s = self._loop.seconds()
        silent_s = now_s - self._received_s
        if self._begun and silent_s > self._longest(_PAUSE_S):
            self._note_gap(now_s, "silent at the end" if self._gone_s is None else "unplugged")
        self._settle()
        self._lines += self._clocked.settle()
        self._spacing.settle()
        self._say_rate()
        self._say_clock()
        if self._gone_s is not None and self._patient:
            raise DeviceError(
                f"{self._device.port}: unplugged {now_s - self._gone_s:.0f} s before the end, and not plugged in again."
            )

    def close(self) -> None:
        """Close the port."""
        self._stopped = True
        if self._port is not None:
            port, self._port = self._port, None
            port.close()

    def facts(self) -> Mapping[str, Any]:
        """Return losses by kind, and gaps."""
        losses = {
            "missing_in_gaps": self._missing,
            "missing_between_lines": self._spacing.missing,
            "lines_that_do_not_match": self._reader.rejected,
            "lines_with_a_false_clock": self._clocked.false,
        }
        return {"losses": losses, "gaps": self._gaps}

    @property
    def _names(self) -> list[str]:
        return [value.name for value in self._device.in_order()]

    def _judges(self) -> tuple[Arrivals | DeviceClock, Spacing]:
        """Return what judges lines, and what counts missing ones, both by the device's clock if it sends one."""
        stamp = self._device.stamp
        if stamp is None:
            return Arrivals(), Spacing(self._device.rate_hz, shortest_s=_PROMPT_S)
        tick_s, place = 1e-6 * self._device.factor(stamp), self._device.in_order().index(stamp)
        clock = DeviceClock(place, tick_s=tick_s, early_s=self._longest(_LATE_S))
        return clock, Spacing(self._device.rate_hz, shortest_s=_TICKS * tick_s)

    def _search(self) -> None:
        if self._stopped or self._gone_s is None:
            return
        try:
            self._port = self._listen(self._device.port, self)
        except DeviceError:
            self._loop.callLater(_SEARCH_S, self._search)
            return
        now_s = self._loop.seconds()
        self._say(f"{self._device.port}: the {self.name} is back after {now_s - self._gone_s:.1f} s")
        if self._begun:
            self._note_gap(now_s, "unplugged")
        self._reader.forget()
        self._gone_s, self._received_s = None, now_s

    def _note_gap(self, end_s: float, reason: str) -> None:
        """Note a span without lines; those that the rate implies there are lost, except lines that come late."""
        self._settle()
        stood = self._stalls.since(self._received_s) > (end_s - self._received_s) / 2
        begin_s, to_s = self._clock.unix_s(np.array([self._received_s, end_s])).tolist()
        self._gaps.append({"from_s": begin_s, "to_s": to_s, "reason": STOOD if stood else reason})
        self._owed, self._paid_s = max(round((end_s - self._received_s) * self._device.rate_hz), 0), end_s
        self._late, self._before = 0, self._latest

    def _is_timely(self, lines: int, since_s: float) -> bool:
        """Return whether lines after a gap are kept: in a burst, only a device's clock shows when each was sent."""
        self._late += lines
        if self._device.stamp is None and self._late > _PROMPT + (since_s + _CHUNK_S) * self._device.rate_hz:
            return False
        self._owed -= lines
        return True

    def _settle(self, *, after_s: float = 0.0) -> None:
        """Count what the last gap lost, `after_s` after its end, when no more of its lines come late."""
        if self._paid_s is None or self._loop.seconds() - self._paid_s < after_s:
            return
        by_device = self._skipped_by_device()
        # Count up to the last line; after a silent end, none came.
        since_s = max(self._received_s - self._paid_s, 0.0)
        by_arrival = self._owed + math.floor(since_s * self._device.rate_hz)
        self._missing += max(by_arrival if by_device is None else by_device, 0)
        self._paid_s = None
        if by_device is not None:
            self._gaps[-1]["lost"] = max(by_device, 0)

    def _skipped_by_device(self) -> int | None:
        """Return how many lines are missing since the last line before the last gap, by the device's own clock.

        Return None where that clock shows nothing: the device sends none, no line came since, or the clock disagrees
        with this computer's, as that of a restarted board does.
        """
        stamp, before, latest = self._device.stamp, self._before, self._latest
        if stamp is None or before is None or latest is None or not self._late:
            return None
        gone_s = 1e-6 * self._device.factor(stamp) * ((latest.ticks - before.ticks) % _WRAP)
        here_s = latest.received_s - before.received_s
        if abs(gone_s - here_s) > _LATE_S + UNLIKE * here_s:
            self._restarted = True
            return None
        return round(gone_s * self._device.rate_hz) - self._late - (latest.known - before.known)

    def _say_rate(self) -> None:
        repeats = self._clocked.repeats
        sent = self._sent + self._reader.rejected + self._spacing.missing - repeats
        if repeats > OFF * self._sent:
            self._say(repeated(self.name, repeats))
        if self._sending_s and sent >= _FEWEST:
            self._say_all(rate_apart(self.name, sent / self._sending_s, stated_hz=self._device.rate_hz))

    def _say_clock(self) -> None:
        self._say_all(false_clock(self.name, self._clocked.false))
        if self._restarted:
            self._say(restarted(self.name))
        if self._first is not None and not self._gaps:
            here_s, there_s = self._last[0] - self._first[0], 1e-6 * (self._last[1] - self._first[1])
            self._say_all(clock_apart(self.name, here_s=here_s, there_s=there_s))

    def _say_all(self, sentences: Iterable[str]) -> None:
        for sentence in sentences:
            self._say(sentence)

    def _longest(self, usual_s: float) -> float:
        """Return how long a silence may be at this rate before it is significant."""
        return max(usual_s, _PERIODS / self._device.rate_hz)

    def _newly_lost(self) -> int:
        lost = self._reader.rejected + self._clocked.false + self._missing + self._spacing.missing
        newly, self._counted = lost - self._counted, lost
        return newly

    def _watch(self) -> None:
        if self._stopped:
            return
        where = self._device.port
        silent_s = self._loop.seconds() - self._received_s - self._stalls.since(self._received_s)
        if self._gone_s is not None:
            if not self._patient:
                raise DeviceError(f"{where}: the {self.name} was unplugged while motors run.")
            return
        if silent_s <= self._longest(_ABSENT_S if self._patient or not self._begun else _BROKEN_S):
            return
        unread = ""
        if self._reader.rejected:
            advice = "" if self._begun else f": {self._device.unmatched(self.name)}"
            unread = (
                f" {counted(self._reader.rejected, 'line does', 'lines do')} not match what rig.toml states, "
                f"the last one '{printable(self._reader.last_rejected)}'{advice}."
            )
        raise DeviceError(
            f"{where}: the {self.name} sent no line for {silent_s:.1f} s.{unread} `cfid rig check` looks for the cause."
        )
