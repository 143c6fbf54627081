"""A table is read as it is written: its heads, its numbers, its lines, and nothing is guessed."""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from cfid.errors import ConfigError, DataError
from cfid.recordings.recording import How
from cfid.recordings.table import Table, read_table
from cfid.recordings.times import series_of

Written = Callable[[str | bytes], Path]


@pytest.fixture
def written(tmp_path: Path) -> Written:
    def write(content: str | bytes) -> Path:
        path = tmp_path / "table.csv"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def codes(table: Table) -> list[str]:
    return [finding.code for finding in table.findings]


@pytest.mark.parametrize(
    "text",
    [
        "t_s,phi_deg\n0,1\n1,2\n",
        "t_s;phi_deg\r\n0;1\r\n1;2\r\n",
        "t_s,phi_deg\n0,1,,\n1,2,, \n# a comment, after more fields\n",
        "\ufefft_s\tphi_deg\n0\t1\n1\t2\n",
        "# measured by hand\n# t_s phi_deg\n0  1\n1  2\n",
        "A report\nof 2 lines\nt_s,phi_deg,\n0,1,\n1,2,\n",
        '"t_s", "phi_deg"\n\n"0","1"\n"1","2"\n',
    ],
)
def test_a_table_has_the_columns_of_its_last_line_above_the_rows(written: Written, text: str) -> None:
    table = read_table(written(text))

    assert [(column.name, column.unit) for column in table.columns] == [("t", "s"), ("phi", "deg")]
    assert np.array_equal(table.columns[1].values, [1, 2])
    assert table.source.sha256 == sha256(text.encode()).hexdigest()
    assert codes(table) == []


def test_a_table_without_a_head_names_its_columns_by_number(written: Written) -> None:
    table = read_table(written("0 5\n1 6\n"), How(columns=("phi=2",), units={"phi": "deg"}))

    assert [(column.name, column.unit) for column in table.columns] == [("1", ""), ("phi", "deg")]


@pytest.mark.parametrize("text", ["t;phi\n0,5;1,5\n1,5;2\n", '"t","phi"\n"0,5","1,5"\n"1,5",2\n', "0,5 1,5\n1,5 2\n"])
def test_a_decimal_comma_is_an_option(written: Written, text: str) -> None:
    columns = read_table(written(text), How(decimal=",")).columns

    assert np.array_equal([column.values for column in columns], [[0.5, 1.5], [1.5, 2]])


def test_a_last_line_without_its_end_is_a_row_where_it_is_whole(written: Written) -> None:
    whole, cut = read_table(written("a,b\n1,2\n65000,106")), read_table(written("a,b\n1,2\n3"))

    assert whole.columns[1].values[-1] == 106
    assert codes(whole) == ["last-line-unended"]
    assert cut.rows == 1
    assert codes(cut) == ["last-line-cut"]


def test_a_field_that_is_no_number_is_missing_and_a_line_of_words_left_out(written: Written) -> None:
    lines = [f"{row},{row}" for row in range(300)]
    lines[100], lines[200] = "100,off", "the end of a part"
    table = read_table(written("\n".join(["a,b", *lines, ""])))

    assert table.rows == 299
    assert np.flatnonzero(np.isnan(table.columns[1].values)).tolist() == [100]
    assert codes(table) == ["lines-left-out"]
    assert [table.line_of_row(row) for row in (0, 199, 200)] == [2, 201, 203]


def test_a_table_in_which_many_lines_have_too_many_fields_is_refused_by_its_line(written: Written) -> None:
    with pytest.raises(DataError, match=r"table\.csv:4") as error:
        read_table(written("a,b\n1,2\n3,4\n5,6,7\n" + "1,2,3\n" * 20))
    assert error.value.code == "damaged-lines"


def test_a_column_that_is_filled_late_keeps_its_numbers_in_a_large_file(
    written: Written, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cfid.recordings.table.BLOCK_BYTES", 1 << 14)
    rows = 4096
    text = "t_s,late\n" + "".join(f"{row},\n" for row in range(rows)) + "".join(f"{rows + row},7\n" for row in range(9))
    table = read_table(written(text))

    assert table.rows == rows + 9
    assert np.count_nonzero(table.columns[1].values == 7) == 9
    assert table.line_of_row(rows) == rows + 2


@pytest.mark.parametrize(
    "content",
    [b'{"t": [0, 1]}', b"PK\x03\x04abc", b"a,b\n1,\0\n", b"", b"only words\n", b"a,b\r1,2\r3,4\r", b"t;phi\n0,5;1,5\n"],
)
def test_another_kind_of_file_is_refused_with_a_sentence(written: Written, content: bytes) -> None:
    with pytest.raises(DataError):
        read_table(written(content))


TIMES = [("t_ms", 10.0), ("time [us]", 1e4), ("timestamp (ns)", 1e7), ("millis", 10.0), ("t", 0.01), ("t_s", 0.125)]


@pytest.mark.parametrize(("head", "step"), TIMES)
def test_times_are_in_seconds_by_their_head(written: Written, head: str, step: float) -> None:
    path = written(f"{head},a\n" + "".join(f"{5 * step + row * step:.9g},1\n" for row in range(20)))
    series = series_of(read_table(path), How())

    seconds = 0.125 if head == "t_s" else 0.01
    assert series.time_s is not None
    assert np.allclose(series.time_s, seconds * np.arange(20), rtol=1e-12)
    assert series.begin_s == pytest.approx(5 * seconds)


def test_times_without_a_unit_that_are_not_seconds_ask_for_it(written: Written) -> None:
    path = written("t,a\n" + "".join(f"{10 * row},1\n" for row in range(20)))

    with pytest.raises(ConfigError, match="t=ms") as error:
        series_of(read_table(path), How())
    assert error.value.code == "no-unit"
    how = How(units={"t": "ms"})
    time_s = series_of(read_table(path, how), how).time_s
    assert time_s is not None
    assert time_s[-1] == 0.19


def test_times_that_go_back_are_refused_by_their_line_or_sorted(written: Written) -> None:
    path = written("t_s,a\n0,0\n0.02,2\n0.01,1\n0.03,3\n")

    with pytest.raises(DataError, match=r"table\.csv:4") as error:
        series_of(read_table(path), How())
    assert error.value.code == "time-goes-back"
    series = series_of(read_table(path), How(), sort=True)
    assert np.array_equal(series.column("a").values, [0, 1, 2, 3])
    assert [finding.code for finding in series.findings] == ["time-sorted"]
    assert series.line_of_row is not None
    assert series.line_of_row(1) == 4


def test_a_rate_replaces_all_columns_of_times(written: Written) -> None:
    path = written("t,timestamp,a\n0,5,1\n1,6,2\n")

    with pytest.raises(ConfigError, match="several columns of time: t, timestamp"):
        series_of(read_table(path), How())
    series = series_of(read_table(path), How(rate_hz=4))
    assert series.names == ("a",)
    assert series.frame()["t"].tolist() == [0, 0.25]
    assert [finding.code for finding in series.findings] == ["time-replaced"]


@pytest.mark.parametrize("time", ["2026-11-21", "12:30:05", "2026-11-21 12:30:05"])
def test_dates_and_times_of_day_are_refused(written: Written, time: str) -> None:
    with pytest.raises(DataError, match="times of day") as error:
        series_of(read_table(written(f"time,a\n{time},1\n{time},2\n")), How())
    assert error.value.code == "no-number"


def test_a_gap_is_found_by_its_line(written: Written) -> None:
    times = [0.01 * row + (row >= 50) for row in range(100)]
    series = series_of(read_table(written("t_s,a\n" + "".join(f"{time:.2f},1\n" for time in times))), How())

    assert [finding.code for finding in series.findings] == ["time-gaps"]
    assert "line 51" in series.findings[0].sentence


def test_a_column_is_taken_in_its_unit_or_asks_for_one(written: Written) -> None:
    path = written("t_s,Fz,Thrust (gf)\n0,1,100\n0.1,2,200\n")
    series = series_of(read_table(path), How())

    assert series.si("Thrust", "N")[1] == pytest.approx(1.96133)
    with pytest.raises(ConfigError, match="Fz=N") as error:
        series.si("Fz", "N")
    assert error.value.code == "no-unit"
    with pytest.raises(DataError) as other:
        series.si("Thrust", "V")
    assert other.value.code == "other-unit"


# Files that were cut


ROWS = [[round(1e9 + 0.001 * i, 6), 4194047 - 512 * 40 * i] for i in range(5)]
SPELLINGS = {
    "LF": "t,phi\n" + "".join(f"{t:.6f},{phi}\n" for t, phi in ROWS),
    "CRLF": "t,phi\r\n" + "".join(f"{t:.6f},{phi}\r\n" for t, phi in ROWS),
    "quotes": '"t","phi"\n' + "".join(f'"{t:.6f}","{phi}"\n' for t, phi in ROWS),
    "spaces": "  t phi \n" + "".join(f"{t:.6f} {phi:9d}  \n" for t, phi in ROWS),
}


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_a_file_of_a_run_cut_at_any_byte_is_its_first_rows_or_is_refused(tmp_path: Path, spelling: str) -> None:
    path, content = tmp_path / "cut.csv", SPELLINGS[spelling].encode()
    for length in range(len(content) + 1):
        path.write_bytes(content[:length])
        rows = max(content[:length].count(b"\n") - 1, 0)
        if rows == 0:
            with pytest.raises(DataError):
                read_table(path, of_run=True)
            continue
        table = read_table(path, of_run=True)
        assert np.column_stack([column.values for column in table.columns]).tolist() == ROWS[:rows]
        is_cut = bool(content[:length].rpartition(b"\n")[2].strip())
        assert ("last-line-cut" in [one.code for one in table.findings]) is is_cut


def test_a_last_line_of_another_program_is_used_where_it_is_whole_and_named(tmp_path: Path) -> None:
    path, content = tmp_path / "cut.csv", SPELLINGS["LF"]
    path.write_text(content[:-1])
    table = read_table(path)
    assert table.rows == len(ROWS)
    assert [one.code for one in table.findings] == ["last-line-unended"]
