"""Records a device that sends lines of text unprompted; a port that is gone is opened again when it is back."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DeviceError
from cfid.records.rig_file import LineDevice
from cfid.rig.clock import HostClock
from cfid.rig.e201_stamps import Stamps
from cfid.rig.line_clock import UNLIKE, Arrivals, DeviceClock, Line
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
_TICKS = 4  # fewest ticks of a device's clock in a period that show how many periods a step is
_TELLING_S = 2.0  # shortest recording that shows a clock's rate
_DOUBTS = 20  # lines in a row that do not continue the clock: the number is none
_SLACK_S, _LIVE_SLACK_S = 0.1, 0.5  # by which a computer may delay the first line, at the end and in the live line


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
        self._tick_s = 0.0 if device.stamp is None else 1e-6 * device.factor(device.stamp)
        self._clocked = self._judge()
        self._port: Port | None = None
        self._lines: list[Line] = []
        self._received_s = 0.0
        self._begun = self._stopped = False  # begun with the first line
        self._gone_s: float | None = None
        self._gaps: list[dict[str, float | str]] = []
        self._sent = 0.0  # lines after the first, by the device's clock or the time of arrival, and the stated rate
        self._kept = self._counted = 0  # kept: of the lines after the first
        self._first_s: float | None = None  # when the first row arrived
        self._row: Line | None = None  # the latest row
        self._missing_before = 0  # the last gap
        self._gap_ended_s: float | None = None  # until lines that come late have come
        self._late = 0  # lines since the end of that gap
        self._restarts = 0  # of the device's clock
        self._astray = False  # whether it disagreed with this computer's
        self._stalls = Stalls(loop)
        self._first = self._last = (0.0, 0)  # by this computer's clock, and the device's, in microseconds

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
        self._begun, self._received_s = True, now_s
        lines = self._clocked.credible(now_s, readings)
        if self._is_timely(len(lines), now_s):
            self._count(lines)
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
            self._last = times_s[-1], int(device_us[-1])
            self._first = self._first if self._first[0] else (times_s[0], int(device_us[0]))
        return Block(columns, self._newly_lost())

    async def stop(self) -> None:
        """Expect no further line. Raises DeviceError when the device was gone or silent."""
        self._stopped = True
        now_s = self._loop.seconds()
        silent_s = now_s - self._received_s
        if self._begun and silent_s > self._longest(_PAUSE_S):
            self._note_gap(now_s, "silent at the end" if self._gone_s is None else "unplugged")
            self._sent += silent_s * self._device.rate_hz
        self._settle()
        for sentence in self._findings():
            self._say(sentence)
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
            "missing_lines": max(self._missing - self._left_out, 0),
            "lines_that_do_not_match": self._reader.rejected,
            "lines_with_a_false_clock": self._clocked.false,
        }
        return {"losses": losses, "gaps": self._gaps}

    @property
    def _names(self) -> list[str]:
        return [value.name for value in self._device.in_order()]

    def _judge(self) -> Arrivals | DeviceClock:
        """Return what judges lines, by the device's clock if it sends one."""
        if (stamp := self._device.stamp) is None:
            return Arrivals()
        place = self._device.in_order().index(stamp)
        return DeviceClock(place, tick_s=self._tick_s, early_s=self._longest(_LATE_S))

    def _count(self, lines: Sequence[Line]) -> None:
        """Count lines and how many were sent since the line before; the first arrival may have been delayed."""
        for line in lines:
            before, self._row = self._row, line
            if line.step_s is not None:
                periods = line.step_s * self._device.rate_hz
                self._sent += round(periods) if _TICKS * self._tick_s * self._device.rate_hz <= 1 else periods
            elif before is None or line.received_s == self._first_s:
                self._first_s = line.received_s
                continue
            else:
                self._restarts += self._device.stamp is not None
                self._sent += (line.received_s - before.received_s) * self._device.rate_hz
            self._kept += 1

    @property
    def _missing(self) -> int:
        return round(self._sent) - self._kept

    @property
    def _left_out(self) -> int:
        return self._reader.rejected + self._clocked.false

    def _lost(self, slack_s: float) -> int | None:
        """Return how many lines are lost; None where more came than the stated rate allows, or the clock is wrong."""
        if self._astray or -self._missing > UNLIKE * self._kept + slack_s * self._device.rate_hz:
            return None
        return max(self._missing, self._left_out)

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
        """Note a span without lines."""
        self._settle()
        stood = self._stalls.since(self._received_s) > (end_s - self._received_s) / 2
        begin_s, to_s = self._clock.unix_s(np.array([self._received_s, end_s])).tolist()
        self._gaps.append({"from_s": begin_s, "to_s": to_s, "reason": STOOD if stood else reason})
        self._gap_ended_s, self._late, self._missing_before = end_s, 0, self._missing

    def _is_timely(self, lines: int, now_s: float) -> bool:
        """Return whether lines after a gap are kept: in a burst, only a device's clock shows when each was sent."""
        self._late += lines
        if self._gap_ended_s is None or self._device.stamp is not None:
            return True
        return self._late <= _PROMPT + (now_s - self._gap_ended_s + _CHUNK_S) * self._device.rate_hz

    def _settle(self, *, after_s: float = 0.0) -> None:
        """State what the last gap lost by the device's clock, `after_s` after its end, when no line comes late."""
        if self._gap_ended_s is None or self._loop.seconds() - self._gap_ended_s < after_s:
            return
        self._gap_ended_s = None
        if self._device.stamp is not None and self._late:
            self._gaps[-1]["lost"] = max(self._missing - self._missing_before, 0)

    def _findings(self) -> Iterator[str]:
        """Yield sentences at the end, on a rate or a clock that is not as stated, and on lines left out."""
        name, stated_hz, false = self.name, self._device.rate_hz, self._clocked.false
        here_s, there_s = self._last[0] - self._first[0], 1e-6 * (self._last[1] - self._first[1])
        apart = here_s >= _TELLING_S and abs(there_s - here_s) > UNLIKE * here_s
        self._astray = apart and not self._gaps and not self._restarts
        if self._sent and self._lost(_SLACK_S) is None and not self._astray:
            yield (
                f"the {name} sent {stated_hz * self._kept / self._sent:.4g} lines a second, more than the "
                f"{stated_hz:g} that rig.toml states, so its losses are unknown: set devices.{name}.rate_hz to the "
                "rate that the device's program sets."
            )
        if false:
            yield (
                f"{counted(false, 'line')} of the {name} left out, lost: device_us jumps there and back, as where two "
                "lines run into one. Let the device end lines with a checksum, shorten the cable."
            )
        if self._restarts:
            yield (
                f"the {name}'s clock, device_us, started anew: was the device restarted? See to its supply. A swing is "
                "timed by its clock before and after."
            )
        if self._astray:
            yield (
                f"the {name}'s clock, device_us, went {there_s:.4g} s in {here_s:.4g} s, so its losses are unknown: it "
                f"counts another unit, stands, or was restarted. Correct it, or leave it out of devices.{name}.values: "
                "times are then those of arrival."
            )

    def _longest(self, usual_s: float) -> float:
        """Return how long a silence may be at this rate before it is significant."""
        return max(usual_s, _PERIODS / self._device.rate_hz)

    def _newly_lost(self) -> int | None:
        if (lost := self._lost(_SLACK_S if self._stopped else _LIVE_SLACK_S)) is None:
            return None
        newly, self._counted = lost - self._counted, lost
        return newly

    def _watch(self) -> None:
        if self._stopped:
            return
        where = self._device.port
        if self._clocked.in_doubt > _DOUBTS:
            raise DeviceError(
                f"{where}: the {self.name}'s clock jumps in every line: is it a clock, in the stated unit, without "
                f"commas? Correct it, or leave it out of devices.{self.name}.values."
            )
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
