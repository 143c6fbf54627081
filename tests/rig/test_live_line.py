"""The line under a recording: what matters most comes first, and fits a terminal of 80 columns."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from cfid.console.live import line_of
from cfid.rig.recorder import Block, Progress, Recorder
from cfid.rig.shown import degrees, vertical_force, volts

COLUMNS = 80
SECOND_S, BLOCK_S = 1.0, 0.05


class Named:
    """An instrument that is asked for nothing but its name."""

    def __init__(self, name: str) -> None:
        self.name = name


class Stopped:
    """A loop whose clock shows one time."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def seconds(self) -> float:
        return self.now_s


def recorder_of(**readings: Callable[[Progress], str] | None) -> tuple[Any, Stopped]:
    loop: Any = Stopped()
    instruments: list[Any] = [Named(name) for name in readings]
    recorder = Recorder(instruments, None, loop=loop, show=lambda: None)  # type: ignore[arg-type]
    for name, reading in readings.items():
        recorder.progress[name].reading = reading
    return recorder, loop


def staircase(left_s: float = 823.4) -> Any:
    """Return a recorder of a staircase: a load cell with an offset of 5 N, a battery, commands and a state."""
    recorder, loop = recorder_of(
        commands=None, loadcell=partial(vertical_force, 1e6), supervisor=None, crazyflie=partial(volts, 1)
    )
    recorder.for_s = 900.0
    rows = {"loadcell": 350, "crazyflie": 5, "supervisor": 1, "commands": 0}
    for block in range(40):
        loop.now_s = block * BLOCK_S
        at_rest = loop.now_s < SECOND_S
        force = 5e6 + (0.0 if at_rest else 123e3)
        for name, count in rows.items():
            values = {"loadcell": (0, 0, force), "crazyflie": (1, 3.92)}.get(name, (1,))
            columns = [np.zeros(count), *(np.full(count, value) for value in values)]
            lost = 7 if name == "loadcell" and block == 20 else 0
            recorder.progress[name].add(
                Block(columns, lost, status="deck fault" if name == "supervisor" else ""),
                loop.now_s,
                at_rest=at_rest,
            )
    loop.now_s = 900.0 - left_s
    return recorder


def test_time_left_force_battery_state_losses_and_rate_fit_80_columns() -> None:
    line = line_of(staircase(), task="command 20000 (9 of 33)")

    assert line[: COLUMNS - 1].startswith(
        "13:43 min left  Fz   123 mN  3.92 V  deck fault  7 LOST  7000+100 Hz  comman"
    )


def test_the_force_is_shown_above_its_tare() -> None:
    assert "Fz   123 mN" in line_of(staircase())


def test_a_question_and_what_is_typed_come_before_all_else() -> None:
    line = line_of(staircase(), question="RPM at command 20000 (u undoes 11800) > 12")

    assert line.startswith("RPM at command 20000 (u undoes 11800) > 12  13:43 min left")


@pytest.mark.parametrize(
    ("for_s", "now_s", "shown"), [(20.0, 2.5, "17.5 s left"), (None, 2.5, "2.5 s"), (5.0, 9.0, "0.0 s left")]
)
def test_time_counts_down_where_the_end_is_known(for_s: float | None, now_s: float, shown: str) -> None:
    recorder, loop = recorder_of(encoder=partial(degrees, 360))
    recorder.for_s = for_s
    loop.now_s = now_s

    assert line_of(recorder).strip() == f"{shown}  0 lost"


def test_an_angle_is_that_of_the_latest_row() -> None:
    recorder, loop = recorder_of(encoder=partial(degrees, 360))
    recorder.progress["encoder"].add(Block((np.zeros(2), np.array([359, 361]))), loop.now_s)

    assert "  1.0 deg" in line_of(recorder)
