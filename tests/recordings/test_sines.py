"""An index, and crossings from other sources: names, units, and what is left out or refused."""

from pathlib import Path

import numpy as np
import pytest

from cfid.errors import CfidError, DataError
from cfid.recordings.sines import read_crossings, read_index


def written(folder: Path, text: str) -> Path:
    (folder / "table.csv").write_text(text, encoding="utf-8")
    return folder / "table.csv"


@pytest.mark.parametrize("field", ["20,000", "1,5", "5a", "nan", ""])
def test_a_field_that_is_no_number_is_refused_with_its_line(tmp_path: Path, field: str) -> None:
    (row,) = read_index(written(tmp_path, f"l;n\n{field};1\n"), columns=("l", "n")).rows
    with pytest.raises(DataError, match=rf"table\.csv:2: '{field}' in column 'l' is not a number"):
        row.number("l")


@pytest.mark.parametrize("text", ["l,l\n1,2\n", "l\n", "", "n\n1\n", "l,n\n1\n"])
def test_an_index_without_its_columns_or_its_rows_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(DataError, match=r"table\.csv"):
        read_index(written(tmp_path, text), columns=("l",), optional=("n",))


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
    found = read_crossings(written(tmp_path, "\n".join([head, *rows, ""])))
    np.testing.assert_allclose(found.host_s, time_s)
    np.testing.assert_array_equal(found.command, command)
    np.testing.assert_array_equal(found.sample, sample)
    assert found.vehicle_us is not None
    np.testing.assert_allclose(found.vehicle_us, 1e6 * time_s)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("1,1\n0,2\n3,3\n", "time-goes-back"),
        ("0,1\n250000,2\n500000,3\n", "no-unit"),
        ("1,1\n2,1e300\n3,3\n", "impossible-command"),
    ],
)
def test_crossings_that_cannot_be_are_refused(tmp_path: Path, text: str, code: str) -> None:
    with pytest.raises(CfidError) as caught:
        read_crossings(written(tmp_path, f"t,command\n{text}"))
    assert caught.value.code == code
