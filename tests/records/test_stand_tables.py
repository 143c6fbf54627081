"""Tables, typed or from thrust stands: headers give columns in SI, or an error names the line or the known headers."""

import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import ConfigError, DataError
from cfid.findings import texts
from cfid.records.logs.kinds import kind_at
from cfid.records.tables.schema import Foreign
from cfid.records.tables.stand import StandTable, read_stand_table
from tests.places import DATA

OLD = DATA / "bitcraze_2015" / "cf20_pwm_thrust_2015.csv"
RAMP = DATA / "bitcraze_2021" / "cf2.1-stock-prop.csv"

RPM = 2 * math.pi / 60


def read(folder: Path, text: str, **options: Any) -> StandTable:
    path = folder / "stand.csv"
    path.write_text(text)
    return read_stand_table(path, **options)


def refusal(folder: Path, text: str, kind: type[Exception] = DataError, **options: Any) -> str:
    with pytest.raises(kind) as caught:
        read(folder, text, **options)
    return str(caught.value)


def notes_of(table: StandTable) -> tuple[str, ...]:
    return texts(table.findings, "warning")


def held(rows: int = 60, head: str = "weight[g],pwm") -> str:
    """Return a recording in which each pwm is held for twenty rows."""
    return "\n".join([head, *(f"{i % 7},{10000 * (i // 20)}" for i in range(rows)), ""])


# Typed tables


def test_a_table_of_one_motor_is_read_as_it_says(tmp_path: Path) -> None:
    table = read(
        tmp_path,
        "cmd,thrust_n,torque_nm,speed_rad_s,vbat_v\n0,0,0,0,4.1\n2000,0.0027,3e-5,462,4.1\n64000,0.154,9e-4,2989,3.6\n",
    )

    assert table.command.tolist() == [0, 2000, 64000]
    assert np.asarray(table.thrust_n).tolist() == [0, 0.0027, 0.154]
    assert np.asarray(table.torque_nm).tolist() == [0, 3e-5, 9e-4]
    assert np.asarray(table.square_mean_speed_rad_s).tolist() == [0, 462, 2989]
    assert np.asarray(table.vbat_v).tolist() == [4.1, 4.1, 3.6]
    assert (table.motors, table.speeds, table.time_s, table.rate_hz, notes_of(table)) == (None, "motor", None, None, ())
    assert table.source.sha256 == hashlib.sha256(table.path.read_bytes()).hexdigest()
    assert dict(table.columns)["thrust_n"] == ("thrust_n",)


def test_series_of_a_tachometer_stand_beside_each_other_as_displayed(tmp_path: Path) -> None:
    table = read(tmp_path, "cmd,rpm_1,rpm_2\n0,0,0\n2000,9000,8800\n")

    assert table.speeds == "series"
    assert np.asarray(table.speeds_rad_s) == pytest.approx(RPM * np.array([[0, 0], [9000, 8800]]))
    assert table.thrust_n is None
    assert table.columns["speeds_rad_s"] == ("rpm_1", "rpm_2")


def test_readings_of_scales_stay_grams(tmp_path: Path) -> None:
    assert np.asarray(read(tmp_path, "cmd,grams\n0,100\n4000,98.5\n").grams).tolist() == [100, 98.5]


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_heads_come_in_any_order_case_and_spacing(tmp_path: Path, separator: str) -> None:
    rows = [[" Vbat [V]", "PWM ", "rpm 1", "Weight[ g ]"], ["4.0", "20000", "9549.3", "8"]]
    table = read(tmp_path, "".join(separator.join(row) + "\n" for row in rows))

    assert np.asarray(table.vbat_v).tolist() == [4.0]
    assert np.asarray(table.thrust_n) == pytest.approx([8e-3 * 9.81])
    assert np.asarray(table.speeds_rad_s) == pytest.approx(np.array([[1000.0]]), rel=1e-5)


# Thrust stands


@pytest.mark.parametrize(
    ("head", "value", "newtons"),
    [
        ("weight[g]", 40, 0.04 * 9.81),
        ("Thrust (g)", 40, 0.04 * 9.81),
        ("thrust[N]", 0.4, 0.4),
        ("thrust_n", 0.4, 0.4),
        ("thrust_total_g", 40, 0.04 * 9.81 / 4),
    ],
)
@pytest.mark.parametrize("motors", [None, 1, 2])
def test_a_table_is_of_one_motor_of_four_where_it_states_a_total_or_of_the_number_that_is_given(
    tmp_path: Path, head: str, value: float, newtons: float, motors: int | None
) -> None:
    table = read(tmp_path, f"pwm,{head},torque_nm\n0,0,0\n40000,{value},0.06\n", motors=motors)
    usual = 4 if head == "thrust_total_g" else 1

    assert table.motors == (motors or (4 if usual == 4 else None))
    assert np.asarray(table.thrust_n) == pytest.approx([0, newtons * usual / (motors or usual)])
    assert np.asarray(table.torque_nm) == pytest.approx([0, 0.06 / (motors or usual)])


def test_grams_are_weighed_at_the_gravity_given(tmp_path: Path) -> None:
    table = read(tmp_path, "pwm,thrust[g]\n0,0\n40000,40\n", gravity_mps2=9.80665)

    assert np.asarray(table.thrust_n)[1] == pytest.approx(0.04 * 9.80665)


def test_percent_of_pwm_is_a_command_of_16_bits(tmp_path: Path) -> None:
    assert read(tmp_path, "pwm_percent,thrust[g]\n0,0\n50,20\n100,60\n").command == pytest.approx([0, 32767.5, 65535])


def test_four_rotors_have_a_square_mean_speed(tmp_path: Path) -> None:
    table = read(tmp_path, "pwm,rpm1,rpm2,rpm3,rpm4\n30000,8000,9000,10000,11000\n")

    assert table.speeds == "rotors"
    assert np.asarray(table.square_mean_speed_rad_s) == pytest.approx([math.sqrt(91.5e6) * RPM])


def test_a_pwm_held_for_long_is_a_record_over_time_at_an_assumed_rate(tmp_path: Path) -> None:
    table = read(tmp_path, held())

    assert np.asarray(table.time_s) == pytest.approx(np.arange(60) / 100)
    assert table.rate_hz == 100
    assert "stand.csv: a record over time without a time column: 100 Hz is assumed (`rate_hz`)." in notes_of(table)


def test_a_rate_that_is_given_makes_the_times_and_needs_no_word(tmp_path: Path) -> None:
    table = read(tmp_path, held(), rate_hz=50.0)

    assert np.asarray(table.time_s) == pytest.approx(np.arange(60) / 50)
    assert not any("assumed" in note for note in notes_of(table))
    assert "`rate_hz` 0: has to be above zero" in refusal(tmp_path, held(), ConfigError, rate_hz=0.0)


def test_a_time_column_is_taken_before_any_rate_is_assumed(tmp_path: Path) -> None:
    rows = [f"{i / 20:.3f},{i % 7},{10000 * (i // 20)}" for i in range(60)]
    table = read(tmp_path, "\n".join(["time[s],weight[g],pwm", *rows, ""]))

    assert np.asarray(table.time_s) == pytest.approx(np.arange(60) / 20)
    assert table.rate_hz is None


@pytest.mark.parametrize(
    ("head", "per_s"),
    [
        ("Zeit (s)", 1.0),
        ("seconds", 1.0),
        ("sec", 1.0),
        ("Time Stamp (s)", 1.0),
        ("Relative Time [ms]", 1e3),
        ("millis", 1e3),
        ("time_boot_ms", 1e3),
        ("TimeUS", 1e6),
        ("micros", 1e6),
    ],
)
def test_a_time_is_known_by_the_names_that_programs_and_boards_give_it(tmp_path: Path, head: str, per_s: float) -> None:
    rows = "".join(f"{i / 20 * per_s:.9g},{i % 7},{10000 * (i // 20)}\n" for i in range(60))
    table = read(tmp_path, f"{head},weight[g],pwm\n{rows}")
    assert np.asarray(table.time_s) == pytest.approx(np.arange(60) / 20)


@pytest.mark.parametrize("command", ["pwm", "cmd", "Throttle (%)", "command_fraction"])
@pytest.mark.parametrize("ramp", [False, True])
def test_a_column_that_may_be_the_time_is_asked_about_before_a_rate_is_assumed_or_rows_are_averaged(
    tmp_path: Path, command: str, ramp: bool
) -> None:
    jitter = np.random.default_rng(1).uniform(0, 0.005, 260)
    commands = np.arange(260) / 260 if ramp else np.arange(260) // 20 / 13
    commands *= 1 if command == "command_fraction" else 100 if "%" in command else 65535
    rows = "".join(
        f"{i / 50 + late:.4f},{1 + i % 3},{x:.4f}\n" for i, (late, x) in enumerate(zip(jitter, commands, strict=True))
    )
    text = f"loop,thrust_n,{command}\n{rows}"
    message = refusal(tmp_path, text)
    assert "column 'loop' grows from row to row as one does. Name it by `columns`, as in t=1" in message
    assert np.asarray(read(tmp_path, text, columns=("t=1",)).time_s) == pytest.approx(
        np.arange(260) / 50 + jitter - jitter[0], abs=1e-4
    )


@pytest.mark.parametrize(
    "values", [range(260), [1000 + i // 20 * 5 for i in range(260)], [12 - i // 20 / 9 for i in range(260)]]
)
def test_a_counter_and_what_goes_with_the_command_is_no_time(tmp_path: Path, values: Any) -> None:
    rows = "".join(f"{value},{i % 7},{5000 * (i // 20)}\n" for i, value in enumerate(values))
    assert "100 Hz is assumed" in " ".join(notes_of(read(tmp_path, f"extra,weight[g],pwm\n{rows}")))


def test_columns_that_are_not_understood_are_named_and_a_cut_line_is_left_out(tmp_path: Path) -> None:
    table = read(tmp_path, "amps,cmd,thrust_n,v[V]\n1,2000,0.1,3\n1,4000,0.2,3\n1,60")

    assert notes_of(table)[0] == "stand.csv: not used: amps, v[V]."
    assert "the last line was cut" in notes_of(table)[1]
    assert len(table.command) == 2


@pytest.mark.skipif(not OLD.exists(), reason="Bitcraze's table of 2015 is not here (CFID_DATA)")
def test_bitcrazes_table_of_2015_is_settled_points() -> None:
    table = read_stand_table(OLD)

    assert (len(table.command), table.time_s, table.motors, table.speeds) == (16, None, 4, "mean")
    assert table.command[-1] == pytest.approx(0.9375 * 65535)
    assert np.asarray(table.thrust_n)[-1] == pytest.approx(0.0579 * 9.81 / 4)
    assert np.asarray(table.square_mean_speed_rad_s)[-1] == pytest.approx(23882 * RPM)
    assert np.asarray(table.vbat_v)[-1] == 3.3


@pytest.mark.skipif(not RAMP.exists(), reason="Bitcraze's stand record of 2021 is not here (CFID_DATA)")
def test_bitcrazes_ramp_of_2021_is_a_record_over_time() -> None:
    table = read_stand_table(RAMP)

    assert len(table.command) == 2573
    assert np.asarray(table.time_s)[-1] == pytest.approx(25.72)
    assert "cf2.1-stock-prop.csv: not used: v[V], i[A], p[W]." in notes_of(table)


# Partly missing or wrong values


def test_a_field_that_is_no_number_is_missing_and_named(tmp_path: Path) -> None:
    table = read(tmp_path, "cmd,thrust_n,torque_nm\n0,0,0\n2000,nan,1\n4000,0.2,\n6000,lost,3\n")

    assert np.array_equal(np.asarray(table.thrust_n), [0, np.nan, 0.2, np.nan], equal_nan=True)
    assert np.array_equal(np.asarray(table.torque_nm), [0, 1, np.nan, 3], equal_nan=True)
    assert "stand.csv: 'thrust_n' is no number in 2 of 4 rows (first: line 3)." in notes_of(table)
    assert "stand.csv: 'torque_nm' is no number in 1 of 4 rows (first: line 4)." in notes_of(table)


def test_a_row_without_a_command_is_left_out_and_a_column_of_text_is_not_used(tmp_path: Path) -> None:
    table = read(tmp_path, "cmd,thrust_n,torque_nm\n0,0,off\n,0.1,off\n4000,0.2,on\n")

    assert table.command.tolist() == [0, 4000]
    assert np.asarray(table.thrust_n).tolist() == [0, 0.2]
    assert table.torque_nm is None
    assert "stand.csv: 'torque_nm' holds no number: it is not used. Line 2: '" in " ".join(notes_of(table))
    assert "stand.csv: 1 row without a time or command (first: line 3) is left out." in texts(table.findings, "warning")


@pytest.mark.parametrize("head", ["Throttle (%)", "pwm_percent", "command_fraction", "cmd"])
def test_signs_of_per_cent_in_cells_are_no_numbers_and_the_message_names_what_to_write(
    tmp_path: Path, head: str
) -> None:
    said = "Write per cent without the sign."
    table = read(tmp_path, f"{head},rpm,thrust_n\n40%,7000,1\n50%,7100,2\n")
    assert said in " ".join(notes_of(table))
    assert np.isnan(table.command).all()
    named = read(tmp_path, "Throttle,rpm,thrust_n\n40%,7000,1\n50%,7100,2\n", columns=("cmd=1",))
    assert said in " ".join(notes_of(named))
    assert read(tmp_path, "cmd,thrust_n,rpm\n30000,10%,9000\n40000,20%,9900\n").thrust_n is None


@pytest.mark.parametrize(
    ("commands", "example"),
    [
        ((0.5, 0.75, 1), "command_fraction"),
        ((50, 75, 100), "pwm_percent"),
        ((1000, 1500, 2000), '"ESC signal (us)"'),
        ((0, 30000, 60000), "cmd"),
    ],
)
def test_the_example_for_a_throttle_without_a_unit_reads_it(
    tmp_path: Path, commands: tuple[float, ...], example: str
) -> None:
    text = "Throttle,rpm,thrust_n\n" + "".join(f"{value},{7000 + at},1\n" for at, value in enumerate(commands))
    assert f"Name it by `columns`, as in {example}=1." in " ".join(notes_of(read(tmp_path, text)))
    command = read(tmp_path, text, columns=(f"{example}=1".replace('"', ""),)).command
    assert command[-1] == (60000 if example == "cmd" else 65535)


def test_a_column_of_an_unknown_unit_is_named_where_it_is_not_needed(tmp_path: Path) -> None:
    table = read(tmp_path, "cmd,thrust_n,vbat[kV]\n20000,4,4100\n")

    assert table.vbat_v is None
    assert any("column 'vbat[kV]' has no known unit: it is not used" in text for text in notes_of(table))


# Refusals


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("gas,thrust_n\n1,2\n", "no motor command among gas, thrust_n. Name columns by `columns`"),
        ("cmd,vbat_v\n1,4\n", "nothing measured among cmd, vbat_v. Name columns"),
        (
            "cmd,lift\n1,4\n",
            "nothing measured among cmd, lift. Name columns by `columns`, as in cmd=1",
        ),
        (
            "cmd,thrust\n1,4\n",
            "column 'thrust' has no known unit. Name it by `columns`, as in thrust_n=2 in newtons, or Thrust (gf)=2 in "
            "grams. Known names",
        ),
        ("cmd,thrust[lbs]\n1,4\n", "column 'thrust[lbs]' has no known unit"),
        ("pwm[ms],thrust_n\n1,4\n", "column 'pwm[ms]' has no known unit"),
        (
            "cmd,weight[g],thrust[N]\n1,4,2\n",
            "more than one column of thrust: weight[g], thrust[N]. Name one",
        ),
        ("cmd,pwm,thrust_n\n1,4,2\n", "more than one column of command: cmd, pwm"),
        ("pwm,rpm1,rpm_mean\n1,4,2\n", "more than one column of speeds: rpm1, rpm_mean"),
        ("1,4\n2,5\n", "no header for its 2 columns. Name them by `columns`, as in cmd=1,thrust_n=2. Known names"),
        ("cmd,thrust_n\n2000,bad\n4000,nan\n", "nothing measured among cmd, thrust_n. Name columns"),
        ("cmd,thrust_n\n2000,0.1\n4000\n", "stand.csv:3: 1 field where the file has 2 columns"),
        ("pwm,thrust_n\n2000,0.1\n-4000,0.1\n", "stand.csv:3: -4000 in column 'pwm': a command is zero or more"),
        ("cmd,thrust_n\n2000,0.1\n70000,0.1\n", "stand.csv:3: 70000 in column 'cmd': the largest is 65535"),
        (
            "pwm_percent,thrust_n\n20,0.1\n100.5,0.1\n",
            "stand.csv:3: 100.5 in column 'pwm_percent': the largest",
        ),
        (
            "pwm,thrust_n\n0,0\n100,0.1\n",
            "no command above 100 in 'pwm', of 65535: is it in per cent? Then name the column by `columns`, as in "
            "pwm_percent=1.",
        ),
        (
            "thrust_n,cmd\n0,0\n0.1,0.9\n",
            "no command above 0.9 in 'cmd', of 65535: is it a fraction of one? Then name the column by `columns`, "
            "as in command_fraction=2.",
        ),
        (
            "t,pwm,thrust_n\n0,0,0\n1,128,0.1\n2,255,0.1\n",
            "no command above 255 in 'pwm', of 65535: is it of 8 bits (0 to 255)? No option reads that: write it "
            "divided by 255 as a column command_fraction (0 to 1) in place of this one.",
        ),
        (
            "cmd,thrust_n\n0,0\n48,0\n1000,0.1\n2047,0.1\n",
            "no command above 2047 in 'cmd', of 65535: is it DShot (48 to 2047)? No option reads that: write "
            "(cmd - 48) / 1999, 0 at 0, as a column command_fraction (0 to 1) in place of this one.",
        ),
        (
            "cmd,thrust_n\n1000,0\n1500,0.1\n2000,0.1\n",
            "no cmd below 1000 or above 2000: are these pulse widths in us? Then name the column by `columns`, as in "
            '"ESC signal (us)=1".',
        ),
        (
            "timestamp,counter,esc_count,esc[0].esc_rpm\n0,0,4,14954\n",
            "no motor command among timestamp, counter, esc_count, esc[0].esc_rpm. Name columns",
        ),
        ("command_fraction,thrust_n\n0.5,0.1\n1.5,0.1\n", "1.5 in column 'command_fraction': the largest is 1, as a"),
        ("cmd,rpm_1,rpm_2\n0,0,0\n2000,9000,-1\n", "stand.csv:3: -1 in column 'rpm_2': a speed is zero or more"),
        (
            "cmd,thrust_n,vbat_v\n0,0,4.1\n0,0,3900\n",
            "stand.csv:3: 3900 in column 'vbat_v': no battery has that voltage. Is it in millivolts? Then its "
            "name has to be vbat_mv.",
        ),
        ("cmd,thrust_n,vbat_v\n0,0,0\n", "stand.csv:2: 0 in column 'vbat_v': no battery"),
    ],
)
def test_what_a_table_cannot_mean_is_refused_with_the_place_and_what_would_do(
    tmp_path: Path, text: str, said: str
) -> None:
    assert said in refusal(tmp_path, text)


def test_the_heads_that_are_known_are_all_in_the_sentence(tmp_path: Path) -> None:
    said = refusal(tmp_path, "a,b\n1,2\n")
    for head in (
        "cmd",
        "pwm_percent",
        "thrust_n",
        "weight[g]",
        "thrust_total_g",
        "torque_nm",
    ):
        assert head in said
    for head in ("speed_rad_s", "rpm_1", "rpm1", "rpm_mean", "vbat_v", "vbat[V]", "voltage_V"):
        assert head in said


def test_a_few_impossible_values_are_left_out_and_named(tmp_path: Path) -> None:
    rows = [f"{2000 * at},{0.01 * at},{-7 if at == 3 else 3000 + 500 * at}" for at in range(1, 21)]
    path = tmp_path / "stand.csv"
    path.write_text("\n".join(["cmd,thrust_n,rpm", *rows, ""]))
    table = read_stand_table(path)
    assert table.speeds_rad_s is not None
    assert np.flatnonzero(np.isnan(table.speeds_rad_s[:, 0])).tolist() == [2]
    assert "1 impossible value, the first -7 in column 'rpm' (line 4)" in " ".join(one.text for one in table.findings)


def test_greek_speeds_are_known(tmp_path: Path) -> None:
    path = tmp_path / "stand.csv"
    path.write_text("cmd,Ω [rad/s]\n0,0\n20000,900\n40000,1500\n")
    found = read_stand_table(path).speeds_rad_s
    assert found is not None
    assert found[:, 0].tolist() == [0, 900, 1500]


@pytest.mark.parametrize("thrust", ["Schub [N]", "Schubkraft (kgf)", "Kraft [N]"])
def test_german_heads_of_a_stand_are_known(tmp_path: Path, thrust: str) -> None:
    text = (
        f"Zeit [ms];PWM [us];{thrust};Drehmoment [Nmm];Drehzahl [1/min];Spannung [V];Strom [A]\n"
        "0;1000;0,0;0,0;0,0;11,10;0,1\n2000;2000;0,5;20,5;6000;10,9;9,5\n"
    )
    table = read(tmp_path, text)
    assert table.motors is None
    assert np.asarray(table.thrust_n)[-1] == pytest.approx(0.5 * (9.80665 if "kgf" in thrust else 1))
    assert np.asarray(table.torque_nm)[-1] == pytest.approx(0.0205)
    assert np.asarray(table.square_mean_speed_rad_s)[-1] == pytest.approx(200 * math.pi)
    assert np.asarray(table.vbat_v).tolist() == [11.1, 10.9]
    assert "not used: Strom [A]." in " ".join(notes_of(table))


def test_speeds_per_second_are_turns_and_that_is_stated(tmp_path: Path) -> None:
    notes = notes_of(read(tmp_path, "cmd,Speed [1/s],thrust_n\n0,0,0\n20000,100,1\n"))
    assert any("'Speed [1/s]' is read in turns per second" in note for note in notes)


def test_columns_of_one_name_are_left_out_where_others_can_be_fitted(tmp_path: Path) -> None:
    path = tmp_path / "stand.csv"
    path.write_text("cmd,thrust_n,torque_nm,torque_nm\n0,0,0,7\n20000,0.1,0.001,7\n")
    table = read_stand_table(path)
    assert table.torque_nm is None
    assert table.thrust_n is not None
    said = " ".join(one.text for one in table.findings)
    assert "the columns 3, 4 are all named 'torque_nm': none is used. Name one by `columns`, as in torque_nm=3." in said
    assert "no known unit" not in said


def test_a_table_whose_only_measurement_is_there_twice_is_refused_with_what_would_do(tmp_path: Path) -> None:
    said = refusal(tmp_path, "cmd,thrust_n,thrust_n\n0,0,7\n20000,0.1,7\n")
    assert "the columns 2, 3 are all named 'thrust_n': none is used. Name one by `columns`, as in thrust_n=2." in said


@pytest.mark.parametrize(
    ("text", "columns", "thrust_n"),
    [
        ("cmd,thrust_n,thrust_n\n0,0,7\n20000,0.1,8\n", ("thrust_n=3",), [7, 8]),
        ("cmd,weight[g],thrust[N]\n0,4,2\n20000,5,4\n", ("thrust[N]=thrust[N]",), [2.0, 4.0]),
        ("throttle,lift\n0,0\n20000,100\n", ("cmd=throttle", "Thrust (gf)=lift"), [0, 0.980665]),
        ("0,0.5\n20000,0.75\n", ("cmd=1", "thrust_n=2"), [0.5, 0.75]),
        ("cmd,lift,thrust_n\n0,1,7\n20000,2,8\n", ("thrust_n=lift",), [1, 2]),
    ],
)
def test_columns_are_what_the_operator_names_them(
    tmp_path: Path, text: str, columns: tuple[str, ...], thrust_n: list[float]
) -> None:
    path = tmp_path / "stand.csv"
    path.write_text(text)
    table = read_stand_table(path, columns=columns)
    assert table.command.tolist() == [0, 20000]
    assert table.thrust_n is not None
    assert table.thrust_n == pytest.approx(thrust_n)
    assert "(`columns`)" in " ".join(one.text for one in table.findings)


@pytest.mark.parametrize(
    ("column", "named", "expected"),
    [
        ("Thrust (kgf)", "thrust_n", [0, 9.80665]),
        ("Thrust (kgf)", "thrust_n=2", [0, 9.80665]),
        ("Thrust (N)", "thrust_n", [0, 1]),
        ("Lift (lbf)", "thrust_n", [0, 4.4482216]),
        ("weight[g]", "thrust_n", [0, 9.81e-3]),
        ("Moment (ozf·in)", "torque_nm", [0, 7.0615518e-3]),
        ("Drehzahl (Hz)", "rpm", [0, 2 * math.pi]),
        ("Drehzahl [1/min]", "speed_rad_s", [0, RPM]),
        ("n [min^-1]", "speed_rad_s", [0, RPM]),
        ("n [min⁻¹]", "speed_rad_s", [0, RPM]),
        ("n (U/min)", "speed_rad_s", [0, RPM]),
        ("n [r/min]", "speed_rad_s", [0, RPM]),
        ("n rev/min", "speed_rad_s", [0, RPM]),
        ("n_upm", "speed_rad_s", [0, RPM]),
        ("n [1/min] (filtered)", "speed_rad_s", [0, RPM]),
        ("n__1_min_", "speed_rad_s", [0, RPM]),
        ("n_min__1_", "speed_rad_s", [0, RPM]),
        ("n [1/s]", "rpm", [0, 2 * math.pi]),
        ("n [turns/s]", "rpm", [0, 2 * math.pi]),
        ("omega [1/s]", "speed_rad_s", [0, 1]),
        ("omega [1/s]", "rpm", [0, 1]),
        ("Motor Optical Speed (RPM)", "speed_rad_s", [0, RPM]),
    ],
)
def test_the_unit_in_the_header_of_a_column_that_is_named_counts(
    tmp_path: Path, column: str, named: str, expected: list[float]
) -> None:
    text = f"cmd,{column},grams\n0,0,0\n20000,1,1\n"
    table = read(tmp_path, text, columns=(named if "=" in named else f"{named}={column}",))
    measured = {"thrust_n": table.thrust_n, "torque_nm": table.torque_nm}.get(
        named.partition("=")[0], table.square_mean_speed_rad_s
    )
    assert np.asarray(measured) == pytest.approx(expected)


@pytest.mark.parametrize(
    "speed",
    [
        "n [min-1]",
        "n [1/min]",
        "Drehzahl 1/min",
        "Drehzahl in U/min",
        "Drehzahl min⁻¹",
        "Speed [/min]",
        "Speed [min-1]",
    ],
)
@pytest.mark.parametrize("command", ["Stellgröße [%]", "Stellgroesse (%)", "Tastverhältnis [%]"])
def test_heads_as_german_laboratories_write_them_are_known(tmp_path: Path, command: str, speed: str) -> None:
    table = read(tmp_path, f"{command};Schub [N];{speed}\n0;0;0\n50;1;6000\n")
    assert table.command == pytest.approx([0, 0.5 * 65535])
    assert table.square_mean_speed_rad_s == pytest.approx([0, 200 * math.pi])


@pytest.mark.parametrize(
    ("head", "quantity", "value", "expected"),
    [
        ("Thrust__kgf_", "thrust_n", 1, 9.80665),
        ("Thrust_gf_", "thrust_n", 100, 0.980665),
        ("weight_g_", "thrust_n", 4, 4 * 9.81e-3),
        ("Torque__lbf_in_", "torque_nm", 1, 0.1129848),
        ("Torque__N_m_", "torque_nm", 0.5, 0.5),
        ("Rotation_speed__rpm_", "square_mean_speed_rad_s", 600, 20 * math.pi),
        ("MotorOpticalSpeed_rad_s_", "square_mean_speed_rad_s", 9, 9),
        ("Voltage__V_", "vbat_v", 12, 12),
    ],
)
def test_a_unit_in_brackets_that_matlab_made_underscores_of_is_read(
    tmp_path: Path, head: str, quantity: str, value: float, expected: float
) -> None:
    table = read(tmp_path, f"cmd,{head},grams\n0,{value},0\n20000,{value},1\n")
    assert np.asarray(getattr(table, quantity))[-1] == pytest.approx(expected)


@pytest.mark.parametrize("head", ["ESC_signal___s_", "ESCSignal__s_", "ESCSignal_us_"])
def test_pulse_widths_whose_micro_sign_matlab_replaced_are_pulse_widths(tmp_path: Path, head: str) -> None:
    assert read(tmp_path, f"{head},thrust_n\n1000,0\n1500,1\n").command.tolist() == [0, 32768]
    named = read(tmp_path, f"{head},thrust_n\n1000,0\n1500,1\n", columns=(f"cmd={head}",))
    assert named.command.tolist() == [0, 32768]


@pytest.mark.parametrize(
    ("head", "named", "expected"),
    [
        ("Thrust__kgf_", "thrust_n", 9.80665),
        ("Lift__lbf_", "thrust_n", 4.4482216),
        ("thrust_g_", "thrust_n", 9.81e-3),
        ("thrust_g_", "thrust_total_g", 9.81e-3 / 4),
        ("thrust_N_", "thrust_n", 1),
    ],
)
def test_the_unit_in_a_name_of_matlab_counts_before_that_of_the_option(
    tmp_path: Path, head: str, named: str, expected: float
) -> None:
    table = read(tmp_path, f"cmd,{head}\n0,0\n20000,1\n", columns=(f"{named}=2",))
    assert np.asarray(table.thrust_n)[-1] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("head", "named"),
    [
        ("F (uN)", "thrust_n"),
        ("F__uN_", "thrust_n"),
        ("Moment [uN·m]", "torque_nm"),
        ("battery (kV)", "vbat_v"),
        ("n (eRPM)", "rpm"),
        ("n [rad/min]", "speed_rad_s"),
        ("n [1/h]", "rpm"),
        ("tip (m/s)", "speed_rad_s"),
    ],
)
def test_an_option_does_not_override_a_unit_that_is_not_read(tmp_path: Path, head: str, named: str) -> None:
    text = f"cmd,{head},grams\n0,0,0\n20000,100,1\n"
    question = refusal(tmp_path, text, ConfigError, columns=(f"{named}=2",))
    assert f"column '{head}' states a unit that is not read. Convert it" in question


def test_pulse_widths_under_pwm_are_asked_about_and_read_where_they_are_named_so(tmp_path: Path) -> None:
    text = "pwm,thrust_n\n1000,0\n1500,1\n2000,4\n"
    question = 'are these pulse widths in us? Then name the column by `columns`, as in "ESC signal (us)=1".'
    assert question in refusal(tmp_path, text)
    assert read(tmp_path, text, columns=("ESC signal (us)=1",)).command.tolist() == [0, 32768, 65535]


def test_speeds_of_a_rotor_that_turns_the_other_way_are_positive(tmp_path: Path) -> None:
    table = read(tmp_path, "cmd,thrust_n,Motor Optical Speed (RPM)\n0,0,1\n20000,1,-600\n40000,4,-1200\n")
    assert np.asarray(table.square_mean_speed_rad_s)[1:].tolist() == pytest.approx([20 * math.pi, 40 * math.pi])
    said = (
        "'Motor Optical Speed (RPM)' is negative throughout, of a rotor that turns the other way: its sign is turned."
    )
    assert any(said in note for note in notes_of(table))


@pytest.mark.parametrize(
    ("head", "named", "quantity", "expected"),
    [
        ("Thrust (grams)", "thrust_n", "thrust_n", 9.80665e-3),
        ("thrust_g", "thrust_n", "thrust_n", 9.81e-3),
        ("thrust_g", "thrust_total_g", "thrust_n", 9.81e-3 / 4),
        ("Thrust gf", "thrust_n", "thrust_n", 9.80665e-3),
        ("lift_kgf", "thrust_n", "thrust_n", 9.80665),
        ("moment lbf·in", "torque_nm", "torque_nm", 0.1129848),
        ("omega [rad/sec]", "rpm", "square_mean_speed_rad_s", 1),
        ("rotor_rpm", "speed_rad_s", "square_mean_speed_rad_s", math.pi / 30),
        ("rotor_n", "rpm", "square_mean_speed_rad_s", math.pi / 30),
        ("lift_mN", "thrust_n", "thrust_n", 1e-3),
        ("F [cN]", "thrust_n", "thrust_n", 1e-2),
        ("moment (N·cm)", "torque_nm", "torque_nm", 1e-2),
        ("n krpm", "rpm", "square_mean_speed_rad_s", 100 * math.pi / 3),
        ("rig_s", "thrust_n", "thrust_n", 1),
        ("Total Thrust [g]", "thrust_total_g", "thrust_n", 9.81e-3 / 4),
        ("Total Thrust [g]", "weight[g]", "thrust_n", 9.81e-3),
        ("Gesamtschub (kgf)", "thrust_total_g", "thrust_n", 9.80665 / 4),
        ("Weight [kg]", "weight[g]", "thrust_n", 9.80665),
        ("Total (lbf)", "thrust_total(N)", "thrust_n", 4.4482216 / 4),
        ("Total (N)", "thrust_n", "thrust_n", 1),
    ],
)
def test_a_unit_that_a_header_states_without_brackets_counts_before_that_of_the_option(
    tmp_path: Path, head: str, named: str, quantity: str, expected: float
) -> None:
    table = read(tmp_path, f"cmd,{head},grams\n0,1,0\n20000,1,1\n", columns=(f"{named}=2",))
    assert np.asarray(getattr(table, quantity))[-1] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    ("head", "named"), [("lift_uN", "thrust_n"), ("esc ms", "cmd"), ("n erpm", "rpm"), ("eRPM", "rpm")]
)
def test_an_option_does_not_override_a_unit_without_brackets_that_is_not_read(
    tmp_path: Path, head: str, named: str
) -> None:
    text = f"command,{head},grams\n0,0,0\n20000,100,1\n"
    question = refusal(tmp_path, text, ConfigError, columns=(f"{named}=2",))
    assert f"column '{head}' states a unit that is not read. Convert it" in question


def test_a_thrust_in_grams_spelt_out_in_round_brackets_is_that_of_what_ran(tmp_path: Path) -> None:
    table = read(tmp_path, "cmd,Thrust (grams)\n0,0\n20000,100\n")
    assert np.asarray(table.thrust_n)[-1] == pytest.approx(0.980665)


@pytest.mark.parametrize(
    ("head", "remedy"),
    [
        ("Torque (uN·m)", "Convert it to a unit that is read, and state that in its header, as in torque_nm."),
        ("vbat[kV]", "Convert it to a unit that is read, and state that in its header, as in vbat_v."),
        ("Speed (eRPM)", "Convert it to a unit that is read, and state that in its header, as in rpm."),
        ("torque", "Name it by `columns`, as in torque_nm=3."),
        ("omega", "Name it by `columns`, as in rpm=3."),
    ],
)
def test_a_column_that_is_not_used_is_named_with_what_would_serve(tmp_path: Path, head: str, remedy: str) -> None:
    notes = notes_of(read(tmp_path, f"cmd,thrust_n,{head}\n0,0,0\n20000,1,100\n"))
    assert any(f"column '{head}' has no known unit: it is not used. {remedy}" in note for note in notes)


@pytest.mark.parametrize("head", ["F (left)", "lift[1]", "thrust (mean)", "F_left_"])
def test_words_in_brackets_that_are_no_unit_leave_the_unit_to_the_option(tmp_path: Path, head: str) -> None:
    assert np.asarray(read(tmp_path, f"cmd,{head}\n0,0\n20000,1\n", columns=("thrust_n=2",)).thrust_n)[-1] == 1


def test_a_column_of_a_known_unit_and_an_unknown_name_is_named_so(tmp_path: Path) -> None:
    notes = notes_of(read(tmp_path, "cmd,thrust_n,torque_x[Nm]\n0,0,0\n20000,1,0.1\n"))
    assert any("column 'torque_x[Nm]' has a known unit, but no known name: it is not used" in one for one in notes)


@pytest.mark.parametrize(("head", "example"), [("torque", "torque_nm=2"), ("rpm.m1", "rpm=2"), ("voltage", "vbat_v=2")])
def test_the_example_for_a_column_of_unknown_unit_is_of_its_quantity(tmp_path: Path, head: str, example: str) -> None:
    question = (
        f"column '{head}' has no known unit. Name it by `columns`, as in {example}. Known names, which state the unit"
    )
    assert question in refusal(tmp_path, f"cmd,{head}\n0,0\n20000,1\n")


@pytest.mark.parametrize("column", ["ESC signal (µs)", "Puls [us]"])
def test_a_command_whose_header_states_microseconds_is_a_pulse_width_also_where_it_is_named(
    tmp_path: Path, column: str
) -> None:
    table = read(tmp_path, f"{column},thrust_n\n1000,0\n1500,1\n", columns=(f"cmd={column}",))
    assert table.command.tolist() == [0, 32768]


def test_a_time_that_is_named_keeps_the_unit_of_its_header(tmp_path: Path) -> None:
    rows = "".join(f"{at / 5},{20000 * (at // 20)},{at // 20}\n" for at in range(80))  # a step plausible in s and in ms
    table = read(tmp_path, "Time (ms),cmd,thrust_n\n" + rows, columns=("t=Time (ms)",))
    assert np.asarray(table.time_s)[-1] == pytest.approx(0.0158)


@pytest.mark.parametrize(("head", "per_s"), [("Laufzeit [ms]", 1e3), ("czas (s)", 1.0), ("Uhr_ms", 1e3)])
def test_a_time_of_another_name_keeps_the_unit_of_its_header(tmp_path: Path, head: str, per_s: float) -> None:
    rows = "".join(f"{at / 5},{20000 * (at // 20)},{at // 20}\n" for at in range(80))
    table = read(tmp_path, f"{head},cmd,thrust_n\n{rows}", columns=("t=1",), time_unit=None)
    assert np.asarray(table.time_s)[-1] == pytest.approx(15.8 / per_s)


@pytest.mark.parametrize("head", ["t [min]", "Time (min)", "Dauer_h"])
def test_minutes_and_hours_are_no_seconds_whatever_the_column_is_called(tmp_path: Path, head: str) -> None:
    rows = "".join(f"{at / 500},{20000 * (at // 20)},{at // 20}\n" for at in range(80))
    asked = refusal(tmp_path, f"{head},cmd,thrust_n\n{rows}")
    assert "times are read in s, ms or us. Convert them" in asked
    named = refusal(tmp_path, f"{head},cmd,thrust_n\n{rows}", ConfigError, columns=("t=1",))
    assert "states a unit that is not read. Convert it" in named


@pytest.mark.parametrize("second", ["Thrust (kgf)", "Thrust (gf)"])
def test_the_option_that_a_question_about_two_columns_names_gives_the_right_numbers(
    tmp_path: Path, second: str
) -> None:
    text = f"ESC signal (us),Thrust (kgf),{second}\n1000,0,0\n1500,0.5,400\n2000,2,1900\n"
    question = refusal(tmp_path, text)
    option = question.partition("as in ")[2].partition(". ")[0].rstrip(".")
    assert option == "Thrust (kgf)=2"
    assert np.asarray(read(tmp_path, text, columns=(option,)).thrust_n)[-1] == pytest.approx(2 * 9.80665)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (("3",), "takes NAME=COLUMN, as in thrust_n=3"),
        (("lift=3",), "`columns` lift=3: a table of motors takes NAME=COLUMN"),
        (("thrust_n=2", "torque_nm=2"), "names a column, or a quantity, twice"),
        (("thrust_n=2", "thrust_n=3"), "names a column, or a quantity, twice"),
    ],
)
def test_columns_that_name_nothing_are_refused(tmp_path: Path, columns: tuple[str, ...], said: str) -> None:
    text = "cmd,thrust_n,torque_nm\n0,0,7\n20000,0.1,8\n"
    assert said in refusal(tmp_path, text, ConfigError, columns=columns)


def test_a_table_of_six_named_columns_is_no_load_cell_s(tmp_path: Path) -> None:
    path = tmp_path / "stand.csv"
    path.write_text("".join(f"{at / 10},{at // 20},1,2,3,4\n" for at in range(60)))
    named = ("t=1", "cmd=2", "thrust_n=3", "torque_nm=4", "vbat_v=5", "rpm=6")
    assert kind_at(path, Foreign(columns=named)) == "stand"


def test_a_named_column_that_is_not_there_is_refused(tmp_path: Path) -> None:
    assert "no column '9'" in refusal(tmp_path, "cmd,thrust_n\n0,0\n2000,1\n", columns=("thrust_n=9",))


def test_noise_below_zero_of_rotors_that_stand_does_not_condemn_a_table(tmp_path: Path) -> None:
    path = tmp_path / "stand.csv"
    path.write_text("cmd,thrust_n,rpm\n0,0,-9\n0,0,4\n0,0,-2\n20000,0.1,9000\n40000,0.2,14000\n")
    table = read_stand_table(path)
    assert table.speeds_rad_s is not None
    assert table.speeds_rad_s[[0, 2], 0].tolist() == [0, 0]
    assert "2 speeds just below zero" in " ".join(one.text for one in table.findings)


def test_a_load_cell_that_is_not_tared_does_not_make_a_standing_rotor_a_dead_sensor(tmp_path: Path) -> None:
    path = tmp_path / "stand.csv"
    rows = "".join(
        f"{at / 10},{at // 50 * 10000 % 30000},{0.02 + at // 50 % 3 * 0.05},{at // 50 % 3 * 4000}\n"
        for at in range(200)
    )
    path.write_text("t_s,pwm,thrust_n,rpm\n" + rows)
    table = read_stand_table(path)
    assert table.speeds_rad_s is not None
    assert np.isfinite(table.speeds_rad_s).all()


def stand_columns() -> dict[str, npt.NDArray[np.float64]]:
    """Return columns (600,) of a stand's recording at 50 Hz with steps of the throttle."""
    step = np.repeat([1000.0, 1300, 1600, 1900, 1500, 1200], 100)
    seconds = np.arange(len(step)) / 50
    force = np.convolve(np.append(np.zeros(20), (step - 1000) ** 2 / 1e5), np.exp(-np.arange(40) / 5) / 5.5)[20:620]
    return {"Time (s)": seconds, "ESC signal (µs)": step, "Thrust (N)": force, "Motor Optical Speed (RPM)": 9 * step}


def stepped_stand(change: dict[str, dict[int, float]]) -> str:
    """Return the text of a stand's recording at 50 Hz with steps of the throttle and some values changed."""
    columns = stand_columns()
    for name, values in change.items():
        columns[name] = columns[name].copy() if name in columns else np.zeros(600)
        columns[name][list(values)] = list(values.values())
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return "\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows), ""])


def test_single_wrong_values_of_a_stands_recording_are_left_out_and_named(tmp_path: Path) -> None:
    path = tmp_path / "stand.csv"
    path.write_text(
        stepped_stand(
            {
                "Thrust (N)": {50: 90.0, 250: 0.0, 251: 0.0},
                "Motor Optical Speed (RPM)": {333: 60000.0, 460: 1.0},
                "ESC signal (µs)": {520: 65535.0},
                "Time (s)": {420: 0.0},
            }
        )
    )
    table = read_stand_table(path)
    said = " ".join(one.text for one in table.findings)

    assert table.thrust_n is not None
    assert table.speeds_rad_s is not None
    assert len(table.command) == 598
    assert np.flatnonzero(np.isnan(table.thrust_n)).tolist() == [50, 250, 251]
    assert np.flatnonzero(np.isnan(table.speeds_rad_s[:, 0])).tolist() == [333, 459]
    assert "3 values of 'Thrust (N)' off alone left out (first: 90 in line 52)." in said
    assert "2 values of 'Motor Optical Speed (RPM)' off alone left out (first: 60000 in line 335)." in said
    assert "1 impossible value, the first 65535 in column 'ESC signal (µs)' (line 522)" in said
    assert "1 row whose time is off that of the rows around (first: 0 in line 422) is left out." in said


@pytest.mark.parametrize(
    ("name", "value", "quantity"),
    [
        ("Motor Optical Speed (RPM)", 1e6, "speeds_rad_s"),
        ("Motor Optical Speed (RPM)", 60000.0, "speeds_rad_s"),
        ("Thrust (N)", -60.0, "thrust_n"),
        ("Torque (N·m)", 5.0, "torque_nm"),
        ("Voltage (V)", 59.0, "vbat_v"),
    ],
)
def test_several_values_in_a_row_that_no_rotor_shows_are_left_out_and_named(
    tmp_path: Path, name: str, value: float, quantity: str
) -> None:
    path, noise = tmp_path / "stand.csv", np.random.default_rng(3).normal(0, 1.0, 600)
    torque = {at: 0.01 * (1 + at // 100) + 2e-4 * noise[at] for at in range(600)}
    volts = {at: 12 - 0.3 * (at // 100) + 0.01 * noise[at] for at in range(600)}
    more = {"Torque (N·m)": torque, "Voltage (V)": volts}
    whole = {name: dict(zip(range(600), values, strict=True)) for name, values in stand_columns().items()} | more
    whole[name] = whole[name] | dict.fromkeys(range(420, 425), value)
    path.write_text(stepped_stand(whole))
    table = read_stand_table(path)

    found = np.asarray(getattr(table, quantity)).reshape(600, -1)[:, 0]
    assert np.flatnonzero(np.isnan(found)).tolist() == list(range(420, 425))
    said = f"5 values of '{name}' far beyond the others left out (first: {value:g} in line 422)."
    assert any(said in one.text for one in table.findings)


def test_a_motor_that_idles_but_for_a_moment_keeps_what_it_shows_then(tmp_path: Path) -> None:
    path, rng = tmp_path / "stand.csv", np.random.default_rng(3)
    throttle = np.full(6000, 1000.0)
    throttle[3000:3040] = 1900.0
    thrust = np.convolve(throttle - 1000, np.exp(-np.arange(30) / 5) / 5.5)[:6000] / 100
    torque = 0.01 * thrust + 0.05 * np.append(0, np.diff(thrust)) + rng.normal(0, 1e-5, 6000)
    volts = 12 - 0.3 * thrust + rng.normal(0, 0.01, 6000)
    rows = zip(np.arange(6000) / 50, throttle, thrust + rng.normal(0, 1e-3, 6000), torque, volts, strict=True)
    head = "Time (s),ESC signal (µs),Thrust (N),Torque (N·m),Voltage (V)"
    path.write_text("\n".join([head, *(",".join(map(str, row)) for row in rows), ""]))
    assert "left out" not in " ".join(one.text for one in read_stand_table(path).findings)


def test_a_throttle_that_jumps_for_one_row_makes_no_wrong_value_of_what_follows_it(tmp_path: Path) -> None:
    path = tmp_path / "stand.csv"
    change = {"ESC signal (µs)": {250: 1000.0}, "Motor Optical Speed (RPM)": {250: 0.0}, "Thrust (N)": {251: 0.0}}
    path.write_text(stepped_stand(change))
    assert "off alone" not in " ".join(one.text for one in read_stand_table(path).findings)


def test_a_smooth_or_noisy_recording_of_a_stand_keeps_every_value(tmp_path: Path) -> None:
    path, rng = tmp_path / "stand.csv", np.random.default_rng(5)
    noisy = {at: 5 + rng.normal(0, 2.0) for at in range(600)}
    for change in ({}, {"Thrust (N)": noisy}, {"Thrust (N)": {at: 0.1 * round(at / 60) for at in range(600)}}):
        path.write_text(stepped_stand(change))
        assert "off alone" not in " ".join(one.text for one in read_stand_table(path).findings)


def test_a_sensor_that_repeats_one_value_while_the_command_changes_is_left_out_there_and_named(tmp_path: Path) -> None:
    path = tmp_path / "stand.csv"
    noise = np.random.default_rng(3).normal(0, 1.0, 600)
    speed = {at: 9 * (1000 + at // 100) + noise[min(at, 250) if at < 420 else at] for at in range(100, 600)}
    speed |= dict.fromkeys(range(250, 420), speed[250])
    path.write_text(stepped_stand({"Motor Optical Speed (RPM)": speed}))
    table = read_stand_table(path)
    said = " ".join(one.text for one in table.findings)

    assert table.speeds_rad_s is not None
    assert np.flatnonzero(np.isnan(table.speeds_rad_s[:, 0])).tolist() == list(range(251, 420))
    assert "169 values of 'Motor Optical Speed (RPM)' that repeat the one before while the command changes" in said


def test_a_tachometer_that_is_slower_than_its_rows_does_not_hang(tmp_path: Path) -> None:
    path = tmp_path / "stand.csv"
    noise = np.random.default_rng(3).normal(0, 1.0, 600)
    path.write_text(stepped_stand({"Motor Optical Speed (RPM)": {at: 9000 + noise[at // 20] for at in range(600)}}))
    assert "repeat the one before while" not in " ".join(one.text for one in read_stand_table(path).findings)


@pytest.mark.parametrize(
    ("head", "quantity", "value", "expected"),
    [
        ("Thrust (mN)", "thrust_n", 250, 0.25),
        ("Thrust (cN)", "thrust_n", 25, 0.25),
        ("Torque (mN·m)", "torque_nm", 250, 0.25),
        ("Torque (N·cm)", "torque_nm", 25, 0.25),
        ("Torque (gf·cm)", "torque_nm", 100, 9.80665e-3),
        ("Torque (kgf·m)", "torque_nm", 0.1, 0.980665),
        ("Motor Speed (krpm)", "square_mean_speed_rad_s", 6, 200 * math.pi),
        ("Motor Speed (rev/s)", "square_mean_speed_rad_s", 100, 200 * math.pi),
        ("Motor Speed (deg/s)", "square_mean_speed_rad_s", 36000, 200 * math.pi),
        ("Speed [1/min]", "square_mean_speed_rad_s", 6000, 200 * math.pi),
        ("Drehzahl [1/min]", "square_mean_speed_rad_s", 6000, 200 * math.pi),
        ("Speed (1/s)", "square_mean_speed_rad_s", 100, 200 * math.pi),
        ("Speed [turns/s]", "square_mean_speed_rad_s", 100, 200 * math.pi),
        ("omega [1/s]", "square_mean_speed_rad_s", 100, 100),
        ("Voltage (mV)", "vbat_v", 3700, 3.7),
        ("vbat_mV", "vbat_v", 3700, 3.7),
        ("command_fraction", "command", 0.5, 32767.5),
    ],
)
def test_units_with_prefixes_and_fractions_of_the_command_are_read(
    tmp_path: Path, head: str, quantity: str, value: float, expected: float
) -> None:
    drive = "" if quantity == "command" else "20000,"
    names = f"cmd,{head}" if drive else head
    table = read(tmp_path, f"{names},grams\n{drive}{value},0\n{drive}{value},1\n")
    assert np.asarray(getattr(table, quantity))[-1] == pytest.approx(expected)


FLIGHT_STAND = (
    "Time (s),Powertrain 1 - ESC throttle (μs),Powertrain 1 - force Fx (N),Powertrain 1 - force Fz (thrust) (kgf),"
    "Powertrain 1 - torque MX (N⋅m),Powertrain 1 - torque MZ (torque) (N⋅m),Powertrain 1 - voltage (V),"
    "Powertrain 1 - rotation speed (rpm),Powertrain 1 - vibration (g)\n"
    "0,1000,9,0,9,0,12,0,0\n2,1500,9,1,9,0.1,12,600,0\n4,2000,9,2,9,0.2,12,1200,0\n"
)


@pytest.mark.parametrize("name", ["Powertrain 1", "left - front"])
def test_a_table_of_tytos_flight_stand_is_read_whatever_its_powertrain_is_called(tmp_path: Path, name: str) -> None:
    table = read(tmp_path, FLIGHT_STAND.replace("Powertrain 1", name))
    assert table.command.tolist() == [0, 32768, 65535]
    assert np.asarray(table.thrust_n) == pytest.approx([0, 9.80665, 19.6133])
    assert np.asarray(table.torque_nm).tolist() == [0, 0.1, 0.2]
    assert np.asarray(table.vbat_v).tolist() == [12, 12, 12]
    assert np.asarray(table.square_mean_speed_rad_s) == pytest.approx([0, 20 * math.pi, 40 * math.pi])


BOTH_SIDES = "Time (s),ESC A (µs),ESC B (µs),Thrust A (N),Thrust B (N),Voltage A (V),Voltage B (V)\n"


def test_of_a_double_stand_the_side_that_is_driven_is_taken(tmp_path: Path) -> None:
    table = read(tmp_path, BOTH_SIDES + "0,1000,1000,0,0,0,12\n2,1000,1500,0,1,0,12\n4,1000,2000,0,4,0,12\n")
    assert table.command.tolist() == [0, 32768, 65535]
    assert np.asarray(table.thrust_n).tolist() == [0, 1, 4]
    assert np.asarray(table.vbat_v).tolist() == [12, 12, 12]
    said = "'ESC B (µs)' alone changes: the columns of the other side are not used."
    assert any(said in one for one in notes_of(table))


def test_a_double_stand_both_of_whose_sides_are_driven_is_a_question_with_an_answer_for_all_columns(
    tmp_path: Path,
) -> None:
    text = BOTH_SIDES + "0,1000,1000,0,0,11,12\n2,1500,1200,2,1,11,12\n4,2000,1400,8,4,11,12\n"
    question = refusal(tmp_path, text)
    answer = '"ESC A (µs)=2","Thrust A (N)=4","Voltage A (V)=6"'
    assert f"Name the columns of one by `columns`, as in {answer}." in question
    table = read(tmp_path, text, columns=tuple(answer.replace('"', "").split(",")))
    assert np.asarray(table.thrust_n).tolist() == [0, 2, 8]
    assert np.asarray(table.vbat_v).tolist() == [11, 11, 11]


@pytest.mark.parametrize(
    ("time", "said"),
    [
        ("2026-03-29T00:59:50.{:03d}", "stand.csv:2: '2026-03-29T00:59:50.000' in column 't' is not a number. Dates"),
        ("00:59:50.{:03d}", "stand.csv:2: '00:59:50.000' in column 't' is not a number. Dates and times of day"),
    ],
)
@pytest.mark.parametrize("command", ["ESC signal (us)", "pwm_percent"])
def test_a_recording_whose_times_are_dates_is_refused_as_that_and_no_rate_is_assumed(
    tmp_path: Path, time: str, said: str, command: str
) -> None:
    low, high = (0, 50) if command == "pwm_percent" else (1000, 1500)
    rows = "".join(f"{time.format(20 * i)},{low if i < 20 else high},{i // 20}\n" for i in range(40))
    assert said in refusal(tmp_path, f"t,{command},thrust_n\n{rows}")


@pytest.mark.parametrize("number", ['"1,000.5"', "1'000.5", "1\u2019000.5", "1\u202f000.5"])
def test_thousands_with_a_sign_between_them_are_refused_with_what_to_write(tmp_path: Path, number: str) -> None:
    said = refusal(tmp_path, f"cmd,thrust_n,rpm\n2000,0.1,900\n20000,0.2,{number}\n40000,0.4,3000\n")
    assert "stand.csv:3: '1" in said
    assert "in column 'rpm' is not a number. Write thousands without a sign or a space between digits." in said


@pytest.mark.parametrize("thrust", ["253;302;356", "253,4;302,1;356,0"])
def test_points_between_the_thousands_of_speeds_are_asked_about(tmp_path: Path, thrust: str) -> None:
    rows = zip((50, 55, 60), thrust.split(";"), ("5.230", "5.715", "6.170"), strict=True)
    said = refusal(tmp_path, "PWM [%];Schub [g];Drehzahl [U/min]\n" + "".join(f"{a};{b};{c}\n" for a, b, c in rows))
    beside = " beside '253,4' in column 'Schub [g]'" if "," in thrust else ""
    assert f"stand.csv:2: '5.230' in column 'Drehzahl [U/min]'{beside}: is its point one of thousands? Write" in said


def test_decimal_points_before_three_digits_are_taken_as_such(tmp_path: Path) -> None:
    text = "pwm_percent,Thrust (N),Speed (krpm),voltage_V\n0,0,0,11.100\n50,2.530,5.230,11.000\n60,3.560,6.170,10.900\n"
    (tmp_path / "stand.csv").write_text(text)
    table = read_stand_table(tmp_path / "stand.csv")
    assert table.speeds_rad_s is not None
    assert table.speeds_rad_s[1, 0] == pytest.approx(5230 * 2 * np.pi / 60)
