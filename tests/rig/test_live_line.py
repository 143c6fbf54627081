"""The line under a recording: what matters most comes first, and the line fits a terminal of 80 columns."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cfid.console.live import asking, fitting, line_of
from cfid.rig.instrument import Block
from cfid.rig.progress import Reading
from cfid.rig.recorder import Recorder
from cfid.rig.shown import degrees, displayed, first_force, vertical_force, volts
from cfid.wire.rls import RLS_13BIT_IN_22, encode_positions

COLUMNS = 80
SECOND_S, BLOCK_S = 1.0, 0.05


class StandingStill:
    """A computer whose clock the test sets."""

    now_s = 0.0

    def seconds(self) -> float:
        return self.now_s


def recorder_of(**readings: Reading | None) -> tuple[Any, StandingStill]:
    hardware: Any = StandingStill()
    instruments: list[Any] = [SimpleNamespace(name=name, reading=reading) for name, reading in readings.items()]
    sink: Any = None
    return Recorder(instruments, sink, hardware, show=lambda _: None), hardware


def staircase(left_s: float = 823.4, state: str = "ready") -> Any:
    """Return a recorder of a staircase: a load cell with an offset of 5 N, a battery, commands and a state."""
    recorder, hardware = recorder_of(commands=None, loadcell=vertical_force(1e6), supervisor=None, crazyflie=volts(1))
    recorder.for_s = 900.0
    rows = {"loadcell": 350, "crazyflie": 5, "supervisor": 1, "commands": 0}
    for block in range(40):
        hardware.now_s = block * BLOCK_S
        at_rest = hardware.now_s < SECOND_S
        force = 5e6 + (0.0 if at_rest else 123e3)
        for name, count in rows.items():
            values = {"loadcell": (0, 0, force), "crazyflie": (1, 3.92)}.get(name, (1,))
            columns = [np.zeros(count), *(np.full(count, value) for value in values)]
            lost = 7 if name == "loadcell" and block == 20 else 0
            recorder.progress[name].add(
                Block(columns, lost, status=state if name == "supervisor" else ""),
                hardware.now_s,
                at_rest=at_rest,
            )
    hardware.now_s = 900.0 - left_s
    return recorder


def test_time_left_force_battery_state_losses_rate_and_command_fit_80_columns() -> None:
    parts = line_of(staircase(state="flying"), task="command 20000 (9 of 33)")

    line = fitting(parts, COLUMNS - 1)
    assert line == " 13:43 left  Fz  123 mN  3.92 V  flying  7 LOST  7000+100 Hz  command 20000"


def test_losses_that_nobody_can_count_are_unknown_and_not_zero() -> None:
    recorder, _ = recorder_of(scales=None, loadcell=None)
    recorder.progress["scales"].add(Block([np.zeros(1), np.zeros(1)], None), 0.0)
    assert "losses unknown" in line_of(recorder)
    assert "0 lost" not in line_of(recorder)
    recorder.progress["loadcell"].add(Block([np.zeros(1), np.zeros(1)], 3), 0.0)
    assert "3 LOST" in line_of(recorder)


def test_what_does_not_fit_is_left_out_and_not_cut() -> None:
    parts = line_of(staircase(state="deck fault, unconfirmed"), task="command 20000 (9 of 33)")

    assert fitting(parts, COLUMNS - 1).endswith("  7000+100 Hz")
    assert fitting(parts, 100).endswith("  command 20000")
    assert fitting(parts, 200) == "  ".join(parts)
    assert len(fitting(["a question (with some words) that no terminal has room for"], 20)) <= 20
    assert fitting(parts, 0) == ""


def test_the_force_is_shown_above_its_tare() -> None:
    assert "Fz  123 mN" in line_of(staircase())


def test_what_rounds_to_zero_has_no_sign() -> None:
    forms = [reading.form for reading in (vertical_force(1e6), first_force("Tz"), degrees(8192.0))]

    assert [form.format(-0.04) for form in forms] == ["Fz    0 mN", "Tz     0 mNm", "   0.0 deg"]


def test_what_is_left_then_a_question_and_what_is_typed_come_before_all_else() -> None:
    question = "RPM at command 20000 (u undoes 11800) > 12"

    assert line_of(staircase(), question=question)[0] == f" 13:43 left  {question}"
    assert line_of(staircase(), question=question, left="12 steps left")[0] == f"12 steps left  {question}"


@pytest.mark.parametrize(
    ("columns", "shown"),
    [
        (79, "RPM at command 20000, Enter for none (u undoes 15069) > 22861"),
        (59, "RPM at command 20000, Enter for none > 22861"),
        (39, "… command 20000, Enter for none > 22861"),
    ],
)
def test_a_question_shows_its_end_on_a_narrow_terminal_where_the_answer_is_typed(columns: int, shown: str) -> None:
    question = "RPM at command 20000, Enter for none (u undoes 15069) > 22861"

    assert asking(question, columns) == shown
    assert len(shown) <= columns


def test_the_trace_is_of_what_is_read_not_of_the_first_column() -> None:
    recorder, hardware = recorder_of(loadcell=vertical_force(1e3), crazyflie=volts(1))
    for block in range(3):
        recorder.progress["loadcell"].add(Block([np.zeros(5), *np.tile([[9.0], [9.0], [block]], 5)]), hardware.now_s)
        recorder.progress["crazyflie"].add(Block([np.zeros(5), *np.tile([[block], [3.9]], 5)]), hardware.now_s)

    assert list(recorder.progress["loadcell"].trace) == [0.0, 1.0, 2.0]
    assert list(recorder.progress["crazyflie"].trace) == [3.9] * 3
    assert line_of(recorder)[-1] == "▁▅█"


@pytest.mark.parametrize(
    ("for_s", "now_s", "shown"), [(20.0, 2.5, "17.5 s left"), (None, 2.5, " 2.5 s"), (5.0, 9.0, " 0.0 s left")]
)
def test_time_counts_down_where_the_end_is_known(for_s: float | None, now_s: float, shown: str) -> None:
    recorder, hardware = recorder_of(encoder=degrees(360))
    recorder.for_s = for_s
    hardware.now_s = now_s

    assert line_of(recorder) == [shown, "0 lost"]


@pytest.mark.parametrize(
    ("counts_per_turn", "counts", "shown"),
    [
        (360, [200, 203, 190], "-10.0 deg"),
        (360, [359, 0, 1], "  2.0 deg"),
        (360, [5, 365, 720 - 3], " -8.0 deg"),
        (math.tau, [3.0, 3.0 + math.radians(12)], " 12.0 deg"),
    ],
)
def test_an_angle_is_that_of_the_latest_row_from_the_first_wherever_the_encoders_zero_lies(
    counts_per_turn: float, counts: list[float], shown: str
) -> None:
    recorder, hardware = recorder_of(encoder=degrees(counts_per_turn))
    for count in counts:
        recorder.progress["encoder"].add(Block((np.zeros(1), np.array([count]))), hardware.now_s)

    assert shown in line_of(recorder)[1]


def test_an_angle_in_words_of_22_bits_is_shown_from_the_first_too() -> None:
    recorder, hardware = recorder_of(encoder=degrees(RLS_13BIT_IN_22))
    for position in (8000, 8192 - 1, 91):
        recorder.progress["encoder"].add(Block((np.zeros(1), encode_positions(np.array([position])))), hardware.now_s)

    assert line_of(recorder)[1].strip() == f"{360 * (91 + 192) / 8192:.1f} deg"


def shown_after(arrivals_s: list[float], *, until_s: float) -> list[str]:
    """Return the text about a battery's voltage after each block; the rows arrive at `arrivals_s`."""
    recorder, _ = recorder_of(crazyflie=volts(0))
    shown = []
    for block in range(round(until_s / BLOCK_S)):
        came = any(round(arrival_s / BLOCK_S) == block for arrival_s in arrivals_s)
        columns = [np.zeros(int(came)), np.full(int(came), 3.92)]
        recorder.progress["crazyflie"].add(Block(columns), block * BLOCK_S)
        shown.append(line_of(recorder)[1])
    return shown


def test_a_tachometers_latest_speed_is_shown() -> None:
    recorder, _ = recorder_of(tachometer=displayed("rpm"), crazyflie=volts(0))
    for rpm in (9000.2, 13537.4):
        recorder.progress["tachometer"].add(Block([np.zeros(1), np.full(1, rpm)]), 0.1)
    assert line_of(recorder)[1].strip() == "13537 rpm"


def test_a_silent_vehicle_shows_no_old_voltage() -> None:
    shown = shown_after([0.1 * row for row in range(10)], until_s=2.15)

    assert shown[20] == "3.92 V"
    assert shown[-1] == "crazyflie: no data 1.2 s"


def test_a_device_that_never_sends_is_silent_from_the_beginning() -> None:
    assert shown_after([], until_s=1.55)[-1] == "crazyflie: no data 1.5 s"


def test_a_device_that_sends_a_row_a_second_is_not_silent_in_between() -> None:
    shown = shown_after([1.0 * row for row in range(6)], until_s=15.05)

    assert {"3.92 V"} == set(shown[20:160])
    assert shown[-1] == "crazyflie: no data 10.0 s"


def test_a_silence_that_ended_makes_the_next_no_longer() -> None:
    regular = [0.1 * row for row in range(10)]
    shown = shown_after([*regular, *(5.0 + row for row in regular)], until_s=7.05)

    assert shown[-1] == "crazyflie: no data 1.1 s"
