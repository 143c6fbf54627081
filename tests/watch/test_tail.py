"""Rows of a file that grows: each whole row once, whatever happens to the file."""

from pathlib import Path

import numpy as np

from cfid.watch.tail import CHUNK_BYTES, Tail


def test_rows_come_once_as_they_are_appended_and_a_cut_line_waits_for_its_end(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    tail = Tail(path, 2)
    assert tail.rows().shape == (0, 2)  # before the file exists
    with path.open("ab", buffering=0) as file:
        file.write(b"t,a\n1.5,2\n2.5,")
        assert tail.rows().tolist() == [[1.5, 2.0]]
        assert tail.rows().shape == (0, 2)
        assert tail.behind_bytes == len(b"2.5,")
        file.write(b"33\n3.5,4\n")
        assert tail.rows().tolist() == [[2.5, 33.0], [3.5, 4.0]]
    assert tail.behind_bytes == 0


def test_a_long_file_is_read_in_chunks_that_miss_no_row(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    count = 3 * CHUNK_BYTES // 12
    path.write_text("t,a\n" + "".join(f"{i}.25,{i}\n" for i in range(count)))
    tail, parts = Tail(path, 2), []
    while len(rows := tail.rows()):
        parts.append(rows)
    assert len(parts) > 1
    assert np.array_equal(np.concatenate(parts)[:, 1], np.arange(count))


def test_lines_that_are_no_rows_are_counted_and_do_not_end_the_reading(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("t,a\n1,two\n")
    tail = Tail(path, 2)
    assert len(tail.rows()) == 0
    assert tail.unreadable == len("1,two\n")
    with path.open("a") as file:
        file.write("2,3\n")
    assert tail.rows().tolist() == [[2.0, 3.0]]


def test_a_missing_value_keeps_its_row(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("t,a,b\n1,,2\n")
    assert np.array_equal(Tail(path, 3).rows(), [[1.0, np.nan, 2.0]], equal_nan=True)


def test_a_file_that_becomes_a_folder_or_vanishes_gives_no_rows(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("t\n1\n")
    tail = Tail(path, 1)
    assert len(tail.rows()) == 1
    path.unlink()
    assert len(tail.rows()) == 0
    path.mkdir()
    assert len(tail.rows()) == 0
