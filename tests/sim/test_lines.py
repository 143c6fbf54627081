"""A simulated device that sends lines: the reader of its lines returns the measured values."""

import math

import numpy as np
import pytest

from cfid.records.rig_file import LineDevice, LineValue, LoadCellLines
from cfid.sim.faults import EncoderFaults, FaultySerial
from cfid.sim.lines import LineSender

CELL = LoadCellLines(
    kind="lines",
    port="port",
    rate_hz=80,
    pattern=r"weight (\d+) (-?\d+) (\w+)",
    values=(
        LineValue(name="device_ms"),
        LineValue(name="Tz", unit="g", scale=0.001, arm_mm=50),
        LineValue(name="unused"),
    ),
)


def read(device: LineDevice, lines: bytes) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Return the values that a reader of the sender's own format finds in lines, in the columns' units."""
    numbers = device.model_copy(update={"pattern": ""}).reader().feed(b"\n" + lines)
    return np.array(numbers) * [device.factor(value) for value in device.in_order()]


def sent(device: LineDevice, name: str, *, until_s: float, faults: EncoderFaults | None = None) -> bytes:
    sender = LineSender(device, lambda time_s: {name: 0.001 * math.sin(time_s)}, powered_s=10.0)
    port = FaultySerial(sender, faults or EncoderFaults(), opened_s=10.0)
    times = np.arange(10.0, 10.0 + until_s, 0.1)
    return b"".join(line for time_s in times for _, line in port.due(float(time_s)))


def test_a_torque_by_an_arm_comes_back_with_the_devices_clock() -> None:
    stamp_us, torque_nm = read(CELL, sent(CELL, "Tz", until_s=5)).T

    assert len(torque_nm) == pytest.approx(400, abs=10)
    assert np.diff(stamp_us) == pytest.approx(12500, abs=1000)
    expected = 0.001 * np.sin(10 + 1e-6 * stamp_us)
    assert torque_nm == pytest.approx(expected, abs=2e-6)  # for whole milligrams at 50 mm, and whole milliseconds
