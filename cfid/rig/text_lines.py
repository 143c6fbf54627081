"""Records devices that send lines of text with values unprompted, as rig.toml states them."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import ConfigError, DeviceError
from cfid.records.rig_file import EncoderLines, LineDevice
from cfid.records.run import DeviceRecord
from cfid.rig.clock import unwrapped
from cfid.rig.hardware import Hardware, SerialPort
from cfid.rig.instrument import Block, PortInstrument, Say
from cfid.rig.lock import DeviceLock
from cfid.rig.progress import Reading, degrees, displayed, first_force
from cfid.wire.lines import printable

_SLACK_S = 0.1  # by which a computer may delay the first line
_UNLIKE = 0.01  # fraction of this computer's time by which a device's clock may deviate
_WRAP = 1 << 32  # of a device's clock


def ready_lines(
    name: str,
    setting: LineDevice,
    hardware: Hardware,
    held: ExitStack,
    *,
    say: Say,
    patient: bool = True,
    counts_per_turn: float | str = 1.0,
) -> "TextLines":
    """Lock a device's port. Without `patient` the run ends as soon as its lines break off. Raises DeviceError."""
    if not hardware.has_port(setting.port):
        raise DeviceError(f"{setting.port}: no such port. Plug the {name} in, or set devices.{name}.port in rig.toml.")
    lock = held.enter_context(DeviceLock(setting.port))
    return TextLines(name, setting, lock, say=say, patient=patient, counts_per_turn=counts_per_turn)


class _Row(NamedTuple):
    """A line's arrival by this computer's clock, and its numbers."""

    received_s: float
    numbers: tuple[float, ...]


class TextLines(PortInstrument):
    """A device that sends lines at a stated rate; a port that is gone is opened again when it is back.

    Lines are timed as they arrive. What is lost follows from the device's own clock where it sends one, else from the
    stated rate. Without `patient` a pulled plug or a silence ends the run at once, as it must while motors run.
    """

    def __init__(
        self,
        name: str,
        setting: LineDevice,
        lock: DeviceLock,
        *,
        say: Say,
        patient: bool = True,
        counts_per_turn: float | str = 1.0,
    ) -> None:
        """Take the device as rig.toml states it. Raises ConfigError for an angle whose counts per turn are unknown."""
        super().__init__(setting.port, say=say, patient=patient)
        scale, self.reading = _shown_as(name, setting, counts_per_turn)
        self.name, self.eventful = name, name in ("tachometer", "scales")
        self.record = _record(name, setting, scale)
        self._setting, self._lock = setting, lock
        self._names = [value.name for value in setting.in_order()]
        stamp = setting.stamp
        self._stamp_place = None if stamp is None else setting.in_order().index(stamp)
        self._tick_s = 0.0 if stamp is None else 1e-6 * setting.factor(stamp)

    @property
    def begun(self) -> bool:
        """Whether a matching line has come."""
        return self._last is not None

    def start(self, hardware: Hardware) -> None:
        """Open the port. Raises DeviceError naming why it cannot be opened."""
        self._reader = self._setting.reader()
        self._rows: list[_Row] = []
        self._first: _Row | None = None
        self._last: _Row | None = None  # the latest that counts
        self._doubted: _Row | None = None  # the line before, where its clock did not continue
        self._false = self._doubts = self._restarts = 0
        self._kept = self._counted = 0  # kept: rows after the first
        self._sent = 0.0  # lines after the first, by the device's clock, or by times of arrival and the stated rate
        self._clock_s = 0.0  # since the first row, by the device's clock or by times of arrival
        self._ticks: int | None = None  # of the device's clock, unwrapped
        self._begin(hardware, period_s=1 / self._setting.rate_hz)

    def _open(self) -> SerialPort:
        return self._hardware.serial(self._where, self, baud=self._setting.baud)

    async def _reopen(self) -> SerialPort:
        if self._hardware.has_port(self._where):
            self._lock.move(self._where)  # a link may lead to another port now
        return self._open()

    def _go_on(self) -> None:
        self._reader.forget()

    def received(self, data: bytes) -> None:
        """Take the bytes that the port received."""
        readings, now_s = self._reader.feed(data), self._hardware.seconds()
        if not readings:
            return
        was_gap, self._away_s = self._silence.end("no line came" if self.begun else ""), 0.0
        if was_gap and self.begun and self._stamp_place is None:
            readings = readings[-1:]  # nothing shows when those were sent that waited in the system
        for numbers in readings:
            self._take(_Row(now_s, numbers))

    def take(self) -> Block:
        """Return the new rows. Raises DeviceError for a silent device, and for an unplugged one while motors run."""
        self._check()
        if not self._rows:
            return self.block((), self._newly_lost())
        rows, self._rows = self._rows, []
        numbers = dict(zip(self._names, zip(*(row.numbers for row in rows), strict=True), strict=True))
        setting = self._setting
        measured = [setting.factor(value) * np.array(numbers[value.name]) for value in setting.measured]
        columns: list[npt.NDArray[Any]] = [
            self._hardware.unix_times_s(np.array([row.received_s for row in rows])),
            *measured,
        ]
        if (stamp := setting.stamp) is not None:
            ticks = unwrapped(np.rint(numbers[stamp.name]).astype(np.int64), self._ticks)
            self._ticks = int(ticks[-1])
            columns.append(ticks * round(setting.factor(stamp)))
        return Block(columns, self._newly_lost())

    async def stop(self) -> None:
        """Expect no further line. Raises DeviceError when the device was gone."""
        await super().stop()
        silent_s = self._silence.seconds + self._away_s
        if self._end_silence() or self._away_s:
            self._sent += silent_s * self._setting.rate_hz
        for sentence in self._findings():
            self._say(sentence)
        self._refuse_gone()

    def facts(self) -> Mapping[str, Any]:
        """Return losses by kind, and gaps."""
        left_out = self._reader.rejected + self._false
        losses = {
            "missing_lines": max(round(self._sent) - self._kept - left_out, 0),
            "lines_that_do_not_match": self._reader.rejected,
            "lines_with_a_false_clock": self._false,
        }
        return {"losses": losses, "gaps": self._silence.gaps}

    def _take(self, row: _Row) -> None:
        """Keep a line whose clock continues, or two that continue each other: there the clock began, or began anew.

        Two lines that ran into one have a number of too many digits: the clock jumps for one line.
        """
        step_s = self._step_s(self._last, row)
        if step_s is None and self._stamp_place is not None:
            doubted, self._doubted = self._doubted, row
            self._doubts += 1
            step_s = self._step_s(doubted, row)
            if doubted is None or step_s is None:
                self._false += 1
                return
            self._false -= 1
            self._restarts += self._last is not None
            self._keep(doubted, 0.0 if self._last is None else doubted.received_s - self._last.received_s)
        self._doubts, self._doubted = 0, None
        self._keep(row, step_s or 0.0)

    def _keep(self, row: _Row, step_s: float) -> None:
        """Keep a line that was sent `step_s` after the last one."""
        self._rows.append(row)
        self._last = row
        if self._first is None:
            self._first = row
            return
        periods = step_s * self._setting.rate_hz
        # Four ticks of the device's clock in a period show how many periods a step is.
        resolved = self._stamp_place is not None and 4 * self._tick_s * self._setting.rate_hz <= 1
        self._sent += round(periods) if resolved else periods
        self._clock_s += step_s
        self._kept += 1

    def _step_s(self, before: _Row | None, row: _Row) -> float | None:
        """Return how long after another a line was sent, None where its clock does not continue from there."""
        if before is None:
            return None
        elapsed_s = row.received_s - before.received_s
        if self._stamp_place is None:
            return elapsed_s
        ticks = round(row.numbers[self._stamp_place]) - round(before.numbers[self._stamp_place])
        step_s = self._tick_s * ((ticks + _WRAP // 2) % _WRAP - _WRAP // 2)
        # A clock may have advanced more than this computer's by two seconds, where a line that came late lies before.
        return step_s if 0 <= step_s < (1 + _UNLIKE) * elapsed_s + 2.0 else None

    def _newly_lost(self) -> int | None:
        """Return the lines lost since the last block; None where more came than the stated rate allows."""
        missing = round(self._sent) - self._kept
        slack = _SLACK_S if self._stopped else 5 * _SLACK_S
        if -missing > _UNLIKE * self._kept + slack * self._setting.rate_hz:
            return None
        lost = max(missing, self._reader.rejected + self._false, self._counted if not self._stopped else 0)
        newly, self._counted = lost - self._counted, lost
        return newly

    def _findings(self) -> Iterator[str]:
        """Yield sentences at the end, on a rate or a clock that is not as stated, and on lines left out."""
        name, stated_hz = self.name, self._setting.rate_hz
        if self._sent and -(round(self._sent) - self._kept) > _UNLIKE * self._kept + _SLACK_S * stated_hz:
            yield (
                f"the {name} sent {stated_hz * self._kept / self._sent:.4g} lines a second, more than the "
                f"{stated_hz:g} that rig.toml states, so its losses are unknown: set devices.{name}.rate_hz to the "
                "rate that the device's program sets."
            )
        if self._false:
            yield (
                f"{counted(self._false, 'line')} of the {name} left out, lost: device_us jumps there and back, as "
                "where two lines run into one. Let the device end lines with a checksum, shorten the cable."
            )
        if self._restarts:
            yield (
                f"the {name}'s clock, device_us, started anew: was the device restarted? See to its supply. A swing is "
                "timed by its clock before and after."
            )
        elif self._stamp_place is not None and self._first is not None and self._last is not None:
            elapsed_s = self._last.received_s - self._first.received_s
            if elapsed_s >= 2.0 and abs(self._clock_s - elapsed_s) > _UNLIKE * elapsed_s + _SLACK_S:
                yield (
                    f"the {name}'s clock, device_us, went {self._clock_s:.4g} s in {elapsed_s:.4g} s: it counts "
                    f"another unit, or stands. Correct it, or leave it out of devices.{name}.values: times are then "
                    "those of arrival."
                )

    def _check(self) -> None:
        if self._stopped:
            return
        if self._doubts > 20:  # in a row: the number is no clock
            raise DeviceError(
                f"{self._where}: the {self.name}'s clock jumps in every line: is it a clock, in the stated unit, "
                f"without commas? Correct it, or leave it out of devices.{self.name}.values."
            )
        if self._gone_s is not None:
            if not self._patient:
                raise DeviceError(f"{self._where}: the plug of the {self.name} was pulled while motors run.")
            return
        # A board that restarts when its port is opened takes two seconds; scales that settle send nothing meanwhile.
        is_slow = self._patient or self.eventful or not self.begun
        if not self._silence.exceeds(5.0 if is_slow else 0.4):  # while motors run, a load cell's silence stops them
            return
        unread = ""
        if self._reader.rejected:
            advice = "" if self.begun else f": {self._setting.unmatched(self.name)}"
            unread = (
                f" {counted(self._reader.rejected, 'line does', 'lines do')} not match what rig.toml states, "
                f"the last one '{printable(self._reader.last_rejected)}'{advice}."
            )
        raise DeviceError(
            f"{self._where}: the {self.name} sent no line for {self._silence.seconds:.1f} s.{unread} `cfid rig check` "
            "looks for the cause."
        )


def _shown_as(
    name: str, setting: LineDevice, counts_per_turn: float | str
) -> tuple[Mapping[str, object], Reading | None]:
    """Return what run.toml states about a device's units, and what the live line shows of it."""
    if name == "loadcell":
        return {"units": "n,nm"}, first_force(setting.measured[0].name)
    if not isinstance(setting, EncoderLines):
        return {}, displayed(setting.column_unit(setting.measured[0]))
    if not setting.counted:
        return {"angle_unit": "rad"}, degrees(setting.turn(counts_per_turn))
    if isinstance(counts_per_turn, str):
        raise ConfigError(
            f"encoder.counts_per_turn: is '{counts_per_turn}', a format of the E201's words: set the counts of a turn "
            f"that {setting.port} sends."
        )
    return {"counts_per_turn": counts_per_turn}, degrees(setting.turn(counts_per_turn))


def _record(name: str, setting: LineDevice, scale: Mapping[str, object]) -> DeviceRecord:
    """Return a device's description in run.toml."""
    stated: dict[str, Any] = setting.model_dump(mode="json", exclude={"rate_hz", "kind"}, exclude_defaults=True)
    return DeviceRecord.model_validate(
        {
            "file": f"{name}.csv",
            "columns": setting.columns,
            **scale,
            "asked": "lines",
            "rate_hz": setting.rate_hz,
            "lines": stated,
        }
    )
