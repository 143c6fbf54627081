"""An index and crossings from other sources: names, units in brackets, and decimal commas."""

from pathlib import Path

import numpy as np
import pytest

from cfid.errors import DataError
from cfid.records.tables.crossings import read_crossings
from cfid.records.tables.index import read_index

COLUMNS = ("command", "angle_deg", "wind_min_mps", "loadcell")


def written(folder: Path, text: str) -> Path:
    (folder / "table.csv").write_text(text, encoding="utf-8")
    return folder / "table.csv"


def test_names_of_an_index_may_be_spelt_otherwise(tmp_path: Path) -> None:
    path = written(tmp_path, "Command;Angle [°];wind min (m/s);LoadCell file\n20000;-12,5;0,75;a, b.csv\n")
    (row,) = read_index(path, columns=COLUMNS).rows
    assert [row.number(name) for name in COLUMNS[:3]] == [20000, -12.5, 0.75]
    assert row.file("loadcell") == tmp_path / "a, b.csv"

    (sine,) = read_index(written(tmp_path, "periods,Samples\n4,4000\n"), columns=("l", "n")).rows
    assert (sine.whole("l", 0, 9), sine.whole("n", 0, 9999)) == (4, 4000)


@pytest.mark.parametrize("field", ["20,000", "1,2,3", "5,a"])
def test_a_comma_that_may_be_of_thousands_is_never_a_decimal_one(tmp_path: Path, field: str) -> None:
    (row,) = read_index(written(tmp_path, f"l;n\n{field};1\n"), columns=("l", "n")).rows
    with pytest.raises(DataError, match=f"'{field}' in column 'l' is not a number"):
        row.number("l")


def test_three_digits_behind_a_comma_are_decimal_where_other_fields_show_it_and_asked_about_where_not(
    tmp_path: Path,
) -> None:
    text = "l;n;a\n1,200;0,000;23966,1\n"
    (row,) = read_index(written(tmp_path, text), columns=("l", "n", "a")).rows
    assert [row.number(name) for name in "lna"] == [1.2, 0, 23966.1]

    for others in ("1", "23966.1"):
        (row,) = read_index(written(tmp_path, text.replace("0,000;23966,1", f"1;{others}")), columns=("l", "n")).rows
        with pytest.raises(DataError, match=r"'1,200' in column 'l' is not a number\. Its comma may mark thousands: "):
            row.number("l")


def test_two_spellings_of_one_column_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="more than one column l in its header"):
        read_index(written(tmp_path, "l,periods\n1,2\n"), columns=("l",))


@pytest.mark.parametrize(
    ("head", "row"),
    [
        ("t,thrust_rec,sample,vehicle_us", "{0},{1},{2},{3:.0f}"),
        ("Time (ms);Command;sample index;vehicle_ms", "{4};{1};{2};{5}"),
        ("timestamp_us pwm sample_number device_time_us", "{3:.0f} {1} {2} {3:.0f}"),
    ],
)
def test_crossings_of_others_are_read_by_their_names_and_units(tmp_path: Path, head: str, row: str) -> None:
    time_s, command, sample = 10 + 0.25 * np.arange(9), 30000 + np.arange(9), 125 * np.arange(9)
    rows = [row.format(t, c, n, 1e6 * t, 1e3 * t, 1e3 * t) for t, c, n in zip(time_s, command, sample, strict=True)]
    text = "\n".join([head, *rows, ""])
    found = read_crossings(written(tmp_path, text.replace(".", ",") if ";" in head else text))
    np.testing.assert_allclose(found.host_s, time_s)
    np.testing.assert_array_equal(found.command, command)
    np.testing.assert_array_equal(found.sample, sample)
    assert found.vehicle_us is not None
    np.testing.assert_allclose(found.vehicle_us, 1e6 * time_s)


@pytest.mark.parametrize(
    ("row", "note"),
    [
        ("11.0,30004\n11.0,30004\n", "1 report that repeats the one before is left out (first: 30004 in line 7)."),
        ("10.9,1e300\n11.0,30004\n", "1 report whose command is not 0 to 65535 is left out (first: 1e+300 in line 6)."),
    ],
)
def test_a_report_that_stands_twice_or_that_no_vehicle_makes_is_left_out_and_named(
    tmp_path: Path, row: str, note: str
) -> None:
    rows = "".join(f"{10 + 0.25 * at},{30000 + at}\n" for at in range(9))
    found = read_crossings(written(tmp_path, f"t,command\n{rows}".replace("11.0,30004\n", row)))
    np.testing.assert_array_equal(found.command, 30000 + np.arange(9))
    assert [one.sentence for one in found.findings] == [note]
