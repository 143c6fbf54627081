"""The line under a recording: present values, losses, and silences."""

import math
from collections.abc import Collection
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.console.live import fitting, line_of
from cfid.rig.instrument import Block
from cfid.rig.progress import Reading, degrees, displayed, first_force, volts
from cfid.rig.recorder import Recorder
from cfid.wire.rls import RLS_13BIT_IN_22, encode_positions

BLOCK_S = 0.05


class Live:
    """A recorder whose instruments have only a reading, on a clock that the test sets."""

    def __init__(self, for_s: float | None = None, **readings: Reading | None) -> None:
        self.now_s = 0.0
        hardware: Any = SimpleNamespace(seconds=lambda: self.now_s)
        instruments: list[Any] = [SimpleNamespace(name=name, reading=reading) for name, reading in readings.items()]
        sink: Any = None
        self.recorder = Recorder(instruments, sink, hardware, show=lambda _: None, for_s=for_s)

    def add(self, name: str, *values: float, rows: int = 1, lost: int | None = 0, **options: Any) -> None:
        """Add a block of equal rows of an instrument."""
        status = options.pop("status", "")
        columns = [np.zeros(rows), *(np.full(rows, value) for value in values)]
        self.recorder.progress[name].add(Block(columns, lost, status=status), self.now_s, **options)

    def line(self, **options: Any) -> list[str]:
        return line_of(self.recorder, **options)


def test_losses_that_nobody_can_count_are_unknown_and_not_zero() -> None:
    live = Live(scales=None, loadcell=None)
    live.add("scales", 0, lost=None)
    assert "losses unknown" in live.line()
    assert "0 lost" not in live.line()
    live.add("loadcell", 0, lost=3)
    assert "3 LOST" in live.line()


def words(*positions: int) -> list[npt.NDArray[np.int64]]:
    return [encode_positions(np.array([position])) for position in positions]


@pytest.mark.parametrize(
    ("reading", "values", "shown"),
    [
        (degrees(360), [200, 203, 190], "-10.0 deg"),
        (degrees(360), [359, 0, 1], "2.0 deg"),
        (degrees(360), [5, 365, 720 - 3], "-8.0 deg"),
        (degrees(math.tau), [3.0, 3.0 + math.radians(12)], "12.0 deg"),
        (degrees(RLS_13BIT_IN_22), [*words(8000, 8192 - 1, 91)], f"{360 * (91 + 192) / 8192:.1f} deg"),
        (displayed("rpm"), [9000.2, 13537.4], "13537 rpm"),
        (volts(0), [3.5, 3.92], "3.92 V"),
        (first_force("Tz"), [-0.00004], "Tz     0 mNm"),  # what rounds to zero has no sign
    ],
)
def test_an_angle_is_shown_from_the_first_row_and_other_values_as_they_are(
    reading: Reading, values: list[float], shown: str
) -> None:
    live = Live(encoder=reading)
    for value in values:
        live.add("encoder", value)

    assert live.line()[1].strip() == shown


TENTHS = [0.1 * row for row in range(10)]


@pytest.mark.parametrize(
    ("arrivals_s", "until_s", "silent"),
    [
        (TENTHS, 2.15, "1.2"),
        ([], 1.55, "1.5"),  # from the beginning
        ([1.0 * row for row in range(6)], 15.05, "10.0"),  # and not in between
        ([*TENTHS, *(5.0 + row for row in TENTHS)], 7.05, "1.1"),  # whatever silence came before
    ],
)
def test_a_silent_device_shows_no_old_value(arrivals_s: Collection[float], until_s: float, silent: str) -> None:
    live = Live(crazyflie=volts(0))
    blocks = {round(arrival_s / BLOCK_S) for arrival_s in arrivals_s}
    shown = []
    for block in range(round(until_s / BLOCK_S)):
        live.now_s = block * BLOCK_S
        live.add("crazyflie", 3.92, rows=int(block in blocks))
        shown.append(live.line()[1])

    assert shown[-1] == f"crazyflie: no data {silent} s"
    assert {text for block, text in enumerate(shown) if block in blocks} <= {"3.92 V"}
    assert silent != "10.0" or {"3.92 V"} == set(shown[20:160])


def test_a_narrow_terminal_keeps_the_latest_part_of_the_trace() -> None:
    parts = ["  12.3 s left", "x 31.2 deg", "1000 Hz", "▁▂▃▄▅▆▇█" * 5]

    assert fitting(parts, 60) == "  12.3 s left  x 31.2 deg  1000 Hz  " + ("▁▂▃▄▅▆▇█" * 5)[-24:]
    assert fitting(parts, 40) == "  12.3 s left  x 31.2 deg  1000 Hz"
