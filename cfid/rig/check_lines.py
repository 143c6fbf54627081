"""Checks a device that sends lines: whether they match, how many come in a second, and how finely they resolve."""

import time
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import serial

from cfid.counted import counted
from cfid.errors import DeviceError
from cfid.records.rig_file import LineDevice, LineValue
from cfid.rig.check import DeviceAnswer
from cfid.rig.e201_port import PORT_ERRORS, lock_name, why_not_open
from cfid.rig.lock import DeviceLock, holder_of
from cfid.wire.lines import LineReader, printable

_FIRST_S = 4.0  # until the first line: a board that restarts when its port is opened takes two seconds
_LOOK_S = 1.0
_FEWEST_PERIODS = 10
_LONGEST_LOOK_S = 5.0
_OFF = 0.1  # tolerance, as a fraction of the rate that rig.toml states
_WRAP = 1 << 32  # of a clock in microseconds
_TORN = 0.01  # fraction of the lines that may fail to match


def check_lines(name: str, setting: LineDevice) -> list[DeviceAnswer]:
    """Listen to a device for a second or more; skip one that a recording holds, as the recording would lose lines."""
    port = setting.port
    try:
        if holder := holder_of(lock_name(port)):
            return [DeviceAnswer("port", "ok", f"{port} is held by {holder}", "skipped: the check would take lines")]
        with DeviceLock.take(lock_name(port)):
            return _listened(name, setting)
    except DeviceError as error:
        return [DeviceAnswer("port", "fault", str(error), f"plug it in, or set devices.{name}.port in rig.toml")]


def _listened(name: str, setting: LineDevice) -> list[DeviceAnswer]:
    reader = setting.reader()
    readings, for_s, received = _readings(setting, reader)
    opened = DeviceAnswer("port", "ok", f"{setting.port}, {setting.baud} baud")
    if not readings and not received:
        advice = "check its power, and that its program runs"
        return [opened, DeviceAnswer("lines", "fault", f"nothing came in {_FIRST_S:g} s", advice)]
    if not readings:
        last = printable(reader.last_rejected)
        shown = f"{received} bytes, but no line that matches{f': {last!r}' if last else ''}"
        return [opened, DeviceAnswer("lines", "fault", shown, setting.unmatched(name))]
    rate = _rate(setting, len(readings), reader.rejected, for_s)
    return [opened, rate, *_clock(setting, readings, for_s), *_resolutions(setting, readings)]


def _rate(setting: LineDevice, count: int, rejected: int, for_s: float) -> DeviceAnswer:
    rate_hz, stated_hz = count / for_s, setting.rate_hz
    shown = f"{rate_hz:.4g} a second of {stated_hz:g}, {rejected} of {count + rejected} do not match"
    if rejected > max(_TORN * count, 1):
        return DeviceAnswer("lines", "warning", shown, "shorten the cable, lower the rate, or correct the pattern")
    missing, few = stated_hz * for_s - count, max(_OFF * stated_hz * for_s, 2)
    if missing < -few:
        advice = f"rig.toml states {stated_hz:g} Hz: set the rate that the device's program sets; losses are unknown"
        return DeviceAnswer("lines", "warning", shown, advice)
    if missing > few:
        advice = (
            "see to cable, baud and other programs, and compare rate_hz with the rate that the device's program sets"
        )
        shown = f"{shown}, {missing:.0f} of the {stated_hz * for_s:.0f} expected are missing"
        return DeviceAnswer("lines", "warning", shown, advice)
    return DeviceAnswer("lines", "ok", shown)


def _clock(setting: LineDevice, readings: Sequence[tuple[float, ...]], for_s: float) -> list[DeviceAnswer]:
    """Judge the rate of the device's own clock, if it sends one."""
    stamp = setting.stamp
    if stamp is None:
        return []
    ticks = np.array(readings)[:, setting.in_order().index(stamp)]
    gone_s = 1e-6 * setting.factor(stamp) * float(np.sum(np.diff(ticks) % _WRAP))
    shown = f"went {gone_s:.3g} s in {for_s:.3g} s"
    if abs(gone_s - for_s) > _OFF * for_s + 2 / setting.rate_hz:
        advice = "it counts another unit, stands, or is no clock: are there commas in numbers?"
        return [DeviceAnswer(stamp.name, "warning", shown, advice)]
    return [DeviceAnswer(stamp.name, "ok", shown)]


def _resolutions(setting: LineDevice, readings: Sequence[tuple[float, ...]]) -> list[DeviceAnswer]:
    columns = zip(setting.in_order(), np.array(readings).T, strict=True)
    return [_resolution(setting, value, column) for value, column in columns if value in setting.measured]


def _resolution(setting: LineDevice, value: LineValue, numbers: npt.NDArray[np.float64]) -> DeviceAnswer:
    """Return the latest value, the smallest step between two different ones, and the scatter."""
    shown = setting.factor(value) * numbers
    steps = np.diff(np.unique(shown))
    now = f"{shown[-1]:.6g} {setting.column_unit(value)}"
    if not len(steps):
        return DeviceAnswer(
            value.name, "ok", f"{now}, no change in {counted(len(shown), 'line')}", "touch it: it has to change"
        )
    return DeviceAnswer(value.name, "ok", f"{now}, steps of {steps.min():.2g}, scatter {shown.std():.2g}")


def _readings(setting: LineDevice, reader: LineReader) -> tuple[list[tuple[float, ...]], float, int]:
    """Return the readings of the lines after the first, the time they took, and the number of bytes in all."""
    found: list[tuple[float, ...]] = []
    received, begun_s = 0, 0.0
    end_s = time.monotonic() + _FIRST_S
    look_s = min(max(_LOOK_S, _FEWEST_PERIODS / setting.rate_hz), _LONGEST_LOOK_S)
    try:
        with serial.Serial(setting.port, setting.baud, timeout=0.02, exclusive=True) as line:
            while (now_s := time.monotonic()) < end_s:
                data = line.read(4096)
                received += len(data)
                found += reader.feed(data)
                if found and not begun_s:
                    begun_s, found, reader.rejected = time.monotonic(), [], 0
                    end_s = begun_s + look_s
    except PORT_ERRORS as error:
        raise DeviceError(f"{setting.port}: {why_not_open(error)}") from None
    return found, now_s - begun_s, received
