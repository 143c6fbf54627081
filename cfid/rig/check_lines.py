"""Checks a device that sends lines: whether they match, how many come in a second, and how finely they resolve."""

import time
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import serial
from scipy.ndimage import median_filter

from cfid.counted import counted
from cfid.errors import DeviceError
from cfid.records.line_devices import LineDevice, LineValue
from cfid.rig.check import DeviceAnswer
from cfid.rig.e201_port import PORT_ERRORS, lock_name, why_not_open
from cfid.rig.line_clock import periods
from cfid.rig.lock import DeviceLock, holder_of
from cfid.wire.lines import LineReader, printable

_FIRST_S = 4.0  # until the first line: a board that restarts when its port is opened takes two seconds
_LOOK_S = 1.0
_FEWEST_PERIODS = 10
_LONGEST_LOOK_S = 5.0
_OFF = 0.1  # tolerance, as a fraction of the rate that rig.toml states
_ALONE = 20.0  # times the usual difference of neighbouring readings: no motion moves a single one so far
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
    clock = _clock(setting, readings, for_s)
    runs = any(answer.state == "ok" for answer in clock)
    rate = _rate(setting, len(readings), reader.rejected, for_s, _steps_s(setting, readings) if runs else None)
    return [opened, rate, *clock, *_resolutions(setting, readings)]


def _rate(
    setting: LineDevice, count: int, rejected: int, for_s: float, steps_s: npt.NDArray[np.float64] | None
) -> DeviceAnswer:
    """Compare the lines that came with those that were sent, by the device's clock (steps_s) or the stated rate."""
    rate_hz, stated_hz = count / for_s, setting.rate_hz
    shown = f"{rate_hz:.4g} a second, {rejected} of {count + rejected} do not match"
    if rejected > max(_TORN * count, 1):
        return DeviceAnswer("lines", "warning", shown, "shorten the cable, lower the rate, or correct the pattern")
    if rate_hz - stated_hz > max(_OFF * stated_hz, 2 / for_s):
        advice = f"rig.toml states {stated_hz:g} Hz: set the rate that the device's program sets; losses are unknown"
        return DeviceAnswer("lines", "warning", shown, advice)
    if steps_s is None:
        sent, few = stated_hz * for_s, max(_OFF * stated_hz * for_s, 2.0)
    else:
        tick_s = 1e-6 * setting.factor(setting.stamp) if setting.stamp is not None else 0.0
        sent, few = 1 + sum(periods(step_s, rate_hz=stated_hz, tick_s=tick_s) for step_s in steps_s), 1.0
    if sent - count > few:
        shown = f"{shown}, {sent - count:.0f} of the {sent:.0f} that rig.toml's {stated_hz:g} Hz implies are missing"
        advice = (
            "see to cable, baud and other programs, and compare rate_hz with the rate that the device's program sets"
        )
        return DeviceAnswer("lines", "warning", shown, advice)
    return DeviceAnswer("lines", "ok", shown)


def _steps_s(setting: LineDevice, readings: Sequence[tuple[float, ...]]) -> npt.NDArray[np.float64]:
    """Return the steps of the device's own clock from line to line; none where it sends none."""
    if (stamp := setting.stamp) is None:
        return np.empty(0)
    ticks = np.array(readings)[:, setting.in_order().index(stamp)]
    return np.asarray(1e-6 * setting.factor(stamp) * (np.diff(ticks) % _WRAP))


def _clock(setting: LineDevice, readings: Sequence[tuple[float, ...]], for_s: float) -> list[DeviceAnswer]:
    """Judge the rate of the device's own clock, if it sends one."""
    stamp = setting.stamp
    if stamp is None:
        return []
    gone_s = float(np.sum(_steps_s(setting, readings)))
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
    if alone := _outliers(shown):
        advice = "numbers that lost digits? Let the device end its lines with a checksum, shorten the cable"
        return DeviceAnswer(value.name, "warning", f"{now}, {alone} of {len(shown)} readings far off alone", advice)
    return DeviceAnswer(value.name, "ok", f"{now}, steps of {steps.min():.2g}, scatter {shown.std():.2g}")


def _outliers(shown: npt.NDArray[np.float64]) -> int:
    """Return how many of a device's readings (n,) are far from both their neighbours."""
    off = np.abs(shown - median_filter(shown, 3, mode="nearest"))
    usual = max(float(np.diff(np.unique(shown)).min()), float(np.median(np.abs(np.diff(shown)))))
    return int(np.count_nonzero(off > _ALONE * usual))


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
