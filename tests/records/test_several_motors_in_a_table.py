"""Tables of several motors below each other in one file: rows of one are chosen, and a new header ends a table."""

import re
from pathlib import Path

import numpy as np
import pytest

from cfid.errors import ConfigError, DataError
from cfid.findings import texts
from cfid.records.tables.stand import StandTable, read_stand_table

HEAD = "Propeller,Throttle (%),Voltage (V),Thrust (gf),RPM"
THROTTLES = (30, 40, 50, 60, 70, 80, 90, 100)


def rows(name: str, times: float = 1.0, throttles: tuple[int, ...] = THROTTLES) -> list[str]:
    return [f"{name},{throttle},16,{times * throttle**2 / 50:.1f},{95 * throttle}" for throttle in throttles]


def read(folder: Path, *lines: str, columns: tuple[str, ...] = (), skip_lines: int = 0) -> StandTable:
    (folder / "stand.csv").write_text("\n".join([*lines, ""]))
    return read_stand_table(folder / "stand.csv", columns=columns, skip_lines=skip_lines)


def said(table: StandTable) -> str:
    return " ".join(texts(table.findings, "warning"))


@pytest.fixture
def propellers() -> list[str]:
    return [HEAD, *rows("T5143"), *rows("T5147", 1.05), *rows("T5150", 1.1)]


def test_rows_of_several_propellers_are_asked_about(tmp_path: Path, propellers: list[str]) -> None:
    with pytest.raises(DataError, match=r"'Propeller' \(T5143, T5147, T5150\).*`columns`, as in Propeller=T5143, or"):
        read(tmp_path, *propellers)


def test_those_of_one_are_chosen_by_its_name(tmp_path: Path, propellers: list[str]) -> None:
    table = read(tmp_path, *propellers, columns=("Propeller=T5147",))
    assert table.thrust_n is not None
    assert table.thrust_n[-1] == pytest.approx(1.05 * 200 * 9.80665e-3)
    assert len(table.command) == len(THROTTLES)
    assert "8 of 24 rows, whose 'Propeller' is 'T5147'" in said(table)
    assert "not used" not in said(table)


def test_a_choice_goes_together_with_the_name_of_a_column(tmp_path: Path, propellers: list[str]) -> None:
    head = HEAD.replace("Thrust (gf)", "Lift")
    table = read(tmp_path, head, *propellers[1:], columns=("Propeller=T5150", "Thrust (gf)=4"))
    assert table.thrust_n is not None
    assert table.thrust_n[-1] == pytest.approx(1.1 * 200 * 9.80665e-3)


def test_all_are_taken_as_one_motors_where_that_is_said(tmp_path: Path, propellers: list[str]) -> None:
    assert len(read(tmp_path, *propellers, columns=("Propeller=*",)).command) == 24


def test_a_name_that_no_row_has_is_refused_with_those_there_are(tmp_path: Path, propellers: list[str]) -> None:
    with pytest.raises(ConfigError, match=r"Propeller=T99: no row has that. 'Propeller' is T5143, T5147, T5150"):
        read(tmp_path, *propellers, columns=("Propeller=T99",))


@pytest.mark.parametrize(
    ("head", "names"), [("Propeller", ("5143", "5147")), ("Prop diameter (in)", ("5", "5.1")), ("Motor", ("1", "2"))]
)
def test_numbers_that_name_propellers_or_motors_are_asked_about_and_choose(
    tmp_path: Path, head: str, names: tuple[str, str]
) -> None:
    lines = [HEAD.replace("Propeller", head), *rows(names[0]), *rows(names[1], 1.1)]
    with pytest.raises(DataError, match=rf"as in {re.escape(head)}={names[0]}, or take all"):
        read(tmp_path, *lines)
    table = read(tmp_path, *lines, columns=(f"{head}={names[1]}",))
    assert table.thrust_n is not None
    assert table.thrust_n[-1] == pytest.approx(1.1 * 200 * 9.80665e-3)


def test_a_name_in_the_first_row_of_each_block_holds_for_the_block(tmp_path: Path) -> None:
    first, second = rows("A"), rows("B", 1.1)
    lines = [HEAD, *(row if row in (first[0], second[0]) else row[1:] for row in (*first, *second))]
    with pytest.raises(DataError, match=r"'Propeller' \(A, B\)"):
        read(tmp_path, *lines)
    assert len(read(tmp_path, *lines, columns=("Propeller=B",)).command) == len(THROTTLES)


def test_propellers_that_were_driven_by_commands_of_their_own_are_asked_about(tmp_path: Path) -> None:
    others = tuple(throttle - 5 for throttle in THROTTLES)
    with pytest.raises(DataError, match="Propeller=A"):
        read(tmp_path, HEAD, *rows("A"), *rows("B", 1.1, others))


def test_a_name_that_stands_alone_above_its_rows_is_refused_with_its_line(tmp_path: Path) -> None:
    first, second = ([row.partition(",")[2] for row in rows("", times)] for times in (1.0, 1.1))
    with pytest.raises(DataError, match=r"stand.csv:2: 'T5143,,,' stands alone between the header and its rows"):
        read(tmp_path, HEAD.partition(",")[2], "T5143,,,", *first, "T5147,,,", *second)


@pytest.mark.parametrize(
    "remarks", [["", "settled late", "", "gust", "", "", "", "ok"], [f"step {i}" for i in range(8)]]
)
def test_remarks_divide_no_table(tmp_path: Path, remarks: list[str]) -> None:
    lines = [row.replace("T,", f"{remark},") for row, remark in zip(rows("T"), remarks, strict=True)]
    assert len(read(tmp_path, HEAD.replace("Propeller", "Remark"), *lines, *lines).command) == 16


def test_stretches_of_a_recording_are_asked_about_and_states_that_come_and_go_are_not(tmp_path: Path) -> None:
    lines = [f"{0.02 * i:.2f},{1000 + 100 * (i // 20 % 10)},{(i // 20 % 10) ** 2},{{}}" for i in range(400)]
    head = "Time (s),ESC signal (µs),Thrust (gf),Prop"
    with pytest.raises(DataError, match="Prop=A"):
        read(tmp_path, head, *(line.format("A" if i < 200 else "B") for i, line in enumerate(lines)))
    states = read(
        tmp_path,
        head.replace("Prop", "Motor state"),
        *(line.format("hold" if i % 20 else "step") for i, line in enumerate(lines)),
    )
    assert len(states.command) == 400


@pytest.mark.parametrize(
    "head", ["Throttle (%),Voltage (V),Thrust (gf),RPM", "RPM,Voltage (V),Thrust (kgf),Throttle (%)"]
)
def test_another_header_ends_a_table_and_what_follows_is_read_from_there(tmp_path: Path, head: str) -> None:
    first, second = ([row.partition(",")[2] for row in rows("T", times)] for times in (1.0, 1.3))
    lines = ["Throttle (%),Voltage (V),Thrust (gf),RPM", *first, "Throttle (%),Voltage (V),Thrust (gf),RPM", *second]
    lines[9] = head
    above = read(tmp_path, *lines)
    assert above.thrust_n is not None
    assert above.thrust_n[-1] == pytest.approx(200 * 9.80665e-3)
    assert "line 10 is another header: the 8 rows below it are of another table, and not used" in said(above)
    assert "`skip_lines` 9" in said(above)
    if head == lines[0]:
        below = read(tmp_path, *lines, skip_lines=9)
        assert below.thrust_n is not None
        assert below.thrust_n[-1] == pytest.approx(1.3 * 200 * 9.80665e-3)


def swing_of(seconds: np.ndarray, head: str, factor: float = 1.0) -> list[str]:
    angles = factor * 0.5 * np.cos(5 * seconds)
    return [head, *(f"{t:.3f},{angle:.6f}" for t, angle in zip(seconds, angles, strict=True))]


def recording(begin: int, rows: int, first_ms: int) -> list[str]:
    steps = ((first_ms + 20 * i, 1000 + 100 * ((begin + i) // 50)) for i in range(rows))
    return [f"{t / 1000:.2f},{pulse},{(pulse - 1000) / 4:.1f},{10 * (pulse - 1000)}" for t, pulse in steps]


def test_a_header_that_is_repeated_where_times_go_on_is_left_out(tmp_path: Path) -> None:
    head = "Time (s),ESC signal (µs),Thrust (gf),RPM"
    table = read(tmp_path, head, *recording(0, 225, 0), head, *recording(225, 225, 4_500))
    assert table.time_s is not None
    assert len(table.time_s) == 450
    assert table.time_s[-1] == pytest.approx(8.98)
    assert "1 line repeats the header (first: line 227), and times go on: no row, and left out" in said(table)
    twice = read(tmp_path, head, *recording(0, 225, 0), head, *recording(225, 225, 4_500), head, *recording(450, 50, 0))
    assert twice.time_s is not None
    assert len(twice.time_s) == 450
    assert "line 453 is another header: the 50 rows below it are of another table" in said(twice)


def test_a_second_speed_that_is_named_after_motors_tells_none_apart(tmp_path: Path) -> None:
    head = "Time (s),ESC signal (µs),Thrust (gf),Motor Electrical Speed (RPM),Motor Optical Speed (RPM)"
    rows_of_both = [f"{row},{round(float(row.rpartition(',')[2]), -3):.0f}" for row in recording(0, 450, 0)]
    assert len(read(tmp_path, head, *rows_of_both).command) == 450
