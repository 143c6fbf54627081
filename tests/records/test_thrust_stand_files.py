"""Files of RCbenchmark's and Tyto's stands, byte by byte as their programs write them and as people save them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.errors import ConfigError, DataError
from cfid.findings import texts
from cfid.records.logs.kinds import kind_at
from cfid.records.tables.schema import Foreign
from cfid.records.tables.stand import StandTable, read_stand_table
from cfid.units import RPM

GF = 9.80665e-3
NAMES = (
    "Time (s),ESC signal (µs),Servo 1 (µs),AccX (g),Torque (N·m),Thrust (gf),Voltage (V),Current (A),"
    "Motor Electrical Speed (RPM),Motor Optical Speed (RPM),Electrical Power (W),Vibration (g),App message"
)
# time, pulse, torque, thrust, voltage, electrical and optical speed
STEPS = [
    (0.42, 1000, 0.0, 0.0, 8.0, 0, 0),
    (0.38, 1250, 0.001, 10.0, 7.9, 9000, 0),
    (4.31, 1500, 0.002, 25.0, 7.8, 14000, 0),
    (8.32, 2000, 0.004, 60.0, 7.5, 22000, 0),
]


def notes_of(table: StandTable) -> tuple[str, ...]:
    return texts(table.findings, "warning")


def text_of(rows: list[tuple[Any, ...]] = STEPS, head: str = NAMES) -> str:
    """Return a file in which every line ends with a comma and no servo has values."""
    lines = [
        f"{t},{esc},,0.01,{torque},{thrust},{volts},1.5,{el},{opt},12,0.2,,"
        for t, esc, torque, thrust, volts, el, opt in rows
    ]
    return "\n".join([f"{head},", *lines, ""])


def read(folder: Path, text: str | bytes, **options: Any) -> StandTable:
    path = folder / "stand.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_stand_table(path, **options)


def refusal(folder: Path, text: str, kind: type[Exception] = DataError, **options: Any) -> str:
    with pytest.raises(kind) as caught:
        read(folder, text, **options)
    return str(caught.value)


SPELLINGS: dict[str, str | bytes] = {
    "as the program writes it": text_of(),
    "a byte-order mark": "\ufeff" + text_of(),
    "another micro sign and dot": text_of().replace("µ", "μ").replace("·", "⋅"),
    "us and a point": text_of().replace("µ", "u").replace("·", "."),
    "Latin-1": text_of().encode("latin-1"),
    "UTF-8 taken for Latin-1": text_of().encode().decode("latin-1"),
    "signs that were lost": text_of().replace("µ", "�").replace("·", "�"),
    "CRLF": text_of().replace("\n", "\r\n"),
    "semicolons": text_of().replace(",", ";"),
    "semicolons and decimal commas": text_of().replace(",", ";").replace(".", ",").replace("N,m", "N.m"),
    "the comma at the end of the rows alone": text_of().replace("message,\n", "message\n").replace(",,\n", ",\n"),
}


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_a_stand_is_read_the_same_with(tmp_path: Path, spelling: str) -> None:
    table = read(tmp_path, SPELLINGS[spelling])

    assert table.command.tolist() == [0, 16384, 32768, 65535]
    assert np.asarray(table.thrust_n) == pytest.approx(GF * np.array([0, 10, 25, 60]))
    assert np.asarray(table.torque_nm).tolist() == [0, 0.001, 0.002, 0.004]
    assert np.asarray(table.vbat_v).tolist() == [8, 7.9, 7.8, 7.5]
    assert np.asarray(table.speeds_rad_s)[:, 0] == pytest.approx(RPM * np.array([0, 9000, 14000, 22000]))
    assert (table.motors, table.speeds) == (None, "motor")


@pytest.mark.parametrize(
    ("column", "factor"),
    [("Thrust (N)", 1.0), ("Thrust (kgf)", 9.80665), ("Thrust (lbf)", 4.4482216), ("Thrust (ozf)", 0.27801385)],
)
def test_thrust_is_read_in_the_unit_of_its_column(tmp_path: Path, column: str, factor: float) -> None:
    table = read(tmp_path, text_of(head=NAMES.replace("Thrust (gf)", column)))
    assert np.asarray(table.thrust_n) == pytest.approx(factor * np.array([0, 10, 25, 60]))


@pytest.mark.parametrize(
    ("column", "factor"), [("Torque (N·mm)", 1e-3), ("Torque (lbf·in)", 0.11298483), ("Torque (ozf·in)", 7.0615518e-3)]
)
def test_torque_is_read_in_the_unit_of_its_column(tmp_path: Path, column: str, factor: float) -> None:
    table = read(tmp_path, text_of(head=NAMES.replace("Torque (N·m)", column)))
    assert np.asarray(table.torque_nm) == pytest.approx(factor * np.array([0, 0.001, 0.002, 0.004]))


def test_a_line_of_units_below_the_head_states_them(tmp_path: Path) -> None:
    names = "Time,ESC signal,Thrust,Motor Optical Speed,Voltage\ns,us,gf,RPM,V\n"
    table = read(tmp_path, names + "0,1000,0,0,8\n4,1500,10,9000,7.9\n8,2000,60,22000,7.5\n")
    assert np.asarray(table.thrust_n) == pytest.approx(GF * np.array([0, 10, 60]))
    assert np.asarray(table.speeds_rad_s)[:, 0] == pytest.approx(RPM * np.array([0, 9000, 22000]))


def test_an_electrical_speed_is_taken_as_the_rotors_with_what_that_needs(tmp_path: Path) -> None:
    text = "ESC signal (us),Thrust (gf),Motor Electrical Speed (RPM)\n1000,0,0\n1500,10,9000\n2000,60,22000\n"
    assert "knew the motor's poles" in " ".join(one.text for one in read(tmp_path, text).findings)


def test_one_side_of_a_double_stand_is_read_and_two_are_asked_about(tmp_path: Path) -> None:
    head = NAMES.replace("ESC signal", "ESC B").replace("Thrust", "Thrust B").replace("Torque", "Torque B")
    assert read(tmp_path, text_of(head=head)).command.tolist() == [0, 16384, 32768, 65535]
    both = text_of(head=head.replace("AccX (g)", "Thrust A (gf)"))
    assert "more than one column of thrust: Thrust A (gf), Thrust B (gf)" in refusal(tmp_path, both)


def test_the_range_of_pulses_is_said_where_it_is_assumed_and_can_be_given(tmp_path: Path) -> None:
    message = "stand.csv: pulse widths are read as `esc_us` 1000,2000, commands 0 to 65535."
    assert message in notes_of(read(tmp_path, text_of()))
    given = read(tmp_path, text_of(), esc_us=(1100.0, 2200.0))
    assert given.command == pytest.approx(np.rint([0, 65535 * 150 / 1100, 65535 * 400 / 1100, 65535 * 900 / 1100]))
    assert "1 row has pulses below 1100 us: motors stand there, command 0" in " ".join(notes_of(given))
    assert not any("`esc_us`" in note for note in notes_of(given))
    longer = refusal(tmp_path, text_of(), esc_us=(1000.0, 1900.0))
    assert "stand.csv:5: 2000 us in 'ESC signal (µs)' is longer than the full throttle of `esc_us` 1000,1900" in longer
    assert "'cmd' has another unit" in refusal(tmp_path, "cmd,thrust_n\n0,0\n", ConfigError, esc_us=(1000.0, 2000.0))


def test_a_puller_that_is_mounted_the_other_way_is_turned_and_that_is_said(tmp_path: Path) -> None:
    rows = [(t, esc, -torque, -thrust, *rest) for t, esc, torque, thrust, *rest in STEPS]
    table = read(tmp_path, text_of(rows))

    assert np.asarray(table.thrust_n) == pytest.approx(GF * np.array([0, 10, 25, 60]))
    assert np.asarray(table.torque_nm) == pytest.approx([0, 0.001, 0.002, 0.004])
    assert "stand.csv: 'Thrust (gf)' falls as the motor is driven harder: its sign is changed." in texts(
        table.findings, "warning"
    )
    assert "stand.csv: 'Torque (N·m)' falls as the motor is driven harder: its sign is changed." in texts(
        table.findings, "warning"
    )


def test_rows_seconds_apart_are_settled_points_and_that_is_said(tmp_path: Path) -> None:
    table = read(tmp_path, text_of())

    assert table.time_s is None
    assert "stand.csv: rows are 3.9 s apart: each is taken as a settled point." in notes_of(table)
    assert texts(table.findings, "note")[0].startswith(
        "stand.csv: 4 settled points: command from 'ESC signal (µs)', torque from"
    )


def test_rows_that_follow_quickly_are_a_recording_whose_clock_may_jitter(tmp_path: Path) -> None:
    rows = [(f"{0.01 * i:.3f}", 1000 + 500 * (i >= 40), 0, i, 8, i, i) for i in range(80)]
    rows[21], rows[22] = rows[22], rows[21]
    table = read(tmp_path, text_of(rows))

    assert np.asarray(table.time_s) == pytest.approx(0.01 * np.arange(80))
    assert np.asarray(table.thrust_n) == pytest.approx(GF * np.arange(80))
    assert "time goes back in 1 row, by 0.01 at most" in " ".join(notes_of(table))
    assert "a recording of 0.79 s in 80 rows, 100 Hz" in texts(table.findings, "note")[0]


def test_a_gap_in_a_recording_is_named_with_its_line(tmp_path: Path) -> None:
    rows = [(f"{0.01 * i + 60 * (i >= 50):.3f}", 1000 + 500 * (i >= 40), 0, i, 8, i, i) for i in range(80)]
    table = read(tmp_path, text_of(rows))
    assert "1 gap without rows, the longest of 60 s after line 51 (0.49 s)" in " ".join(notes_of(table))


def test_load_cells_that_are_read_less_often_are_missing_in_between(tmp_path: Path) -> None:
    rows = [(f"{0.01 * i:.3f}", 1500 if i >= 10 else "", "", i if i % 4 == 0 else "", 8, i, 0) for i in range(80)]
    table = read(tmp_path, text_of(rows))

    assert len(table.command) == 70
    assert np.count_nonzero(np.isfinite(np.asarray(table.thrust_n))) == 17
    notes = " ".join(notes_of(table))
    assert "10 rows without a time or command (first: line 2) are left out." in notes
    assert "'Thrust (gf)' is no number in 53 of 80 rows (first: line 12)." in notes
    assert "'Torque (N·m)' holds no number: it is not used." in notes


def test_the_speed_is_that_of_the_sensor_that_sees_the_rotor(tmp_path: Path) -> None:
    optical = [(*row[:5], 0, row[5]) for row in STEPS]
    assert np.asarray(read(tmp_path, text_of(optical)).speeds_rad_s)[-1] == pytest.approx(22000 * RPM)
    neither = read(tmp_path, text_of([(*row[:5], 0, 0) for row in STEPS]))
    assert neither.speeds_rad_s is None
    assert any("are 0 throughout: no speed is used" in note for note in notes_of(neither))
    assert not any("no known unit" in note for note in notes_of(neither))
    lost = read(tmp_path, text_of([(*row[:5], row[5] if row[1] != 1250 else 0, 0) for row in STEPS]))
    assert np.isnan(np.asarray(lost.speeds_rad_s)[1, 0])
    assert any("shows 0 in 1 row in which rotors turn" in note for note in notes_of(lost))


def test_two_sensors_of_speed_that_disagree_give_the_optical_one_and_the_option_for_the_other(tmp_path: Path) -> None:
    text = text_of([(*row[:5], 7 * row[5], row[5]) for row in STEPS])
    table = read(tmp_path, text)

    assert np.asarray(table.speeds_rad_s)[:, 0] == pytest.approx(RPM * np.array([0, 9000, 14000, 22000]))
    said = next(note for note in notes_of(table) if "times" in note)
    assert "'Motor Electrical Speed (RPM)' is 7 times 'Motor Optical Speed (RPM)' (median of 3 rows)" in said
    option = said.partition("as in ")[2].rstrip(".")
    other = read(tmp_path, text, columns=(option,))
    assert np.asarray(other.speeds_rad_s)[-1] == pytest.approx(7 * RPM * 22000)


def test_two_speeds_that_disagree_of_which_none_is_optical_are_asked_about(tmp_path: Path) -> None:
    text = "cmd,thrust_n,rpm,omega_rad_s\n0,0,0,0\n20000,0.1,9000,471\n40000,0.2,18000,943\n"
    said = refusal(tmp_path, text)
    assert "'rpm' is 2 times 'omega_rad_s' (median of 2 rows). Name the right one by `columns`, as in" in said


def test_the_speed_that_is_seen_in_few_rows_does_not_replace_one_that_is_seen_in_all(tmp_path: Path) -> None:
    table = read(tmp_path, text_of([(*row[:5], row[5], 500 if row[1] == 1500 else 0) for row in STEPS]))
    assert np.asarray(table.speeds_rad_s)[:, 0] == pytest.approx(RPM * np.array([0, 9000, 14000, 22000]))


def test_a_line_of_units_may_repeat_the_name_of_the_speed(tmp_path: Path) -> None:
    table = read(tmp_path, "Time,ESC,Thrust,RPM\ns,us,N,rpm\n0,1000,0,0\n4,1500,0.1,9000\n8,2000,0.4,22000\n")
    assert np.asarray(table.speeds_rad_s)[:, 0] == pytest.approx(RPM * np.array([0, 9000, 22000]))


def test_a_sensor_that_is_dead_for_a_while_is_missing_under_a_small_thrust_too(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    pulses = np.repeat([1000, 1150, 1400, 2000, 1150, 1000], 40)
    rpm = 12.0 * (pulses - 1000)
    offset = 0.03  # a load cell that is not tared
    thrust = offset + 1.2e-8 * rpm**2 + 1e-4 * rng.standard_normal(len(pulses))
    rpm[60:170] = 0  # starts within the smallest command
    rows = [(f"{at / 50}", pulses[at], 0, f"{thrust[at] / GF:.6f}", 8, f"{rpm[at]}", 0) for at in range(len(pulses))]
    speed = np.asarray(read(tmp_path, text_of(rows)).speeds_rad_s)[:, 0]

    assert np.flatnonzero(np.isnan(speed)).tolist() == list(range(60, 170))
    assert np.all(speed[pulses == 1000] == 0)


def test_a_settled_point_with_thrust_and_no_speed_is_missing_below_the_first_speed_that_shows(tmp_path: Path) -> None:
    rows = [(0.4, 1050, 0, 6.1, 7.4, 0, 0), (2.2, 1145, 0, 14.6, 7.4, 3853, 0), (9, 2000, 0, 400, 7.1, 18600, 0)]
    assert np.isnan(np.asarray(read(tmp_path, text_of(rows)).speeds_rad_s)[:, 0]).tolist() == [True, False, False]


def test_a_stand_with_two_sensors_of_speed_is_known_as_one(tmp_path: Path) -> None:
    head = "Time (s),ESC signal (µs),Thrust (gf),Motor Electrical Speed (RPM),Motor Optical Speed (RPM),\n"
    path = tmp_path / "log"
    path.write_text(head + "0,1000,0,0,0,\n1.7,1100,20,3000,0,\n", encoding="utf-8")
    assert kind_at(path, Foreign()) == "stand"
    path.write_text("Time (s),Motor Electrical Speed (RPM),Voltage (V)\n0,0,4\n1,3000,4\n")
    assert kind_at(path, Foreign()) is None


def test_a_voltage_whose_leads_were_not_connected_is_left_out_and_named(tmp_path: Path) -> None:
    table = read(tmp_path, text_of([(*row[:4], 0, *row[5:]) for row in STEPS]))
    assert table.vbat_v is None
    assert np.asarray(table.thrust_n)[-1] == pytest.approx(60 * GF)
    assert any("'Voltage (V)' is 0 throughout" in note for note in notes_of(table))


def test_a_voltage_that_is_lost_for_a_while_is_missing_there(tmp_path: Path) -> None:
    table = read(tmp_path, text_of([(*row[:4], 0 if row[1] > 1400 else 7.9, *row[5:]) for row in STEPS]))
    assert np.array_equal(np.asarray(table.vbat_v), [7.9, 7.9, np.nan, np.nan], equal_nan=True)
    assert any("'Voltage (V)' is 0 in 2 rows" in note for note in notes_of(table))


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize(
    ("after", "said"), [(5, "line 6, 'Test finished by user', has no number and is left out"), (3, "line 4")]
)
def test_a_line_of_words_among_the_rows_or_below_them_is_named_and_left_out(
    tmp_path: Path, separator: str, after: int, said: str
) -> None:
    lines = text_of().splitlines()
    lines.insert(after, "Test finished by user")
    table = read(tmp_path, "\n".join([*lines, ""]).replace(",", separator))
    assert table.command.tolist() == [0, 16384, 32768, 65535]
    assert any(said in note for note in notes_of(table))


def test_a_line_that_has_a_number_is_never_taken_for_words(tmp_path: Path) -> None:
    lines = text_of().splitlines()
    for damaged in ("12.5,Test finished", "1500", "nan", "0.1,0.2,"):
        rows = "\n".join([*lines[:3], damaged, *lines[3:], ""])
        assert "stand.csv:4: " in refusal(tmp_path, rows)


def test_milliseconds_that_a_header_states_are_not_doubted_for_seconds(tmp_path: Path) -> None:
    rows = "".join(f"{20 * at},{1000 + 500 * (at >= 40)},{at}\n" for at in range(80))
    table = read(tmp_path, "time[ms],esc[us],thrust[g]\n" + rows)
    assert np.asarray(table.time_s)[-1] == pytest.approx(1.58)
    assert not any("is it not in s?" in note for note in notes_of(table))


def test_grams_of_one_motor_are_a_weight_and_the_gravity_is_stated(tmp_path: Path) -> None:
    table = read(tmp_path, "esc[us],thrust[g]\n1000,0\n1500,20\n2000,60\n", gravity_mps2=9.7)
    assert np.asarray(table.thrust_n)[-1] == pytest.approx(0.06 * 9.7)
    assert "stand.csv: 'thrust[g]' is a weight: grams by 9.7 m/s^2." in notes_of(table)


def test_a_recording_without_a_time_is_asked_for_its_rate(tmp_path: Path) -> None:
    head = "ESC signal (µs),Thrust (gf)\n"
    held = head + "".join(f"{1000 + 100 * (i // 5)},{i}\n" for i in range(30))
    assert "30 rows are a recording, and no column is its time: give `rate_hz`" in refusal(tmp_path, held)
    assert np.asarray(read(tmp_path, held, rate_hz=10.0).time_s)[-1] == pytest.approx(2.9)
    assert read(tmp_path, head + "1000,0\n1500,20\n2000,60\n").time_s is None
