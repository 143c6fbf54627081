"""Simulates a device that sends lines of text: a microcontroller with an encoder or a load cell; no port, no clock."""

import math
from collections.abc import Callable, Mapping

from cfid.records.rig_file import LineDevice, LineValue
from cfid.sim.e201 import Reply
from cfid.wire.lines import checksum

Measure = Callable[[float], Mapping[str, float]]  # a time in s to values in the units of the run's columns

_LONGEST_CATCH_UP_S = 0.5
_STAMP_WRAP = 1 << 32


class LineSender:
    """A device from power-on. Lines are values separated by commas and a checksum, whatever pattern rig.toml states."""

    continuous = True

    def __init__(self, device: LineDevice, measure: Measure, *, powered_s: float) -> None:
        """Take what the values of a line are, and what they measure."""
        self._device, self._measure, self._powered_s = device, measure, powered_s
        self._next_s = powered_s

    def received(self, data: bytes, now_s: float) -> list[Reply]:
        """Return nothing: the device ignores what it receives."""
        return []

    def due(self, now_s: float) -> list[Reply]:
        """Return the lines up to now; after a stall, those of the last half second."""
        self._next_s = max(self._next_s, now_s - _LONGEST_CATCH_UP_S)
        lines = []
        while self._next_s <= now_s:
            lines.append((0.0, self._line(self._next_s)))
            self._next_s += 1 / self._device.rate_hz
        return lines

    def _line(self, time_s: float) -> bytes:
        measured = self._measure(time_s)
        line = ",".join(self._number(value, measured, time_s) for value in self._device.values).encode()
        return b"%s*%02X\r\n" % (line, checksum(line))

    def _number(self, value: LineValue, measured: Mapping[str, float], time_s: float) -> str:
        if value == self._device.stamp:
            ticks = 1e6 * (time_s - self._powered_s) / self._device.factor(value)
            return str(int(ticks) % _STAMP_WRAP)
        if value not in self._device.measured:
            return "0"
        number = measured[value.name] / self._device.factor(value)
        whole = value.scale != 1 or self._device.column_unit(value) == "counts"
        return str(math.floor(number)) if whole else f"{number:.4f}"
