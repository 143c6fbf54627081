"""Logs in CSV files: each program's header is recognised, and variables get the firmware's names and units."""

from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from cfid.errors import ConfigError, DataError
from cfid.records.logs.any_kind import read_log
from cfid.records.tables.blocks import BLOCK_BYTES
from cfid.records.tables.schema import Foreign
from tests.places import DATA


def written(folder: Path, text: str) -> Path:
    (folder / "log.txt").write_text(text)
    return folder / "log.txt"


def lines(head: str, row: str, count: int = 40, step: float = 10) -> str:
    return "\n".join([head, *(row.format(t=1000 + step * at, x=at / 4) for at in range(count)), ""])


def test_the_client_s_log_is_in_milliseconds_and_firmware_units(tmp_path: Path) -> None:
    log = read_log(written(tmp_path, lines("Timestamp,stabilizer.roll,gyro.z", "{t:.0f},{x},{x}")))
    time_s, rate = log.channel("gyro.z")
    np.testing.assert_allclose(time_s, 1 + 0.01 * np.arange(40))
    np.testing.assert_allclose(rate, np.radians(np.arange(40) / 4))
    assert log.program == "CSV log of the Crazyflie client"
    assert log.assumed == ("Timestamp is in ms, as that program writes it",)


@pytest.mark.parametrize("begin", ["23", "1764000000"])
def test_a_client_s_log_whose_times_are_in_seconds_is_refused_with_the_option_that_helps(
    tmp_path: Path, begin: str
) -> None:
    rows = "".join(f"{begin}.{at:03d},0\n" for at in range(0, 900, 10))
    path = written(tmp_path, f"Timestamp,gyro.z\n{rows}")
    with pytest.raises(
        DataError, match=r"Timestamp is read in ms, .* and its rows would be 0\.01 ms apart.*`time_unit` s"
    ):
        read_log(path)
    assert read_log(path, Foreign(time_unit="s")).series[0].time_s[-1] == pytest.approx(float(begin) + 0.89)


@pytest.mark.parametrize(("unit", "second"), [("s", 1.0), ("ms", 1e3), ("us", 1e6)])
def test_a_table_decoded_from_a_card_has_the_clock_that_is_given(
    tmp_path: Path, unit: Literal["s", "ms", "us"], second: float
) -> None:
    slow_s = 84 / 85 * (5 + 0.01 * np.arange(300))
    path = written(tmp_path, "\n".join(["timestamp,gyro.x", *(f"{second * at:.6f},{at}" for at in slow_s), ""]))
    clocks: dict[Literal["true", "84/85"] | None, float] = {None: 1.0, "true": 1.0, "84/85": 85 / 84}
    for clock, ratio in clocks.items():
        log = read_log(path, Foreign(time_unit=unit, clock=clock))
        np.testing.assert_allclose(log.series[0].time_s, ratio * slow_s, rtol=1e-6)


def test_a_clock_is_refused_for_a_table_that_no_vehicle_made(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="`clock` is for logs of a Crazyflie's uSD card and tables made of them"):
        read_log(written(tmp_path, lines("t_s,a", "{t},{x}", step=0.01)), Foreign(clock="84/85"))


def test_crazyswarm2_s_simulator_is_recognised(tmp_path: Path) -> None:
    log = read_log(written(tmp_path, lines("timestamp,x,y,z,qw,qx,qy,qz", "{t},{x},0,1,1,0,0,0", step=0.01)))
    assert log.program == "CSV file of Crazyswarm2's simulator"
    assert [channel.unit for channel in log.series[0].channels] == ["m"] * 3 + ["1"] * 4


def test_a_time_without_a_unit_is_read_by_its_step_and_that_is_said(tmp_path: Path) -> None:
    path = written(tmp_path, lines("time,a", "{t},{x}"))
    log = read_log(path)
    assert log.channel("a")[0][-1] == pytest.approx(1.39)
    assert "is read in ms" in " ".join((*log.notes, *log.assumed))
    assert read_log(path, Foreign(time_unit="ms")).channel("a")[0][-1] == pytest.approx(1.39)


@pytest.mark.parametrize(("unit", "per_s"), [("ms", 1000), ("us", 1_000_000)])
def test_times_become_the_seconds_that_are_nearest_to_them(tmp_path: Path, unit: str, per_s: int) -> None:
    stamps = [(1_000_001 + 7 * at) * per_s // 1000 for at in range(2000)]
    log = read_log(written(tmp_path, f"t_{unit},a\n" + "".join(f"{at},1\n" for at in stamps)))
    assert log.series[0].time_s.tolist() == [at / per_s for at in stamps]


def test_a_column_of_words_is_left_out_and_named(tmp_path: Path) -> None:
    log = read_log(written(tmp_path, lines("time,a,state,b", "{t},{x},flying,{x}", step=0.01)))
    assert log.series[0].names == ("a", "b")
    assert "'flying' in column 'state' is not a number" in log.notes[0]


def test_columns_of_one_name_are_left_out_and_the_others_kept(tmp_path: Path) -> None:
    log = read_log(written(tmp_path, lines("t_s,a,b,a", "{t},{x},{x},1", step=0.01)))
    assert [channel.name for channel in log.series[0].channels] == ["b"]
    assert any("the columns 2, 4 are all named 'a': rename them" in text for text in log.notes)
    with pytest.raises(DataError, match="the columns 2, 3 are all named 'a': rename them"):
        read_log(written(tmp_path, lines("t_s,a,a", "{t},{x},1", step=0.01)))


def test_a_column_that_begins_late_is_kept_with_its_numbers_and_an_empty_one_is_named(tmp_path: Path) -> None:
    rows = "".join(f"{14812 + 2 * at},,{at if at > 20 else ''},{at / 8}\n" for at in range(60))
    path = written(tmp_path, "tick,controller.r_roll,controller.cmd_roll,acc.z\n" + rows)
    log = read_log(path)
    assert log.series[0].names == ("controller.cmd_roll", "acc.z")
    assert log.series[0].time_s[-1] == pytest.approx(14.930)
    late = log.channel("controller.cmd_roll")[1]
    assert np.isnan(late[:21]).all()
    np.testing.assert_array_equal(late[21:], np.arange(21, 60))
    assert any("column 'controller.r_roll' is empty" in note for note in log.notes)
    assert "column 'controller.cmd_roll' has no finite number in 21 of 60 rows." in log.notes
    assert any("time is read in ms" in note for note in log.notes)


def test_a_table_of_several_blocks_is_one_log_and_its_cut_line_is_noted(tmp_path: Path) -> None:
    path = written(tmp_path, lines("time,a", "{t},{x!r}", count=80_000, step=0.01) + "9000.01,3")
    assert path.stat().st_size > BLOCK_BYTES
    log = read_log(path)
    np.testing.assert_array_equal(log.channel("a")[1], np.arange(80_000) / 4)
    assert len(list(log.series[0].blocks())) > 1
    assert "last line was cut" in log.notes[-1]


def test_lines_of_words_far_down_are_left_out_and_the_first_is_named(tmp_path: Path) -> None:
    rows = lines("time,a", "{t},{x!r}", count=80_000, step=0.01).splitlines()
    path = written(tmp_path, "\n".join([*rows[:70_000], "paused", "resumed, by hand, later", *rows[70_000:], ""]))
    log = read_log(path)
    np.testing.assert_array_equal(log.channel("a")[1], np.arange(80_000) / 4)
    assert "2 lines without a number are left out (first: line 70001, 'paused')." in log.notes


@pytest.mark.parametrize("damaged", ["0.31", "5.01,2,7", "5.01,2,5.02,3"])
def test_a_damaged_line_of_many_is_left_out_and_named_and_one_of_few_is_refused(tmp_path: Path, damaged: str) -> None:
    rows = lines("time,a", "{t},{x!r}", count=2000, step=0.01).splitlines()
    log = read_log(written(tmp_path, "\n".join([*rows[:501], damaged, *rows[501:], ""])))
    np.testing.assert_array_equal(log.channel("a")[1], np.arange(2000) / 4)
    assert f"line 502, '{damaged}', has not 2 fields and is left out." in log.notes
    with pytest.raises(DataError, match=r":22: "):
        read_log(written(tmp_path, "\n".join([*rows[:21], damaged, *rows[21:40], ""])))


@pytest.mark.parametrize("column", ["imu_acc_x", "motor_motor_m1", "imu_gyro_x"])
def test_a_part_of_nanobench_is_read_with_the_firmware_s_names(tmp_path: Path, column: str) -> None:
    log = read_log(written(tmp_path, lines(f"t,{column}", "{t},{x!r}", count=200, step=0.01)))
    assert log.program == "CSV log of NanoBench"
    assert log.series[0].names in (("acc.x",), ("motor.m1",), ("imu_gyro_x", "gyro.x"), ("imu_gyro_x",))


def test_a_fault_far_down_names_its_line(tmp_path: Path) -> None:
    rows = lines("time,a", "{t},{x}", count=60_000, step=0.01).splitlines()
    rows[50_000:] = rows[40_000:50_000]
    with pytest.raises(DataError, match=r":50001: time goes back.*Cut the file in two before that line"):
        read_log(written(tmp_path, "\n".join([*rows, ""])))


def test_a_row_that_is_swapped_with_the_next_is_left_out_and_named(tmp_path: Path) -> None:
    rows = lines("time,a", "{t},{x!r}", count=60_000, step=0.01).splitlines()
    for row in (10, 50_000):
        rows[row], rows[row + 1] = rows[row + 1], rows[row]
    log = read_log(written(tmp_path, "\n".join([*rows, ""])))
    kept = np.delete(np.arange(60_000), [9, 49_999])
    np.testing.assert_array_equal(log.channel("a")[1], kept / 4)
    assert log.notes == ("2 rows whose time is off that of the rows around (first: 1000.09 in line 12) are left out.",)


def test_times_that_are_wrong_in_more_than_one_row_in_a_hundred_are_counted_with_what_helps(tmp_path: Path) -> None:
    rows = lines("time,a", "{t},{x!r}", count=6000, step=0.01).splitlines()
    for row in range(101, 6000, 50):
        rows[row] = f"90000,{row}"
    expected = r":103: time goes back 118 times, first from 90000 to 1001.01 s.*1 % at most.*`rate_hz`"
    with pytest.raises(DataError, match=expected):
        read_log(written(tmp_path, "\n".join([*rows, ""])))


def test_single_wrong_times_leave_out_their_rows_and_are_named(tmp_path: Path) -> None:
    rows = lines("time,a", "{t},{x!r}", count=60_000, step=0.01).splitlines()
    rows[50_000] = "90000,7"
    rows[50_500] = "abc,7"
    log = read_log(written(tmp_path, "\n".join([*rows, ""])))
    kept = np.delete(np.arange(60_000), [49_999, 50_499])
    np.testing.assert_array_equal(log.channel("a")[1], kept / 4)
    np.testing.assert_allclose(log.channel("a")[0], 1000 + 0.01 * kept)
    assert log.notes == (
        "1 of 60000 rows lacks a number in column 'time' (first: line 50501) and is left out.",
        "1 row whose time is off that of the rows around (first: 90000 in line 50001) is left out.",
    )


def test_a_clock_that_was_set_forward_in_a_log_is_named_with_its_line(tmp_path: Path) -> None:
    rows = "".join(f"{1000 + 10 * at + 3_600_000 * (at >= 200)},{at}\n" for at in range(400))
    log = read_log(written(tmp_path, f"Timestamp,gyro.x\n{rows}"))
    assert log.notes == (
        "1 gap without rows, the longest of 3600 s after line 201 (1.99 s); rows are usually 10 ms apart. Was the "
        "clock set?",
    )


def test_times_of_day_are_refused_with_the_rate_that_stands_for_them(tmp_path: Path) -> None:
    rows = "".join(f"2026-03-01 10:00:{at / 100:06.3f},{at}\n" for at in range(40))
    path = written(tmp_path, f"time,gyro.x\n{rows}")
    with pytest.raises(DataError, match="Dates and times of day are not read: write seconds, or give `rate_hz`"):
        read_log(path)
    assert read_log(path, Foreign(rate_hz=100.0)).series[0].time_s[-1] == pytest.approx(0.39)


def test_nanobench_is_read_with_the_firmware_s_names() -> None:
    path = DATA / "flights" / "nanobench_B2_circle_fast_rep2.csv"
    if not path.exists():
        pytest.skip("the public flights are not here (CFID_DATA)")
    log = read_log(path)
    assert log.program == "CSV log of NanoBench"
    time_s, acceleration = log.channel("acc.z")
    assert np.median(np.diff(time_s)) == pytest.approx(0.01, rel=1e-3)
    assert np.median(acceleration) == pytest.approx(9.81, rel=0.05)
    assert {"motor.m1", "pm.vbat", "stateEstimate.vx", "wx_vicon", "imu_gyro_y"} <= set(log.series[0].names)
    assert log.channel("stateEstimate.roll")[1].max() < np.pi
    gyro, seen = log.channel("imu_gyro_x")[1], log.channel("wx_vicon")[1]  # from motion capture, late and smoothed
    assert gyro @ seen == pytest.approx(seen @ seen, rel=0.3)


def test_a_rate_stands_for_the_column_of_times_and_that_is_said(tmp_path: Path) -> None:
    log = read_log(written(tmp_path, lines("time,a", "{t},{x}")), Foreign(rate_hz=4.0))
    assert log.series[0].names == ("a",)
    assert log.channel("a")[0][-1] == pytest.approx(39 / 4)
    assert "times are those of `rate_hz` 4: column 'time' is not used." in log.notes


def test_a_stands_units_stand_in_its_heads_and_its_empty_columns_are_one_sentence(tmp_path: Path) -> None:
    head = "Time (s),ESC signal (µs),Servo 1 (µs),Servo 2 (µs),Thrust (gf),Torque (N·m),Motor Optical Speed (RPM)"
    head += ",Vibration (g)"
    rows = "".join(f"{2.1 * at},{1000 + 50 * at},,,{at * at},{at / 100},{900 * at},0.1\n" for at in range(12))
    log = read_log(written(tmp_path, f"{head}\n{rows}"))
    units = {channel.name.partition(" (")[0]: channel.own_unit for channel in log.series[0].channels}
    assert units == {
        "ESC signal": "us",
        "Thrust": "gf",
        "Torque": "N m",
        "Motor Optical Speed": "rpm",
        "Vibration": "",
    }
    assert [note for note in log.notes if "empty" in note] == [
        "left out: columns 'Servo 1 (µs)', 'Servo 2 (µs)' are empty."
    ]
    assert log.channel("Motor Optical Speed (RPM)")[1][1] == pytest.approx(900 * np.pi / 30)
    assert log.series[0].time_s[1] == pytest.approx(2.1)
    assert "firmware" not in " ".join(log.assumed)


def test_whole_numbers_of_more_digits_than_a_float_has_are_named(tmp_path: Path) -> None:
    rows = "".join(f"{at / 100},{2**53 + at},{2**53 - at}\n" for at in range(20))
    log = read_log(written(tmp_path, f"t_s,nanoseconds,below\n{rows}"))
    assert [note for note in log.notes if "2^53" in note] == [
        "column 'nanoseconds' has numbers above 2^53, which lose their last digits here."
    ]


@pytest.mark.parametrize("large", ["3.1e+250", "-4.5e17", "123456789012345680.0", str(2**60)])
def test_large_numbers_that_come_back_as_they_are_written_need_no_note(tmp_path: Path, large: str) -> None:
    rows = "".join(f"{at / 100},{large if at == 7 else at}\n" for at in range(20))
    log = read_log(written(tmp_path, f"t_s,value\n{rows}"))
    assert log.channel("value")[1][7] == float(large)
    assert not [note for note in log.notes if "2^53" in note]


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("theta_rad", "rad"),
        ("pos__deg_", "deg"),
        ("Fx_n", "N"),
        ("Tz [Nm]", "N m"),
        ("Tx (N-m)", "N m"),
        ("RPM", "rpm"),
        ("enc_counts", "counts"),
        ("phi", ""),
    ],
)
def test_the_unit_in_the_name_of_an_angle_or_a_force_is_that_of_the_channel(
    tmp_path: Path, name: str, unit: str
) -> None:
    rows = "".join(f"{at / 100},{at},{at}\n" for at in range(20))
    log = read_log(written(tmp_path, f"t_s,{name},other\n{rows}"))
    assert [channel.own_unit for channel in log.series[0].channels] == [unit, ""]


def test_units_in_brackets_behind_the_firmware_s_names_are_the_columns_own(tmp_path: Path) -> None:
    head = "time [s],motor.m1 [PWM],gyro.x [rad/s],gyro.y (deg/s),acc.z [m/s^2],acc.x [g],pm.vbat [mV],rpm.m1 [rpm]"
    log = read_log(written(tmp_path, lines(head, "{t},{x},{x},{x},{x},{x},{x},{x}", step=0.01)))
    x = np.arange(40) / 4
    expected = {"motor.m1": x, "gyro.x": x, "gyro.y": np.radians(x), "acc.z": x, "acc.x": 9.81 * x, "pm.vbat": x / 1e3}
    for name, value in expected.items():
        np.testing.assert_allclose(log.channel(name)[1], value)
    assert log.series[0].names[:4] == ("motor.m1", "gyro.x [rad/s]", "gyro.y", "acc.z [m/s^2]")
    assert log.assumed == ("1 g is 9.81 m/s^2",)


def test_units_in_brackets_behind_nanobench_s_names_are_the_columns_own(tmp_path: Path) -> None:
    head = "t,motor_motor_m1,imu_gyro_x [deg/s],imu_acc_x [m/s^2]"
    log = read_log(written(tmp_path, lines(head, "{t},{x},{x},{x}", step=0.01)))
    np.testing.assert_allclose(log.channel("gyro.x")[1], np.radians(np.arange(40) / 4))
    np.testing.assert_allclose(log.channel("acc.x")[1], np.arange(40) / 4)


def test_a_second_line_may_state_the_units_of_the_firmware_s_variables(tmp_path: Path) -> None:
    log = read_log(written(tmp_path, lines("t,motor.m1,acc.z\ns,PWM,m/s^2", "{t},{x},{x}", step=0.01)))
    np.testing.assert_allclose(log.channel("acc.z")[1], np.arange(40) / 4)


def test_underscores_stand_for_the_firmware_s_dots_where_a_column_can_be_no_other_vehicle_s(tmp_path: Path) -> None:
    log = read_log(written(tmp_path, lines("Timestamp,motor_m1,gyro_x,range_x", "{t:.0f},{x},{x},{x}", step=2)))
    assert log.series[0].names == ("motor.m1", "gyro.x", "range_x")
    assert log.assumed[0] == "column 'motor_m1' is the firmware's motor.m1, and others like it are too"
    assert log.channel("gyro.x")[1][-1] == pytest.approx(np.radians(39 / 4))
    for others in ("t,gyro_x,acc_x", "t,motor_m1,motor.m1"):
        path = written(tmp_path, lines(others, "{t},{x},{x}", step=0.01))
        assert read_log(path).series[0].names == tuple(others.split(",")[1:])


def test_a_time_that_is_named_by_its_number_is_the_time_and_no_other_column(tmp_path: Path) -> None:
    path = written(tmp_path, "when,x\n" + "".join(f"{at / 10},{at}\n" for at in range(40)))
    log = read_log(path, Foreign(columns=("1",), time_unit="s"))
    assert [series.names for series in log.series] == [("x",)]
    np.testing.assert_allclose(log.channel("x"), [np.arange(40) / 10, np.arange(40)])


def test_a_table_of_times_alone_below_a_head_of_words_ends_in_a_sentence(tmp_path: Path) -> None:
    path = written(tmp_path, "Lab file,\nVersion,2\n" + "".join(f"{at / 10},\n" for at in range(40)))
    with pytest.raises(DataError, match=r"empty|no column"):
        read_log(path, Foreign(columns=("1", "2"), time_unit="s"))


def test_a_client_s_times_in_nanoseconds_are_named_as_that(tmp_path: Path) -> None:
    """Previously, the times were read as ms, which took minutes and gave no rows."""
    stamps = 1_760_000_000_000_000_000 + 10_000_000 * np.arange(500)
    path = tmp_path / "log.csv"
    path.write_text("Timestamp,motor.m1,rpm.m1\n" + "".join(f"{stamp},30000,9000\n" for stamp in stamps))
    with pytest.raises(DataError, match=r"starts at 1760000000000000000, a date \(Unix time\) in ns"):
        read_log(path)


@pytest.mark.parametrize(
    ("name", "text"), [("/dev/null", "a pipe or a device"), ("missing.csv", "no such file"), (".", "a folder")]
)
def test_what_is_no_file_of_a_log_is_named_as_what_it_is(name: str, text: str) -> None:
    with pytest.raises(DataError, match=text):
        read_log(Path(name))
