"""Time and angle of a file: found by name, in the right unit, and continuous over turns; or the user is asked."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import ConfigError, DataError
from cfid.findings import texts
from cfid.records.tables.angle import AngleRecord, Reading, counts_per_turn, read_angle
from cfid.wire.rls import encode_positions

TURN = 2 * np.pi
TIME_S = np.arange(2000) * 1e-3
ANGLE_RAD = 0.9 * np.exp(-0.4 * TIME_S) * np.cos(9 * TIME_S)
EPOCH_S = 1_763_712_345.0


def text_of(time: npt.ArrayLike, values: npt.ArrayLike, head: str = "t,phi", time_format: str = ".6f") -> str:
    rows = zip(np.asarray(time).tolist(), np.asarray(values).tolist(), strict=True)
    return "".join([f"{head}\n" if head else "", *(f"{t:{time_format}},{value}\n" for t, value in rows)])


def read(folder: Path, text: str, **options: Any) -> AngleRecord:
    path = folder / "swing.csv"
    path.write_text(text)
    return read_angle(path, Reading(**options))


def refusal(folder: Path, text: str, kind: type[Exception] = DataError, **options: Any) -> str:
    with pytest.raises(kind) as caught:
        read(folder, text, **options)
    return str(caught.value)


def words(angle_rad: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    """Return the 22-bit words that a 13-bit encoder sends for an angle."""
    return encode_positions(np.floor(angle_rad / TURN * 8192).astype(np.int64) % 8192)


def counts(angle_rad: npt.NDArray[Any], per_turn: int) -> npt.NDArray[np.int64]:
    return np.floor(angle_rad / TURN * per_turn).astype(np.int64) % per_turn


def test_readings_that_stand_off_alone_are_left_out_and_counted(tmp_path: Path) -> None:
    spiked = ANGLE_RAD.copy()
    spiked[[0, 50, 700, 1234, 1999]] = 9.9, 9.9, -4.0, 0.9, 5.0
    record = read(tmp_path, text_of(TIME_S, spiked), angle_unit="rad")

    assert len(record.time_s) == 1995
    assert off_by(record, np.delete(ANGLE_RAD, [0, 50, 700, 1234, 1999])) < 1e-6
    assert any("5 readings of 2000 off alone left out (first: line 2)." in one for one in record.notes)


@pytest.mark.parametrize("value", [9.9, 3.0, -2.0, np.pi, 200.0])
@pytest.mark.parametrize("in_row", [1, 2, 3])
def test_wrong_readings_about_half_a_turn_off_are_left_out_before_turns_are_counted(
    tmp_path: Path, value: float, in_row: int
) -> None:
    wrong = [place + one for place in range(150, 2000, 401) for one in range(in_row)]
    spiked = ANGLE_RAD.copy()
    spiked[wrong] = value
    record = read(tmp_path, text_of(TIME_S, spiked), angle_unit="rad")

    assert off_by(record, np.delete(ANGLE_RAD, wrong)) < 1e-6
    assert any(f"{len(wrong)} readings of 2000 off alone left out (first: line 152)." in one for one in record.notes)


@pytest.mark.parametrize("off_rad", [np.pi, 3.0, -0.6])
def test_stretches_that_jump_away_and_back_are_left_out_before_turns_are_counted(
    tmp_path: Path, off_rad: float
) -> None:
    wrong = np.concatenate([np.arange(begin, begin + 6) for begin in (150, 900, 1700)])
    displaced = ANGLE_RAD.copy()
    displaced[wrong] += off_rad
    record = read(tmp_path, text_of(TIME_S, displaced), angle_unit="rad")

    assert off_by(record, np.delete(ANGLE_RAD, wrong)) < 1e-6
    assert any(
        "18 readings of 2000 between a jump and one back left out (first: line 152)." in one for one in record.notes
    )


def test_wrong_readings_of_an_angle_over_many_turns_are_left_out_and_counted(tmp_path: Path) -> None:
    fallen = 40 * np.maximum(TIME_S - 0.2, 0) ** 2
    spiked, alone, moved = fallen.copy(), [0, 700, 1234, 1235], np.arange(1500, 1506)
    spiked[alone] = 7.7
    spiked[moved] += TURN
    record = read(tmp_path, text_of(TIME_S, spiked), angle_unit="rad")

    assert off_by(record, np.delete(fallen, [*alone, *moved])) < 1e-6
    assert any("4 readings of 2000 off alone left out (first: line 2)." in one for one in record.notes)
    assert any("6 readings of 1996 between a jump and one back left out" in one for one in record.notes)


def test_a_jump_that_nothing_takes_back_is_named_and_costs_no_readings(tmp_path: Path) -> None:
    slipped = ANGLE_RAD.copy()
    slipped[900:] += 1.8
    record = read(tmp_path, text_of(TIME_S, slipped), angle_unit="rad")

    assert len(record.time_s) == 2000
    assert any("jumps by more than a quarter of a turn in 1 of 2000" in one for one in record.notes)


def test_one_wrong_reading_does_not_hide_the_unit(tmp_path: Path) -> None:
    spiked = ANGLE_RAD.copy()
    spiked[700] = 44.0
    record = read(tmp_path, text_of(TIME_S, spiked))
    assert off_by(record, np.delete(ANGLE_RAD, 700)) < 1e-6


@pytest.mark.parametrize("options", [{}, {"rate_hz": 1000.0}])
def test_rows_that_are_newest_first_are_named_as_that_whether_a_rate_is_given_or_not(
    tmp_path: Path, options: dict[str, Any]
) -> None:
    message = refusal(tmp_path, text_of(TIME_S[::-1], ANGLE_RAD[::-1]), angle_unit="rad", **options)
    assert "time goes back from row to row, from 1.999 to 0 in column 't': the rows are newest first" in message
    assert message.endswith("Sort them by that column, smallest first.")


@pytest.mark.parametrize("wrong", [-5.0, 1e6, 0.0, -1.7e308])
def test_rows_with_single_wrong_times_are_left_out_and_counted(tmp_path: Path, wrong: float) -> None:
    times = TIME_S.copy()
    times[[700, 1500]] = wrong
    record = read(tmp_path, text_of(times, ANGLE_RAD), angle_unit="rad")

    assert record.time_s == pytest.approx(np.delete(TIME_S, [700, 1500]))
    assert off_by(record, np.delete(ANGLE_RAD, [700, 1500])) < 1e-6
    text = f"2 rows whose time is off that of the rows around (first: {wrong:.6g} in line 702) are left out."
    assert any(text in one for one in record.notes)


@pytest.mark.parametrize("rate_hz", [1000, 100, 25])
def test_a_swing_s_own_extremes_are_no_faults(tmp_path: Path, rate_hz: float) -> None:
    time_s = np.arange(0, 20, 1 / rate_hz)
    swung = np.where(time_s > 15, 1.2 * np.cos(14 * (time_s - 15)), 1.2)
    record = read(tmp_path, text_of(time_s, swung), angle_unit="rad")
    assert len(record.time_s) == len(time_s)


def off_by(record: AngleRecord, angle_rad: npt.NDArray[Any]) -> float:
    """Return the largest difference from an angle, without the whole turns by which the first samples differ."""
    difference = record.angle_rad - angle_rad
    return float(np.abs(difference - TURN * np.round(difference[0] / TURN)).max())


# Headers


HEADS = {
    "t,phi_rad": (1.0, 1.0),
    "T,Phi_RAD": (1.0, 1.0),
    "t [s],theta [rad]": (1.0, 1.0),
    "time_s,theta_rad": (1.0, 1.0),
    "time (ms),angle(deg)": (1e3, 180 / np.pi),
    "timestamp_us,position [deg]": (1e6, 180 / np.pi),
    "t[us],phi(rad)": (1e6, 1.0),
    "t [µs],phi [°]": (1e6, 180 / np.pi),
    "time/ms,angle/degrees": (1e3, 180 / np.pi),
    "when,t_s,speed,phi [radians]": (1.0, 1.0),
    "timestamp,theta1_rad": (1.0, 1.0),
    "time,pos [deg]": (1.0, 180 / np.pi),
    "timestamp,enc_rad": (1e3, 1.0),
    "timestamp,alpha_rad": (1e6, 1.0),
    '"t [s]","angle, deg"': (1.0, 180 / np.pi),
    "Zeit in s,Winkel in °": (1.0, 180 / np.pi),
    "Zeit [ms],Auslenkung [°]": (1e3, 180 / np.pi),
    "Time (s),Encoder Angle (rad)": (1.0, 1.0),
}


@pytest.mark.parametrize("head", HEADS)
def test_names_and_units_are_read_from_the_head(tmp_path: Path, head: str) -> None:
    time_scale, angle_scale = HEADS[head]
    before, middle = ("7,", ",5") if "speed" in head else ("", "")
    rows = zip(TIME_S * time_scale, ANGLE_RAD * angle_scale, strict=True)
    record = read(tmp_path, f"{head}\n" + "".join(f"{before}{t:.6f}{middle},{a:.9f}\n" for t, a in rows))
    assert record.time_s == pytest.approx(TIME_S, abs=1e-9)
    assert record.angle_rad == pytest.approx(ANGLE_RAD, abs=1e-8)
    guessed = f"time is read in {'us' if time_scale > 1e3 else 'ms'}, by its step of {time_scale / 1e3:g}"
    unnamed = head.startswith("timestamp,") and time_scale > 1
    assert record.notes == ((f"swing.csv: {guessed} (`time_unit`).",) if unnamed else ())


def test_rows_as_a_spreadsheet_in_europe_writes_them_are_read(tmp_path: Path) -> None:
    rows = "".join(f"{t:.3f};{np.degrees(a):.6f}\n" for t, a in zip(TIME_S, ANGLE_RAD, strict=True))
    text = "Pendulum 3; 21.11.\n# Fs = 1000\nZeit\n\ntime;theta1\ns;deg\n" + rows.replace(".", ",")
    record = read(tmp_path, text)
    assert record.time_s == pytest.approx(TIME_S, abs=1e-9)
    assert record.angle_rad == pytest.approx(ANGLE_RAD, abs=1e-7)
    assert texts(record.findings, "note")[0] == (
        f"swing.csv: 2000 rows 1 ms apart, angle from column 'theta1 [deg]', from {np.degrees(ANGLE_RAD.min()):.1f} to "
        f"{np.degrees(ANGLE_RAD.max()):.1f} degrees, below 3 lines that are no header, with decimal commas."
    )


def test_a_stretch_without_numbers_is_left_out_and_a_long_one_refused(tmp_path: Path) -> None:
    lines = text_of(TIME_S, ANGLE_RAD, "t,phi_rad").splitlines()
    lines[501:601] = [line.split(",")[0] + ",nan" for line in lines[501:601]]
    record = read(tmp_path, "\n".join([*lines, ""]))
    kept = np.r_[0:500, 600:2000]
    assert record.time_s == pytest.approx(TIME_S[kept], abs=1e-9)
    assert record.angle_rad == pytest.approx(ANGLE_RAD[kept], abs=1e-8)
    assert record.notes == ("swing.csv: 100 of 2000 rows lack a number (first: line 502) and are left out.",)
    lines[601:901] = [line.split(",")[0] + "," for line in lines[601:901]]
    assert "swing.csv:502: 'nan' in column 'phi_rad' is not a number" in refusal(tmp_path, "\n".join([*lines, ""]))


@pytest.mark.parametrize(
    ("head", "expected"),
    [
        ("t,psi", "no column of angle (phi, angle, theta) among t, psi: give `columns` TIME,ANGLE"),
        ("x,phi_rad", "no column of time (t, time) among x, phi_rad: give `columns` TIME,ANGLE, or `rate_hz`"),
        ("t [min],phi_rad", "no column of time"),
        ("t,phi [gon]", "no column of angle"),
        ("phi,phi", ": phi (1), phi (2). Give `columns`"),
        ("t,phi_rad,time", "more than one column of time (t, time): t (1), time (3). Give"),
    ],
)
def test_a_head_that_leaves_a_choice_is_asked_about(tmp_path: Path, head: str, expected: str) -> None:
    row = ",".join("1" for _ in head.split(","))
    assert expected in refusal(tmp_path, f"{head}\n" + f"{row}\n" * 20)


def test_columns_are_chosen_by_name_or_number_and_keep_the_unit_of_their_name(tmp_path: Path) -> None:
    rows = "".join(f"{1000 * t:.3f},{a:.9f},{2 * a:.9f}\n" for t, a in zip(TIME_S, ANGLE_RAD, strict=True))
    text = f"t [ms],phi_rad,phi_rad\n{rows}"
    record = read(tmp_path, text, columns=("1", "3"))
    assert record.time_s == pytest.approx(TIME_S, abs=1e-9)
    assert record.angle_rad == pytest.approx(2 * ANGLE_RAD, abs=1e-8)
    assert "columns 2, 3 are all named" in refusal(tmp_path, text, columns=("t [ms]", "phi_rad"))
    assert "no column '4'" in refusal(tmp_path, text, columns=("1", "4"))


@pytest.mark.parametrize("columns", [("t",), ("t", "phi", "x"), ("t", "t"), ("1", "t")])
def test_columns_that_are_no_pair_of_time_and_angle_are_a_usage_error(tmp_path: Path, columns: tuple[str, ...]) -> None:
    assert "`columns`" in refusal(tmp_path, text_of(TIME_S, words(ANGLE_RAD)), ConfigError, columns=columns)


@pytest.mark.parametrize(
    ("head", "options", "expected"),
    [
        ("t_ms,phi", {"time_unit": "us"}, "column 't_ms' is in ms, but `time_unit` is us"),
        ("t_ms,phi_rad", {"angle_unit": "deg"}, "column 'phi_rad' is in rad, but `angle_unit` is deg"),
    ],
)
def test_an_option_that_contradicts_the_head_is_a_usage_error(
    tmp_path: Path, head: str, options: dict[str, Any], expected: str
) -> None:
    assert expected in refusal(tmp_path, text_of(1e3 * TIME_S, ANGLE_RAD, head), ConfigError, **options)


# Files without times


def test_one_column_needs_a_rate_and_two_with_a_rate_need_a_choice(tmp_path: Path) -> None:
    column = "".join(f"{word}\n" for word in words(ANGLE_RAD))
    assert "one column and no time: give `rate_hz`" in refusal(tmp_path, column)
    record = read(tmp_path, column, rate_hz=1000.0)
    assert record.time_s == pytest.approx(TIME_S, abs=1e-12)
    assert off_by(record, ANGLE_RAD) < TURN / 8192 + 1e-9

    two = text_of(TIME_S, words(ANGLE_RAD), head="")
    assert "no header for its 2 columns: give `columns` ANGLE by number" in refusal(tmp_path, two, rate_hz=500.0)
    assert read(tmp_path, two, rate_hz=500.0, columns=("2",)).time_s == pytest.approx(2 * TIME_S, abs=1e-12)


def test_three_columns_without_a_head_need_a_choice(tmp_path: Path) -> None:
    text = "".join(f"{i},{t:.3f},{a:.9f}\n" for i, (t, a) in enumerate(zip(TIME_S, ANGLE_RAD, strict=True)))
    assert "no header for its 3 columns: give `columns` TIME,ANGLE by number" in refusal(tmp_path, text)
    record = read(tmp_path, text, columns=("2", "3"), angle_unit="rad")
    assert record.angle_rad == pytest.approx(ANGLE_RAD, abs=1e-8)


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rate_that_is_none_is_a_usage_error(tmp_path: Path, rate_hz: float) -> None:
    assert "`rate_hz`" in refusal(tmp_path, "phi\n" + "512\n" * 20, ConfigError, rate_hz=rate_hz)


def test_a_column_of_decimal_commas_is_never_read_as_two(tmp_path: Path) -> None:
    degrees = "".join(f"{a:.3f}\n".replace(".", ",") for a in np.degrees(ANGLE_RAD))
    assert "decimal points" in refusal(tmp_path, degrees, rate_hz=1000.0)
    seconds = "".join(f"{t:.3f}\n".replace(".", ",") for t in TIME_S)
    assert "s between samples" in refusal(tmp_path, seconds)
    assert "decimal commas" in refusal(tmp_path, "".join(seconds.splitlines(keepends=True)[:900]))


def test_decimal_commas_between_commas_are_refused_in_every_setting(tmp_path: Path) -> None:
    for head in ("t,phi\n", ""):
        for time_unit in ("s", "ms", "us"):
            rows = "".join(
                f"{t:.3f},{a:.3f}\n".replace(".", ",")
                for t, a in zip(1e3 * TIME_S, 100 * np.degrees(ANGLE_RAD), strict=True)
            )
            message = refusal(tmp_path, head + rows, time_unit=time_unit, counts_per_turn=4194304.0)
            assert "decimal points" in message


# Time


@pytest.mark.parametrize("start_s", [0.0, EPOCH_S])
@pytest.mark.parametrize(("unit", "scale"), [("s", 1.0), ("ms", 1e3), ("us", 1e6)])
@pytest.mark.parametrize("taken_for", ["s", "ms", "us"])
def test_time_in_a_wrong_unit_is_refused_and_the_right_one_proposed(
    tmp_path: Path, start_s: float, unit: str, scale: float, taken_for: str
) -> None:
    text = text_of((start_s + TIME_S) * scale, words(ANGLE_RAD))
    if taken_for == unit:
        assert read(tmp_path, text, time_unit=taken_for).time_s == pytest.approx(TIME_S, abs=1e-6)
        return
    message = refusal(tmp_path, text, time_unit=taken_for)
    assert f"Give `time_unit` {unit}." in message
    assert (f"a date (Unix time) in {unit}" in message) == (start_s > 0)


def test_time_of_a_slow_recording_in_a_finer_unit_is_doubted_and_with_a_date_refused(tmp_path: Path) -> None:
    slow_s = 0.03 * np.arange(200)
    text = text_of(slow_s, words(np.cos(slow_s)))
    assert read(tmp_path, text).notes == ("swing.csv: counts are read as `counts_per_turn` rls-13bit-in-22.",)
    assert "33333 Hz: is it not in s?" in read(tmp_path, text, time_unit="ms").notes[0]
    dated = text_of(EPOCH_S + slow_s, words(np.cos(slow_s)))
    assert "Give `time_unit` s." in refusal(tmp_path, dated, time_unit="ms")


def test_a_pause_does_not_make_the_unit_wrong(tmp_path: Path) -> None:
    paused_s = TIME_S + np.where(TIME_S > 1, 3600.0, 0.0)
    assert read(tmp_path, text_of(paused_s, words(ANGLE_RAD))).time_s[-1] == pytest.approx(3601.999)


@pytest.mark.parametrize("preface", [[], ["t,phi"], ["", "t,phi", ""], ["rig 7", "", "Monday", "", "t,phi"]])
@pytest.mark.parametrize("end", ["\n", "\n\n", "\r\n"])
def test_time_that_goes_back_is_refused_with_its_line(tmp_path: Path, preface: list[str], end: str) -> None:
    time_s = np.where(np.arange(2000) < 700, TIME_S, TIME_S - 0.5)
    lines = [*preface, *text_of(time_s, words(ANGLE_RAD), head="").splitlines()]
    text = end.join(lines) + end
    message = refusal(tmp_path, text, skip_lines=(len(preface) - 1) * len(end.strip("\r")) if "rig 7" in preface else 0)
    line = 1 + (len(preface) + 700) * end.count("\n")
    assert f"swing.csv:{line}: time goes back from 0.699 to 0.2 s" in message


def test_damaged_times_of_any_size_are_refused_in_a_short_sentence(tmp_path: Path) -> None:
    times = TIME_S.copy()
    times[[700, 702]] = -1.7e308
    times[[701, 703]] = 1.7e308
    message = refusal(tmp_path, text_of(times, words(ANGLE_RAD), time_format=".6g"))
    assert "swing.csv:702: time goes back from 0.699 to -1.7e+308 s" in message


def test_time_that_stands_still_is_refused(tmp_path: Path) -> None:
    text = text_of(EPOCH_S + TIME_S, words(ANGLE_RAD), time_format=".4g")
    assert "time stands still at 1764000000" in refusal(tmp_path, text)


def test_times_that_repeat_are_counted(tmp_path: Path) -> None:
    blocks_s = np.floor(TIME_S / 0.005) * 0.005
    record = read(tmp_path, text_of(blocks_s, words(ANGLE_RAD)))
    assert any("1600 of 2000 samples repeat the time of the previous one" in note for note in record.notes)


def test_a_time_beyond_all_numbers_is_refused(tmp_path: Path) -> None:
    time = 1.7e307 * np.arange(-10, 10)
    assert "between samples" in refusal(tmp_path, text_of(time, words(ANGLE_RAD[:20]), time_format=".17g"))


@pytest.mark.parametrize("rows", [1, 15])
def test_a_handful_of_rows_is_no_recording(tmp_path: Path, rows: int) -> None:
    message = refusal(tmp_path, text_of(TIME_S[:rows], words(ANGLE_RAD[:rows])))
    assert f"{'1 row' if rows == 1 else f'{rows} rows'}; a recording has at least 16" in message


# Angle


@pytest.mark.parametrize("start_rad", np.linspace(-TURN, TURN, 25))
@pytest.mark.parametrize("per_turn", [8192, 4194304, "words", "rad", "deg"])
def test_an_angle_is_continuous_wherever_its_turn_ends(tmp_path: Path, start_rad: float, per_turn: int | str) -> None:
    angle = ANGLE_RAD + start_rad
    folded = angle % TURN
    if per_turn == "words":
        record, step = read(tmp_path, text_of(TIME_S, words(angle))), TURN / 8192
    elif isinstance(per_turn, int):
        text = text_of(TIME_S, counts(angle, per_turn))
        record, step = read(tmp_path, text, counts_per_turn=float(per_turn)), TURN / per_turn
    else:
        text = text_of(TIME_S, np.round(folded if per_turn == "rad" else np.degrees(folded), 6))
        record, step = read(tmp_path, text, angle_unit=per_turn), 1e-6
    assert off_by(record, angle) < step + 1e-8
    assert record.path.name == "swing.csv"


def test_many_turns_are_counted_whether_the_counts_are_folded_or_not(tmp_path: Path) -> None:
    falling = 300 * TIME_S**2
    assert falling[-1] > 100 * TURN
    for text, per_turn in [
        (text_of(TIME_S, words(falling)), None),
        (text_of(TIME_S, counts(falling, 4194304)), 4194304.0),
        (text_of(TIME_S, np.floor(falling / TURN * 8192).astype(int)), 8192.0),
        (text_of(TIME_S, np.floor(-falling / TURN * 8192).astype(int)), 8192.0),
    ]:
        sign = -1 if text.splitlines()[-1].split(",")[1].startswith("-") else 1
        assert off_by(read(tmp_path, text, counts_per_turn=per_turn), sign * falling) < TURN / 8192 + 1e-8
    assert off_by(read(tmp_path, text_of(TIME_S, falling, "t,phi_rad")), falling) < 1e-9


def test_counts_that_were_never_folded_may_turn_faster_than_half_a_turn_a_sample(tmp_path: Path) -> None:
    slow_s, spinning = 0.02 * np.arange(200), 300 * 0.02 * np.arange(200)
    text = text_of(slow_s, np.floor(spinning / TURN * 8192).astype(int))
    record = read(tmp_path, text, counts_per_turn=8192.0)
    assert off_by(record, spinning) < TURN / 8192 + 1e-8
    assert record.notes == ()


def test_folded_counts_that_turn_too_fast_for_their_rate_are_refused(tmp_path: Path) -> None:
    slow_s = 0.02 * np.arange(200)
    message = refusal(tmp_path, text_of(slow_s, counts(300 * slow_s**2, 8192)), counts_per_turn=8192.0)
    assert "swing.csv:10: the angle jumps" in message
    assert "too fast for this rate. Whole turns cannot be counted" in message


@pytest.mark.parametrize("scaled_by", [4194047, 4194304])
def test_the_thesis_scaling_of_its_words_is_off_by_less_than_a_step(tmp_path: Path, scaled_by: int) -> None:
    text = text_of(TIME_S, words(ANGLE_RAD - 0.3))
    record = read(tmp_path, text, counts_per_turn=float(scaled_by))
    assert off_by(record, ANGLE_RAD - 0.3) < 2 * TURN / 8192
    own = read(tmp_path, text)
    assert np.abs(own.angle_rad - record.angle_rad - (own.angle_rad - record.angle_rad)[0]).max() < TURN / 8192


def test_words_are_told_from_plain_counts_and_the_guess_is_said(tmp_path: Path) -> None:
    plain = read(tmp_path, text_of(TIME_S, counts(ANGLE_RAD, 4194304)))
    assert plain.notes == ("swing.csv: counts are read as `counts_per_turn` 4194304.",)
    assert off_by(plain, ANGLE_RAD) < 2e-6
    own = read(tmp_path, text_of(TIME_S, words(ANGLE_RAD)))
    assert own.notes == ("swing.csv: counts are read as `counts_per_turn` rls-13bit-in-22.",)
    found = read(tmp_path, text_of(TIME_S, words(ANGLE_RAD)), counts_per_turn="rls-13bit-in-22")
    assert found.notes == ()


@pytest.mark.parametrize(
    "values",
    [
        counts(ANGLE_RAD, 8192),
        counts(ANGLE_RAD + 1, 65536),
        counts(ANGLE_RAD, 4194304) - 4194304,
        4194304 + counts(ANGLE_RAD, 4194304),
        np.round(np.degrees(ANGLE_RAD)).astype(int),
        np.round(np.degrees(ANGLE_RAD) + 90).astype(int),
    ],
    ids=["13 bits", "16 bits", "negative counts", "counts over the word", "whole degrees", "whole degrees above zero"],
)
def test_whole_numbers_that_leave_a_choice_are_asked_about(tmp_path: Path, values: npt.NDArray[np.int64]) -> None:
    message = refusal(tmp_path, text_of(TIME_S, values))
    assert f"counts range from {values.min()} to {values.max()}" in message
    assert "give `counts_per_turn` N, or `angle_unit`" in message


def test_words_read_with_another_count_of_a_turn_are_refused(tmp_path: Path) -> None:
    message = refusal(tmp_path, text_of(TIME_S, words(ANGLE_RAD)), counts_per_turn=8192.0)
    assert "give `counts_per_turn` rls-13bit-in-22" in message


@pytest.mark.parametrize(("unit", "scale"), [("rad", 1.0), ("deg", 180 / np.pi)])
def test_a_swing_shows_its_unit_by_its_range_and_that_is_said(tmp_path: Path, unit: str, scale: float) -> None:
    record = read(tmp_path, text_of(TIME_S, scale * ANGLE_RAD))
    assert record.angle_rad == pytest.approx(ANGLE_RAD, abs=1e-8)
    assert f"column 'phi' is read in {unit}, by its range of" in record.notes[0]


@pytest.mark.parametrize(
    "values",
    [20 * TIME_S, 10 * ANGLE_RAD, 0.5 * ANGLE_RAD],
    ids=["a spin", "a swing of 9 somethings", "a swing of 0.45 somethings"],
)
def test_a_range_that_may_be_of_either_unit_is_asked_about(tmp_path: Path, values: npt.NDArray[np.float64]) -> None:
    message = refusal(tmp_path, text_of(TIME_S, values))
    assert "may be radians or degrees: give `angle_unit` rad or deg" in message


@pytest.mark.parametrize(("head", "per_rad"), [("t,theta_rad", 1.0), ("t,theta [deg]", 57.3)])
def test_counts_per_turn_beside_an_angle_in_another_unit_are_named_as_not_used(
    tmp_path: Path, head: str, per_rad: float
) -> None:
    text = text_of(TIME_S, per_rad * ANGLE_RAD, head)
    (note,) = set(read(tmp_path, text, counts_per_turn=4096.0).notes) - set(read(tmp_path, text).notes)
    assert "`counts_per_turn` is not used: column 'theta" in note
    assert note.endswith(("is in rad.", "is in deg."))


@pytest.mark.parametrize("head", ["t,theta_rad", "t,theta"])
def test_a_rig_s_counts_per_turn_do_not_touch_an_angle_that_is_no_count(tmp_path: Path, head: str) -> None:
    text = text_of(TIME_S, 2 * ANGLE_RAD, head)
    found, expected = read(tmp_path, text, rig_counts_per_turn=4096.0), read(tmp_path, text)
    np.testing.assert_array_equal(found.angle_rad, expected.angle_rad)
    assert found.findings == expected.findings


def test_counts_are_those_of_the_rig_where_none_are_given_and_it_is_said(tmp_path: Path) -> None:
    text = text_of(TIME_S, np.rint(4096 / TURN * ANGLE_RAD), "t,enc")
    found = read(tmp_path, text, rig_counts_per_turn=4096.0)
    np.testing.assert_array_equal(found.angle_rad, read(tmp_path, text, counts_per_turn=4096.0).angle_rad)
    assert any(note.endswith("counts are read as rig.toml's `counts_per_turn` 4096.") for note in found.notes)


@pytest.mark.parametrize("head", ["", "Sequence,phi"])
@pytest.mark.parametrize("first", [0, 1])
def test_rows_that_are_counted_one_by_one_are_no_milliseconds_without_a_word(
    tmp_path: Path, head: str, first: int
) -> None:
    text, named = text_of(first + np.arange(2000), ANGLE_RAD, head, time_format="d"), {"columns": ("1", "2")}
    asked = refusal(tmp_path, text, ConfigError, angle_unit="rad", **named)
    assert "counts rows, or is a time in ms: give `rate_hz` (`columns`, where given, then without it)" in asked
    assert read(tmp_path, text, angle_unit="rad", time_unit="ms", **named).time_s[-1] == pytest.approx(1.999)
    counted = read(tmp_path, text, angle_unit="rad", rate_hz=500.0, columns=("2",))
    assert counted.time_s[-1] == pytest.approx(1999 / 500)


def test_an_angle_with_fractions_is_no_count(tmp_path: Path) -> None:
    text = text_of(TIME_S, ANGLE_RAD)
    for options in ({"counts_per_turn": 8192.0}, {"angle_unit": "counts"}):
        assert "has fractions: give `angle_unit` rad or deg" in refusal(tmp_path, text, **options)


@pytest.mark.parametrize("head", ["t,phi", "t,phi_rad"])
@pytest.mark.parametrize("value", ["1e300", "-1e300", "9007199254740993"])
def test_values_that_no_angle_has_are_left_out_and_named_and_many_are_refused(
    tmp_path: Path, head: str, value: str
) -> None:
    angle = words(ANGLE_RAD) if head == "t,phi" else ANGLE_RAD
    lines = text_of(TIME_S, angle, head).splitlines(keepends=True)
    whole = read(tmp_path, "".join(lines))
    lines[900] = f"0.899,{value}\n"
    record = read(tmp_path, "".join(lines))
    np.testing.assert_array_equal(record.angle_rad, np.delete(whole.angle_rad, 899))
    (note,) = [one.text for one in record.findings if "not an angle" in one.text]
    assert "1 row of " in note
    assert " in line 901) left out." in note

    many = [line if place % 5 else f"{line.split(',')[0]},{value}\n" for place, line in enumerate(lines)]
    assert "swing.csv:6:" in refusal(tmp_path, "".join([lines[0], *many[1:]]))


def spoilt(share: float, spoil: Callable[[int], int]) -> npt.NDArray[np.int64]:
    values = words(ANGLE_RAD)
    at = np.random.default_rng(5).choice(len(values), round(share * len(values)), replace=False)
    values[at] = [spoil(int(value)) for value in values[at]]
    return values


@pytest.mark.parametrize("setting", [None, "rls-13bit-in-22"])
@pytest.mark.parametrize(
    "spoil",
    [lambda word: word ^ 4, lambda word: word ^ 0x100, lambda word: word + 4194304, lambda word: -1 - word],
    ids=["a flipped bit", "the gap bit", "over the word", "negative"],
)
def test_a_few_words_that_fail_their_check_are_left_out_and_many_are_refused(
    tmp_path: Path, setting: str | None, spoil: Callable[[int], int]
) -> None:
    few = spoilt(0.005, spoil)
    record = read(tmp_path, text_of(TIME_S, few), counts_per_turn=setting)
    kept = few == words(ANGLE_RAD)
    line = int(np.flatnonzero(~kept)[0]) + 2
    assert record.time_s == pytest.approx(TIME_S[kept] - TIME_S[kept][0], abs=1e-12)
    assert off_by(record, ANGLE_RAD[kept]) < TURN / 8192 + 1e-9
    assert any(f"10 of 2000 samples fail the 13-bit check (first: line {line})" in note for note in record.notes)

    message = refusal(tmp_path, text_of(TIME_S, spoilt(0.05, spoil)), counts_per_turn=setting)
    assert "100 of 2000 samples fail the check" in message
    assert "`counts_per_turn`" in message


def test_plain_counts_that_jump_for_good_are_noted_and_many_that_jump_refused(tmp_path: Path) -> None:
    values = counts(ANGLE_RAD + 1.5, 4194304)
    values[1234:] ^= 1 << 21
    record = read(tmp_path, text_of(TIME_S, values))
    assert any(
        "jumps by more than a quarter of a turn in 1 of 2000 samples (first: line 1236)" in n for n in record.notes
    )
    noise = np.random.default_rng(0).integers(0, 4194304, len(TIME_S))
    message = refusal(tmp_path, text_of(TIME_S, noise))
    assert "Whole turns cannot be counted" in message


def test_a_wrong_number_far_off_does_not_make_folded_counts_look_unfolded(tmp_path: Path) -> None:
    values = counts(ANGLE_RAD, 8192)
    values[1500] = 15 * 8192 + 4096
    record = read(tmp_path, text_of(TIME_S, values), counts_per_turn=8192.0)
    assert "1 reading of 2000 off alone left out (first: line 1502)" in record.notes[0]
    others = np.delete(ANGLE_RAD, 1500)
    assert np.abs(np.exp(1j * record.angle_rad) - np.exp(1j * others)).max() < TURN / 8192 + 1e-9


@pytest.mark.parametrize("text", ["0", "-1", "nan", "inf", "many", ""])
def test_counts_per_turn_that_make_no_turn_are_a_usage_error(text: str) -> None:
    with pytest.raises(ConfigError, match="`counts_per_turn`"):
        counts_per_turn(text)


def test_counts_per_turn_are_a_number_or_the_name_of_a_word() -> None:
    assert counts_per_turn("4194304") == 4194304.0
    assert counts_per_turn("rls-13bit-in-22") == "rls-13bit-in-22"


# Paths that cannot be read


@pytest.mark.parametrize("name", ["nowhere.csv", "x" * 300, "file.csv/inside"])
def test_a_place_that_cannot_be_read_is_said(tmp_path: Path, name: str) -> None:
    (tmp_path / "file.csv").write_text("t,phi\n")
    with pytest.raises(DataError) as caught:
        read_angle(tmp_path / name, Reading())
    assert str(tmp_path / name) in str(caught.value)


def test_times_in_nanoseconds_since_1970_are_named_with_what_to_do(tmp_path: Path) -> None:
    stamps = (1_764_100_000_000_000_000 + np.rint(1e9 * TIME_S)).astype(np.int64)
    with pytest.raises(DataError, match=r"a date \(Unix time\) in ns; .* Divide the column by 1e9\."):
        read(tmp_path, "%time,angle_deg\n" + "\n".join(f"{t},{a:.5f}" for t, a in zip(stamps, ANGLE_RAD, strict=True)))


@pytest.mark.parametrize("name", ["time_min", "time [h]", "t_ns"])
def test_times_in_a_unit_that_is_not_read_are_refused_by_its_name(tmp_path: Path, name: str) -> None:
    path = tmp_path / "swing.csv"
    rows = "".join(f"{i / 60000:.7f},{np.sin(i / 50):.6f}\n" for i in range(2000))
    path.write_text(f"{name},angle_rad\n{rows}")

    with pytest.raises(ConfigError, match="times are read in s, ms or us"):
        read_angle(path, Reading(columns=(name, "angle_rad")))


@pytest.mark.parametrize("by_number", [False, True])
@pytest.mark.parametrize("unit", ["[gon]", "(mrad)", "_arcmin", ", turns"])
def test_an_angle_in_a_unit_that_is_not_read_is_refused_by_its_name(
    tmp_path: Path, unit: str, *, by_number: bool
) -> None:
    path = tmp_path / "swing.csv"
    name = f"swing{unit}"
    path.write_text(f"t_s;{name}\n" + "".join(f"{i / 100:.2f};{np.sin(i / 50):.6f}\n" for i in range(2000)))
    columns = ("1", "2") if by_number else ("t_s", name)
    with pytest.raises(ConfigError, match="angles are read in rad, deg or counts"):
        read_angle(path, Reading(columns=columns))
    assert read_angle(path, Reading(columns=columns, angle_unit="rad")).angle_rad[50] == pytest.approx(np.sin(1))


@pytest.mark.parametrize("name", ["sample", "Sample index", "n", "Row No."])
def test_a_counter_of_rows_that_is_named_as_the_time_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / "swing.csv"
    path.write_text(f"{name},angle_rad\n" + "".join(f"{i},{np.sin(i / 50):.6f}\n" for i in range(2000)))
    with pytest.raises(ConfigError, match="counts rows: give `rate_hz`"):
        read_angle(path, Reading(columns=("1", "2")))


def test_minus_signs_of_typesetters_are_minus_signs(tmp_path: Path) -> None:
    rows = "".join(f"{i / 100:.2f},{np.sin(i / 50):.6f}\n" for i in range(2000))
    plain = read(tmp_path, f"t_s,angle_rad\n{rows}")
    set_in_type = read(tmp_path, f"t_s,angle_rad\n{rows}".replace("-", "\u2212"))
    np.testing.assert_array_equal(set_in_type.angle_rad, plain.angle_rad)


def test_a_gap_in_a_bare_file_is_named_with_its_line(tmp_path: Path) -> None:
    lines = text_of(TIME_S, ANGLE_RAD, "t,phi_rad").splitlines()
    record = read(tmp_path, "\n".join([*lines[:501], *lines[801:], ""]))
    assert record.notes == (
        "swing.csv: 1 gap without rows, the longest of 0.301 s after line 501 (0.499 s); rows are usually 1 ms apart.",
    )


@pytest.mark.parametrize("name", ["θ [rad]", "φ_rad", "ϑ(rad)", "α, rad"])
def test_greek_names_of_an_angle_are_known(tmp_path: Path, name: str) -> None:
    between = ";" if "," in name else ","
    record = read(tmp_path, text_of(TIME_S, ANGLE_RAD, "t,NAME").replace(",", between).replace("NAME", name))
    assert record.angle_rad == pytest.approx(ANGLE_RAD, abs=1e-8)


def test_a_rate_beside_a_column_of_times_is_noted_and_beside_its_unit_refused(tmp_path: Path) -> None:
    text = "t,phi_rad\n" + "".join(f"{at / 100},{0.3 * (at % 3):.1f}\n" for at in range(40))
    record = read(tmp_path, text, rate_hz=50.0)
    assert record.time_s[-1] == pytest.approx(39 / 50)
    assert any("times are those of `rate_hz` 50: column 't' is not used." in one.text for one in record.findings)
    assert "`time_unit`" in refusal(tmp_path, text, ConfigError, rate_hz=50.0, time_unit="s")


def test_quoted_numbers_with_decimal_commas_are_read(tmp_path: Path) -> None:
    rows = (f'"{t:.3f}","{x:.6f}"'.replace(".", ",") for t, x in zip(TIME_S, ANGLE_RAD, strict=True))
    record = read(tmp_path, "\n".join(['"t","phi_rad"', *rows, ""]), time_unit="s")
    assert len(record.time_s) == len(TIME_S)
    assert off_by(record, ANGLE_RAD) < 1e-6


def test_slow_rows_whose_times_have_fractions_and_no_unit_are_asked_for(tmp_path: Path) -> None:
    text = text_of(1730.06 * TIME_S, ANGLE_RAD, head="t,phi_rad")  # rows are 1.73 apart
    assert "names no unit, and rows that are 1.73 apart may be slow ones in s, or in ms: give `time_unit`" in refusal(
        tmp_path, text, ConfigError
    )
    assert len(read(tmp_path, text, time_unit="ms").time_s) == len(TIME_S)


@pytest.mark.parametrize("name", ["Time since start (s)", "tout", "elapsed_s", "Elapsed time [s]"])
def test_times_that_other_programs_call_otherwise_are_times(tmp_path: Path, name: str) -> None:
    rows = "".join(f"{i / 100:.2f},{np.sin(i / 50):.6f}\n" for i in range(2000))
    record = read(tmp_path, f"{name},angle_rad\n{rows}")
    assert record.time_s[-1] == pytest.approx(19.99)
