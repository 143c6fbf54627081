"""Rows as written by serial monitors of boards, LabVIEW and R give the numbers of a plain table."""

from pathlib import Path

import numpy as np
import pytest

from cfid.errors import DataError
from cfid.records.logs.any_kind import read_log
from cfid.records.tables.angle import AngleRecord, Reading, read_angle
from cfid.records.tables.blocks import BLOCK_BYTES, open_table
from cfid.records.tables.stand import read_stand_table

ROWS = 400
TIME_MS = 5 * np.arange(ROWS)
ANGLE_DEG = np.round(40 * np.cos(TIME_MS / 150), 2)
BOTH = list(zip(TIME_MS, ANGLE_DEG, strict=True))
PLAIN = [f"{t},{a:.2f}" for t, a in BOTH]


def read(folder: Path, lines: list[str], reading: Reading | None = None) -> AngleRecord:
    (folder / "swing.txt").write_text("\n".join([*lines, ""]))
    return read_angle(folder / "swing.txt", reading or Reading(angle_unit="deg"))


def same(record: AngleRecord, rows: slice = slice(None)) -> bool:
    time_s = TIME_MS[rows] / 1000
    return len(record.time_s) == len(time_s) and bool(
        np.allclose(record.time_s, time_s - time_s[0], rtol=0, atol=1e-12)
        and np.allclose(np.degrees(record.angle_rad), ANGLE_DEG[rows], rtol=0, atol=1e-9)
    )


def stamped(lines: list[str]) -> list[str]:
    return [f"12:03:{45 + at // 200:02d}.{5 * (at % 200):03d} -> {line}" for at, line in enumerate(lines)]


@pytest.mark.parametrize("head", [[], ["millis,angle"], ["Ready", "millis,angle"]])
def test_the_times_of_day_of_a_serial_monitor_are_left_out_with_a_note(tmp_path: Path, head: list[str]) -> None:
    record = read(tmp_path, stamped([*head, *PLAIN]))
    assert same(record)
    assert any("times of day" in one.text for one in record.findings)


@pytest.mark.parametrize("between", [",", "\t", ", "])
def test_the_names_before_the_values_of_a_serial_plotter_are_refused_with_what_to_write(
    tmp_path: Path, between: str
) -> None:
    with pytest.raises(DataError, match=r"line 2 reads 'angle:.*write the numbers alone, below a header"):
        read(tmp_path, [f"angle:{a:.2f}{between}millis:{t}" for t, a in BOTH])


LABVIEW = [
    "LabVIEW Measurement\t", "Writer_Version\t2", "Separator\tTab", "Decimal_Separator\t,", "X_Columns\tNo",
    "***End_of_Header***\t", "\t", "Channels\t1\t", "X_Dimension\tTime\t", "X0\t0,0\t", "Delta_X\t0,005000\t",
    "***End_of_Header***\t", "X_Value\tAngle\tComment",
]  # fmt: skip


def labview(rows: int, head: list[str] = LABVIEW) -> list[str]:
    values = ANGLE_DEG[np.arange(rows) % ROWS]
    return [*head, *("\t" + f"{value:.2f}".replace(".", ",") for value in values)]


def test_times_that_labview_left_out_are_those_of_the_step_in_its_head_with_a_note(tmp_path: Path) -> None:
    record = read(tmp_path, labview(ROWS))
    assert same(record)
    assert any("times are assumed to be 0.005 s apart, as Delta_X" in one.text for one in record.findings)
    other = read(tmp_path, labview(ROWS), Reading(rate_hz=100.0, angle_unit="deg"))
    np.testing.assert_allclose(np.diff(other.time_s), 0.01, rtol=1e-9)


def test_the_step_of_times_has_a_decimal_comma_also_above_whole_numbers(tmp_path: Path) -> None:
    record = read(tmp_path, [*LABVIEW, *(f"\t{value:.0f}" for value in ANGLE_DEG)])
    np.testing.assert_allclose(record.time_s, TIME_MS / 1000, atol=1e-12)


def test_times_that_labview_left_out_go_on_over_the_blocks_of_a_long_file(tmp_path: Path) -> None:
    lines = labview(300_000)
    (tmp_path / "long.lvm").write_text("\n".join([*lines, ""]))
    assert (tmp_path / "long.lvm").stat().st_size > 2 * BLOCK_BYTES
    times = open_table(tmp_path / "long.lvm").numbers(["X_Value"])[:, 0]
    np.testing.assert_allclose(times, 0.005 * np.arange(300_000), rtol=1e-12)


@pytest.mark.parametrize("line", ["X_Dimension\tFrequency\t", "Delta_X\t0,005\t0,01\t", "Delta_X\t-1\t"])
def test_without_one_step_of_times_a_column_that_labview_left_empty_is_refused(tmp_path: Path, line: str) -> None:
    key = line.partition("\t")[0]
    head = [line if one.startswith(key) else one for one in LABVIEW]
    with pytest.raises(DataError, match="column 'X_Value' is empty"):
        read(tmp_path, labview(ROWS, head))


@pytest.mark.parametrize("between", [",", "\t", " "])
def test_the_names_that_r_writes_before_rows_shift_no_column(tmp_path: Path, between: str) -> None:
    head = between.join(['"time"', '"angle"'])
    rows = [
        f'"{at}"{between}{t / 1000}{between}{a}' for at, (t, a) in enumerate(zip(TIME_MS, ANGLE_DEG, strict=True), 1)
    ]
    record = read(tmp_path, [head, *rows])
    assert same(record)
    assert any("the names before the rows, as R writes them, are not used" in one.text for one in record.findings)


def test_the_names_that_r_writes_before_rows_with_decimal_commas_shift_no_column(tmp_path: Path) -> None:
    rows = (f'"{at}";{t / 1000:.3f};{a:.2f}'.replace(".", ",") for at, (t, a) in enumerate(BOTH, 1))
    record = read(tmp_path, ['"time";"angle"', *rows])
    assert same(record)
    assert any("the names before the rows, as R writes them, are not used" in one.text for one in record.findings)


def test_numbers_before_rows_are_names_where_no_comma_may_be_a_decimal_one(tmp_path: Path) -> None:
    rows = [f"{at}\t{t / 1000}\t{a}" for at, (t, a) in enumerate(BOTH, 1)]
    assert same(read(tmp_path, ["time\tangle", *rows]))
    with pytest.raises(DataError, match=r"3 fields where the file has 2 columns\. Does each row begin with a name"):
        read(tmp_path, ["time,angle", *(row.replace("\t", ",") for row in rows)])
    with pytest.raises(DataError, match=r"3 fields where the file has 2 columns\. Numbers need decimal points"):
        read(tmp_path, ["time,angle", *(f"{at},{at},5" for at in range(1, ROWS))])


WRAPPED_US = (1000 * TIME_MS + 2**32 - 700_000) % 2**32


@pytest.mark.parametrize("signed", [False, True])
def test_a_clock_of_32_bits_goes_on_where_it_begins_anew(tmp_path: Path, signed: bool) -> None:
    stamps = (WRAPPED_US + 2**31).astype(np.uint32).view(np.int32) if signed else WRAPPED_US
    record = read(tmp_path, ["micros,angle", *(f"{t},{a}" for t, a in zip(stamps, ANGLE_DEG, strict=True))])
    assert same(record)
    assert any("the clock of 32 bits begins anew in line 142" in one.text for one in record.findings)
    (series,) = read_log(tmp_path / "swing.txt").series
    times = np.concatenate([block[:, 0] for block in series.blocks()])
    np.testing.assert_allclose(times - times[0], TIME_MS / 1000, atol=1e-6)


def test_a_clock_of_32_bits_may_begin_anew_within_lost_rows(tmp_path: Path) -> None:
    kept = np.r_[0:130, 250:ROWS]
    rows = [f"{WRAPPED_US[at]},{ANGLE_DEG[at]}" for at in kept]
    record = read(tmp_path, ["micros,angle", *rows])
    np.testing.assert_allclose(record.time_s, TIME_MS[kept] / 1000, atol=1e-9)
    text = next(one.text for one in record.findings if "the clock of 32 bits begins anew in line 132" in one.text)
    assert "times go on from there, over as many as 121 usual intervals: rows were lost" in text


def test_a_single_time_of_all_32_bits_is_wrong_and_no_clock_that_begins_anew(tmp_path: Path) -> None:
    stamps = 1000 * TIME_MS
    stamps[100] = 2**32 - 1
    record = read(tmp_path, ["micros,angle", *(f"{t},{a}" for t, a in zip(stamps, ANGLE_DEG, strict=True))])
    np.testing.assert_allclose(record.time_s, np.delete(TIME_MS, 100) / 1000, atol=1e-9)


def test_a_clock_of_16_bits_in_milliseconds_goes_on_each_time_it_begins_anew(tmp_path: Path) -> None:
    times_ms = 50 * np.arange(3000)
    angles = np.round(40 * np.cos(times_ms / 500), 2)
    stamps = (times_ms + 60_000) % 2**16
    record = read(tmp_path, ["t_ms,angle", *(f"{t},{a}" for t, a in zip(stamps, angles, strict=True))])
    np.testing.assert_allclose(record.time_s, times_ms / 1000, atol=1e-9)
    assert any("the clock of 16 bits begins anew in line 113, from 65500 to 14" in one.text for one in record.findings)


def test_a_time_in_milliseconds_that_begins_anew_elsewhere_is_no_clock_of_16_bits(tmp_path: Path) -> None:
    stamps = [*range(60_000, 64_000, 10), *range(0, 4000, 10)]
    with pytest.raises(DataError, match=r"swing\.txt:402: time goes back from 63990 to 0 ms"):
        read(tmp_path, ["t_ms,angle", *(f"{t},{t % 80}" for t in stamps)])


def test_a_time_that_goes_back_by_less_than_32_bits_is_refused(tmp_path: Path) -> None:
    stamps = np.where(WRAPPED_US < 2**31, WRAPPED_US, WRAPPED_US - 10_000_000)
    with pytest.raises(DataError, match=r"swing\.txt:142: time goes back"):
        read(tmp_path, ["micros,angle", *(f"{t},{a}" for t, a in zip(stamps, ANGLE_DEG, strict=True))])


def test_a_stand_whose_clock_of_32_bits_begins_anew_is_one_recording(tmp_path: Path) -> None:
    commands = 10_000 * (1 + np.arange(ROWS) // 100)
    rows = (f"{t},{command},{command / 1e5}" for t, command in zip(WRAPPED_US, commands, strict=True))
    (tmp_path / "stand.csv").write_text("\n".join(["micros,cmd,thrust_n", *rows, ""]))
    table = read_stand_table(tmp_path / "stand.csv")
    np.testing.assert_allclose(np.asarray(table.time_s), TIME_MS / 1000, atol=1e-9)
    assert any("the clock of 32 bits begins anew" in one.text for one in table.findings)
