"""Tables of motors, typed or from thrust stands: known heads give columns in SI units, the rest is a question."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import CfidError, ConfigError, DataError
from cfid.recordings.recording import How, Series
from cfid.recordings.stand import StandTable, canonical_stand, read_stand, stand_of
from cfid.units import RPM
from tests.lab import DATA

OLD = DATA / "bitcraze_2015" / "cf20_pwm_thrust_2015.csv"
GF = 9.80665e-3
Array = npt.NDArray[np.float64]


def read(folder: Path, text: str | bytes, how: How | None = None, *, gravity_mps2: float = 9.81) -> StandTable:
    path = folder / "stand.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return stand_of(read_stand(path, how), how, gravity_mps2=gravity_mps2)


def refusal(folder: Path, text: str, how: How | None = None) -> CfidError:
    with pytest.raises((ConfigError, DataError)) as caught:
        read(folder, text, how)
    return caught.value


def codes(table: StandTable) -> set[str]:
    return {one.code for one in table.findings}


# Heads


def test_a_typed_table_of_one_motor_is_read_as_it_says(tmp_path: Path) -> None:
    table = read(
        tmp_path,
        "cmd,thrust_n,torque_nm,speed_rad_s,vbat_v\n0,0,0,0,4.1\n2000,0.0027,3e-5,462,4.1\n64000,0.154,9e-4,2989,3.6\n",
    )
    assert table.command.tolist() == [0, 2000, 64000]
    assert np.asarray(table.thrust_n).tolist() == [0, 0.0027, 0.154]
    assert np.asarray(table.torque_nm).tolist() == [0, 3e-5, 9e-4]
    assert np.asarray(table.square_mean_speed_rad_s).tolist() == [0, 462, 2989]
    assert np.asarray(table.vbat_v).tolist() == [4.1, 4.1, 3.6]
    assert (table.motors, table.rotors, table.speeds, table.time_s) == (None, 1, "motor", None)
    assert codes(table) == {"file-read"}


@pytest.mark.parametrize(
    ("head", "quantity", "value", "expected"),
    [
        ("weight[g]", "thrust_n", 40, 0.04 * 9.81),
        ("Thrust (gf)", "thrust_n", 40, 40 * GF),
        ("Thrust (kgf)", "thrust_n", 1, 1e3 * GF),
        ("Thrust (lbf)", "thrust_n", 1, 4.4482216),
        ("Thrust [mN]", "thrust_n", 250, 0.25),
        ("thrust_total_g", "thrust_n", 40, 0.04 * 9.81 / 4),
        ("Torque [mNm]", "torque_nm", 250, 0.25),
        ("Torque (lbf\u00b7in)", "torque_nm", 1, 0.1129848),
        ("vbat_mv", "vbat_v", 3700, 3.7),
        ("Motor Optical Speed (RPM)", "square_mean_speed_rad_s", 6000, 200 * math.pi),
        ("rpm_mean", "square_mean_speed_rad_s", 6000, 200 * math.pi),
        ("omega [rad/s]", "square_mean_speed_rad_s", 9, 9),
        ("grams", "grams", 40, 40),
    ],
)
def test_a_known_head_gives_its_quantity_in_its_unit(
    tmp_path: Path, head: str, quantity: str, value: float, expected: float
) -> None:
    table = read(tmp_path, f"pwm;{head};rpm_1\n0;0;0\n40000;{value};1\n" if "rpm" not in head and "omega" not in head
                 and "Speed" not in head else f"pwm;{head}\n0;0\n40000;{value}\n")  # fmt: skip
    assert np.asarray(getattr(table, quantity))[-1] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("head", "values"),
    [
        ("pwm", (0, 32768, 65535)),
        ("Throttle (%)", (0, 50, 100)),
        ("command_fraction", (0, 0.5, 1)),
        ("ESC signal (\u00b5s)", (1000, 1500, 2000)),
        ("ESC signal (\u03bcs)", (1000, 1500, 2000)),
        ("esc[us]", (900, 1500, 2000)),
    ],
)
def test_a_command_of_a_stated_unit_is_one_from_0_to_65535(
    tmp_path: Path, head: str, values: tuple[float, ...]
) -> None:
    rows = "".join(f"{value},{at}\n" for at, value in enumerate(values))
    assert read(tmp_path, f"{head},thrust_n\n{rows}").command == pytest.approx([0, 32768, 65535], abs=0.6)


def test_series_of_a_tachometer_and_rotors_of_a_vehicle_stand_beside_each_other(tmp_path: Path) -> None:
    series = read(tmp_path, "cmd,rpm_1,rpm_2\n0,0,0\n20000,9000,8800\n")
    assert (series.speeds, series.rotors) == ("series", 1)
    assert np.asarray(series.speeds_rad_s) == pytest.approx(RPM * np.array([[0, 0], [9000, 8800]]))
    rotors = read(tmp_path, "pwm,rpm1,rpm2,rpm3,rpm4\n30000,8000,9000,10000,11000\n")
    assert (rotors.speeds, rotors.rotors) == ("rotors", 4)
    assert np.asarray(rotors.square_mean_speed_rad_s) == pytest.approx([math.sqrt(91.5e6) * RPM])


def test_the_flight_stands_powertrain_before_each_head_is_no_part_of_it(tmp_path: Path) -> None:
    heads = "Time (s),X - ESC throttle (\u03bcs),X - force Fz (thrust) (kgf),X - torque MZ (torque) (N\u22c5m),"
    table = read(tmp_path, f"{heads}X - voltage (V),X - rotation speed (rpm)\n0,1000,0,0,12,0\n2,2000,1,0.2,11,1200\n")
    assert table.command.tolist() == [0, 65535]
    assert np.asarray(table.thrust_n) == pytest.approx([0, 9.80665])
    assert np.asarray(table.torque_nm).tolist() == [0, 0.2]
    assert np.asarray(table.square_mean_speed_rad_s) == pytest.approx([0, 40 * math.pi])


# What a file does not say


@pytest.mark.parametrize(
    ("text", "kind", "code"),
    [
        ("gas,thrust_n\n1,2\n", DataError, "no-stand"),
        ("cmd,vbat_v\n1,4\n", DataError, "no-stand"),
        ("cmd,thrust\n9000,4\n", ConfigError, "no-unit"),
        ("cmd,weight[g],thrust[N]\n9000,4,2\n", DataError, "several-columns"),
        ("ESC A (us),ESC B (us),Thrust (N)\n1000,1000,2\n", DataError, "no-stand"),
        ("cmd,pwm,thrust_n\n9000,4,2\n", DataError, "several-columns"),
        ("cmd,thrust[rpm]\n9000,4\n", DataError, "other-unit"),
        ("pwm,thrust_n\n0,0\n100,0.1\n", ConfigError, "no-unit"),
        ("pwm,thrust_n\n0,0\n255,0.1\n", ConfigError, "no-unit"),
        ("pwm,thrust_n\n1000,0\n2000,0.1\n", ConfigError, "no-unit"),
        ("pwm,thrust_n\n2000,0.1\n-4000,0.1\n", DataError, "impossible"),
        ("cmd,thrust_n\n2000,0.1\n70000,0.1\n", DataError, "impossible"),
        ("cmd,thrust_n,vbat_v\n9000,0,4100\n9001,0,3900\n", DataError, "impossible"),
        ("ESC signal (us),Thrust (gf)\n1000,0\n2200,60\n", DataError, "pulse-too-long"),
    ],
)
def test_what_a_table_does_not_say_or_cannot_mean_is_one_question(
    tmp_path: Path, text: str, kind: type[CfidError], code: str
) -> None:
    error = refusal(tmp_path, text)
    assert type(error) is kind
    assert error.code == code


@pytest.mark.parametrize(
    ("text", "how"),
    [
        ("pwm,thrust_n\n0,0\n50,1\n100,2\n", How(units={"pwm": "%"})),
        ("pwm,thrust_n\n1000,0\n1500,1\n2000,2\n", How(units={"pwm": "us"})),
        ("pwm,thrust_n\n0,0\n1047.5,1\n2047,2\n", How(dshot=True)),
        ("ESC signal (us),thrust_n\n1100,0\n1650,1\n2200,2\n", How(esc_us=(1100, 2200))),
        ("throttle,thrust_n\n1100,0\n1650,1\n2200,2\n", How(esc_us=(1100, 2200))),
        ("0,0\n32768,1\n65535,2\n", How(columns=("cmd=1", "thrust=2"), units={"thrust": "N"})),
        ("cmd,thrust_n,thrust_n\n0,7,0\n32768,7,1\n65535,7,2\n", How(columns=("thrust_n=3",))),
        ("cmd;thrust_n\n0,0;0\n32768,0;1,0\n65535;2\n", How(decimal=",")),
        ("cmd,thrust_n,Propeller\n0,0,A\n0,9,B\n32768,1,A\n65535,2,A\n", How(rows=(("Propeller", "A"),))),
        ("Tastgrad;Schub\n0;0\n50;1\n100;2\n", How(columns=("pwm_percent=1", "thrust_n=2"))),
    ],
)
def test_an_option_answers_the_question(tmp_path: Path, text: str, how: How) -> None:
    table = read(tmp_path, text, how)
    assert table.command == pytest.approx([0, 32768, 65535], abs=16)
    assert table.thrust_n == pytest.approx([0, 1, 2])


@pytest.mark.parametrize("how", [How(esc_us=(1000, 2000)), How(dshot=True, counts_per_n=1e6), How(clock="true")])
def test_an_option_that_nothing_in_a_table_needs_is_an_error(tmp_path: Path, how: How) -> None:
    assert refusal(tmp_path, "cmd,thrust_n\n0,0\n60000,1\n", how).code == "unused"


@pytest.mark.parametrize(("head", "larger"), [("ESC signal (us)", True), ("cmd", False)])
def test_a_motor_with_its_own_controller_may_be_that_of_a_larger_vehicle(
    tmp_path: Path, head: str, *, larger: bool
) -> None:
    """8.2 N at 80 % are 12.8 N at full command; in a table of the firmware's commands the unit is wrong."""
    rows = "1000,0\n1800,8.2\n" if larger else "0,0\n52428,8.2\n"
    assert ("motor-of-larger-vehicle" in codes(read(tmp_path, f"{head},Thrust (N)\n{rows}"))) is larger


# How many motors


@pytest.mark.parametrize(
    ("thrust", "newtons", "torque"), [("weight[g]", 9.81e-3, "torque_z[N]"), ("thrust[N]", 1.0, "torque_nm")]
)
def test_a_table_of_bitcrazes_stand_is_of_four_motors_in_every_column(
    tmp_path: Path, thrust: str, newtons: float, torque: str
) -> None:
    """Its torque_z[N] is in N m."""
    heads = f"{thrust},pwm,vbat[V],rpm1,rpm2,rpm3,rpm4,{torque}"
    table = read(tmp_path, f"{heads}\n0,0,4,0,0,0,0,0\n40,40000,3.9,9000,9000,9000,9000,0.28\n")
    assert table.motors == 4
    assert np.asarray(table.thrust_n)[1] == pytest.approx(10 * newtons)
    assert np.asarray(table.torque_nm)[1] == pytest.approx(0.07)


# Files of RCbenchmark's stands

NAMES = (
    "Time (s),ESC signal (\u00b5s),Servo 1 (\u00b5s),Torque (N\u00b7m),Thrust (gf),Voltage (V),"
    "Motor Electrical Speed (RPM),Motor Optical Speed (RPM),App message"
)
# time, pulse, torque, thrust, voltage, electrical and optical speed
STEPS = [
    (0.42, 1000, 0.0, 0.0, 8.0, 0, 0),
    (0.38, 1250, 0.001, 10.0, 7.9, 9000, 0),
    (4.31, 1500, 0.002, 25.0, 7.8, 14000, 0),
    (8.32, 2000, 0.004, 60.0, 7.5, 22000, 0),
]


def text_of(rows: list[tuple[Any, ...]], head: str = NAMES) -> str:
    """Return a file in which every line ends with a comma and no servo has values."""
    lines = [f"{t},{esc},,{torque},{thrust},{volts},{el},{opt},," for t, esc, torque, thrust, volts, el, opt in rows]
    return "\n".join([f"{head},", *lines, ""])


@pytest.mark.parametrize(
    "content",
    [
        text_of(STEPS[1:]),
        "\ufeff" + text_of(STEPS[1:]),
        text_of(STEPS[1:]).encode("latin-1"),
        text_of(STEPS[1:]).replace("\n", "\r\n"),
        text_of(STEPS[1:]).replace(",", ";"),
        text_of(STEPS[1:]).replace("message,\n", "message\n"),
        text_of(STEPS[1:]).replace("message,", "message,90% settling time (s),Max acceleration (RPM/s),"),
    ],
    ids=["plain", "byte-order mark", "Latin-1", "CRLF", "semicolons", "a comma in the rows alone", "ragged rows"],
)
def test_a_stands_file_is_read_the_same_in_the_forms_that_real_ones_have(tmp_path: Path, content: str | bytes) -> None:
    table = read(tmp_path, content)
    assert table.command.tolist() == [16384, 32768, 65535]
    assert np.asarray(table.thrust_n) == pytest.approx(GF * np.array([10, 25, 60]))
    assert np.asarray(table.torque_nm).tolist() == [0.001, 0.002, 0.004]
    assert np.asarray(table.vbat_v).tolist() == [7.9, 7.8, 7.5]
    assert np.asarray(table.speeds_rad_s)[:, 0] == pytest.approx(RPM * np.array([9000, 14000, 22000]))
    assert (table.motors, table.speeds, table.time_s) == (None, "motor", None)


def test_rows_seconds_apart_are_settled_points_in_the_order_of_their_times(tmp_path: Path) -> None:
    table = read(tmp_path, text_of(STEPS))
    assert table.time_s is None
    assert table.command.tolist() == [16384, 0, 32768, 65535]
    assert codes(table) >= {"rows-settled", "time-sorted"}


def test_the_speed_is_that_of_the_sensor_that_sees_the_rotor(tmp_path: Path) -> None:
    optical = read(tmp_path, text_of([(*row[:5], 0, row[5]) for row in STEPS[1:]]))
    assert np.asarray(optical.speeds_rad_s)[-1] == pytest.approx(22000 * RPM)
    neither = read(tmp_path, text_of([(*row[:5], 0, 0) for row in STEPS[1:]]))
    assert (neither.speeds_rad_s, neither.rotors) == (None, None)
    assert "speeds-zero" in codes(neither)
    apart = read(tmp_path, text_of([(*row[:5], 7 * row[5], row[5]) for row in STEPS[1:]]))
    assert np.asarray(apart.speeds_rad_s)[-1] == pytest.approx(22000 * RPM)
    assert "speeds-disagree" in codes(apart)
    few = read(tmp_path, text_of([(*row[:5], row[5], 500 if row[1] == 1500 else 0) for row in STEPS[1:]]))
    assert np.asarray(few.speeds_rad_s)[-1] == pytest.approx(22000 * RPM)


def test_a_speed_of_0_beside_a_rotor_that_turns_is_missing(tmp_path: Path) -> None:
    lost = read(tmp_path, text_of([(*row[:5], row[5] if row[1] != 1500 else 0, 0) for row in STEPS[1:]]))
    assert np.isnan(np.asarray(lost.speeds_rad_s)[:, 0]).tolist() == [False, True, False]
    low = [(0.4, 1050, 0, 6.1, 7.4, 0, 0), (2.2, 1145, 0, 14.6, 7.4, 3853, 0), (9, 2000, 0, 400, 7.1, 18600, 0)]
    assert np.isnan(np.asarray(read(tmp_path, text_of(low)).speeds_rad_s)[:, 0]).tolist() == [True, False, False]


def test_a_puller_that_is_mounted_the_other_way_is_turned_and_that_is_stated(tmp_path: Path) -> None:
    table = read(tmp_path, text_of([(t, esc, -torque, -thrust, *rest) for t, esc, torque, thrust, *rest in STEPS[1:]]))
    assert np.asarray(table.thrust_n) == pytest.approx(GF * np.array([10, 25, 60]))
    assert np.asarray(table.torque_nm) == pytest.approx([0.001, 0.002, 0.004])
    assert [one.code for one in table.findings].count("sign-turned") == 2


def test_leads_that_were_not_connected_give_no_voltage(tmp_path: Path) -> None:
    assert read(tmp_path, text_of([(*row[:4], 0, *row[5:]) for row in STEPS[1:]])).vbat_v is None
    lost = read(tmp_path, text_of([(*row[:4], 0 if row[1] > 1400 else 7.9, *row[5:]) for row in STEPS[1:]]))
    assert np.array_equal(np.asarray(lost.vbat_v), [7.9, np.nan, np.nan], equal_nan=True)


# Recordings over time


def stepped(change: dict[str, dict[int, float]] | None = None) -> str:
    """Return the text of a stand's recording at 50 Hz with steps of the throttle and some values changed."""
    step, rng = np.repeat([1000.0, 1300, 1600, 1900, 1500, 1200], 100), np.random.default_rng(3)
    force = np.convolve(np.append(np.zeros(20), (step - 1000) ** 2 / 1e5), np.exp(-np.arange(40) / 5) / 5.5)[20:620]
    columns: dict[str, Array] = {
        "Time (s)": np.arange(len(step)) / 50,
        "ESC signal (us)": step,
        "Thrust (N)": force + 1e-3 * rng.standard_normal(600),
        "Motor Optical Speed (RPM)": np.where(step > 1000, 9 * step + rng.standard_normal(600), 0),
        "Voltage (V)": 12 - 0.001 * (step - 1000) + 0.01 * rng.standard_normal(600),
    }
    for name, values in (change or {}).items():
        columns[name][list(values)] = list(values.values())
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return "\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows), ""])


@pytest.mark.parametrize(
    ("head", "quantity", "values"),
    [
        ("Thrust (N)", "thrust_n", {50: 90.0, 250: 0.0, 251: 0.0}),
        ("Motor Optical Speed (RPM)", "speeds_rad_s", {333: 90000.0, 460: 1.0}),
        ("Voltage (V)", "vbat_v", dict.fromkeys(range(420, 425), 3.3)),
    ],
)
def test_readings_off_those_around_them_are_left_out_and_named(
    tmp_path: Path, head: str, quantity: str, values: dict[int, float]
) -> None:
    table = read(tmp_path, stepped({head: values}))
    missing = np.isnan(np.asarray(getattr(table, quantity)).reshape(600, -1)[:, 0])
    assert np.flatnonzero(missing).tolist() == list(values)
    (found,) = [one for one in table.findings if one.code == "values-off"]
    assert f"{len(values)} values of '{head}'" in found.text
    assert f"line {min(values) + 2}" in found.text


def test_a_sensor_that_repeats_one_value_while_the_command_changes_is_left_out_there(tmp_path: Path) -> None:
    table = read(tmp_path, stepped({"Motor Optical Speed (RPM)": dict.fromkeys(range(250, 420), 14000.0)}))
    assert np.flatnonzero(np.isnan(np.asarray(table.speeds_rad_s)[:, 0])).tolist() == list(range(251, 420))
    assert "values-stuck" in codes(table)


def test_a_sensor_that_is_dead_for_a_while_is_missing_under_a_small_thrust_too(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    pulses = np.repeat([1000, 1150, 1400, 2000, 1150, 1000], 40)
    rpm = 12.0 * (pulses - 1000)
    thrust = 0.03 + 1.2e-8 * rpm**2 + 1e-4 * rng.standard_normal(len(pulses))  # of a load cell that is not tared
    rpm[60:170] = 0
    rows = zip(np.arange(len(pulses)) / 50, pulses, thrust, rpm, strict=True)
    lines = [",".join(f"{value:.6g}" for value in row) for row in rows]
    table = read(tmp_path, "\n".join(["t_s,esc[us],thrust_n,rpm", *lines, ""]))
    assert np.flatnonzero(np.isnan(np.asarray(table.speeds_rad_s)[:, 0])).tolist() == list(range(60, 170))


def held(rows: int = 60, head: str = "weight[g],pwm,rpm1,rpm2,rpm3,rpm4") -> str:
    """Return a recording in which each pwm is held for twenty rows."""
    tail = ",9,9,9,9" if "rpm4" in head else ""
    return "\n".join([head, *(f"{i % 7},{10000 * (i // 20)}{tail}" for i in range(rows)), ""])


def test_rows_without_a_time_are_a_recording_at_100_hz_for_bitcrazes_stand_alone(tmp_path: Path) -> None:
    table = read(tmp_path, held())
    assert np.asarray(table.time_s) == pytest.approx(np.arange(60) / 100)
    assert "rate-assumed" in codes(table)
    assert refusal(tmp_path, held(head="weight[g],pwm")).code == "no-time"
    given = read(tmp_path, held(head="weight[g],pwm"), How(rate_hz=50.0))
    assert np.asarray(given.time_s) == pytest.approx(np.arange(60) / 50)
    assert read(tmp_path, held(head="weight[g],pwm"), How(rate_hz=0.5)).time_s is None


def test_times_without_a_unit_are_asked_for_where_they_are_no_seconds_of_a_rig(tmp_path: Path) -> None:
    rows = "".join(f"{20 * at},{1000 + 500 * (at >= 40)},{at}\n" for at in range(80))
    assert refusal(tmp_path, f"t,esc[us],thrust_n\n{rows}").code == "no-unit"
    for text, how in ((f"time[ms],esc[us],thrust_n\n{rows}", None), (f"t,esc[us],thrust_n\n{rows}", {"t": "ms"})):
        table = read(tmp_path, text, None if how is None else How(units=how))
        assert np.asarray(table.time_s)[-1] == pytest.approx(1.58)


def test_load_cells_that_are_read_less_often_are_missing_in_between(tmp_path: Path) -> None:
    rows = [(f"{0.01 * i:.3f}", 1500 if i >= 10 else "", "", i if i % 4 == 0 else "", 8, i, 0) for i in range(80)]
    table = read(tmp_path, text_of(rows))
    assert len(table.command) == 70
    assert np.count_nonzero(np.isfinite(np.asarray(table.thrust_n))) == 17
    assert codes(table) >= {"rows-without-command", "values-missing"}
    assert table.torque_nm is None


# Rows


def test_a_recording_is_kept_under_names_that_give_the_same_when_they_are_read(tmp_path: Path) -> None:
    heads = "Time (s),ESC signal (us),weight[g],Torque (mNm),rpm1,rpm2,Voltage (V)"
    rows = "".join(f"{i / 50},{1000 + 10 * i},{i},{i / 7},{90 * i},{91 * i},8\n" for i in range(60))
    (tmp_path / "a.csv").write_text(f"{heads}\n{rows}")
    kept = canonical_stand(read_stand(tmp_path / "a.csv"))
    (series,) = kept.series.values()
    assert isinstance(series, Series)
    assert series.names == ("throttle", "weight_g", "torque_nm", "vbat_v", "rotor1_rad_s", "rotor2_rad_s")
    columns = [np.asarray(series.time_s), *(column.values for column in series.columns)]
    lines = [",".join(map(repr, row)) for row in np.column_stack(columns).tolist()]
    (tmp_path / "b.csv").write_text("\n".join([",".join(["t_s", *series.names]), *lines, ""]))
    first, second = (stand_of(read_stand(tmp_path / name)) for name in ("a.csv", "b.csv"))
    for name in ("time_s", "command", "thrust_n", "torque_nm", "speeds_rad_s", "vbat_v"):
        assert np.array_equal(getattr(first, name), getattr(second, name), equal_nan=True), name
    assert (second.speeds, second.rotors) == ("rotors", 2)


@pytest.mark.skipif(not OLD.exists(), reason="Bitcraze's table of 2015 is not here (CFID_DATA)")
def test_bitcrazes_table_of_2015_is_settled_points() -> None:
    table = stand_of(read_stand(OLD))
    assert (len(table.command), table.time_s, table.motors, table.speeds) == (16, None, 4, "mean")
    assert table.command[-1] == pytest.approx(0.9375 * 65535)
    assert np.asarray(table.thrust_n)[-1] == pytest.approx(0.0579 * 9.81 / 4)
    assert np.asarray(table.square_mean_speed_rad_s)[-1] == pytest.approx(23882 * RPM)
    assert np.asarray(table.vbat_v)[-1] == 3.3
