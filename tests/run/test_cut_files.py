"""A file that was cut at any byte gives its whole rows or a sentence, and never a number that was cut."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from cfid.errors import DataError
from cfid.recording import Reading, read_angle
from cfid.table import open_table

ROWS = [[round(1e9 + 0.001 * i, 6), 4194047 - 512 * (i % 9) * i] for i in range(40)]
WORDS = Reading(counts_per_turn=4194304.0)
SPELLINGS = {
    "LF": "t,phi\n" + "".join(f"{t:.6f},{phi}\n" for t, phi in ROWS),
    "CRLF": "t,phi\r\n" + "".join(f"{t:.6f},{phi}\r\n" for t, phi in ROWS),
    "CR": "t;phi\r" + "".join(f"{t:.6f};{phi}\r" for t, phi in ROWS),
    "no head": "".join(f"{t:.6f} {phi}\n" for t, phi in ROWS),
    "quotes": '"t","phi"\n' + "".join(f'"{t:.6f}","{phi}"\n' for t, phi in ROWS),
    "a column that is not read": "phi,t,x\n" + "".join(f"{phi},{t:.6f},17\n" for t, phi in ROWS),
}


def cut_everywhere(path: Path, content: bytes) -> Iterator[int]:
    for length in range(len(content) + 1):
        path.write_bytes(content[:length])
        yield length


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_a_table_cut_at_any_byte_is_its_first_rows_or_is_refused(tmp_path: Path, spelling: str) -> None:
    path, content = tmp_path / "cut.csv", SPELLINGS[spelling].encode()
    columns = ["1", "2"] if spelling == "no head" else ["t", "phi"]
    read, refused = set(), 0
    for length in cut_everywhere(path, content):
        try:
            table = open_table(path)
            rows = table.numbers(columns).tolist()
        except DataError:
            refused += 1
            continue
        assert rows == ROWS[: len(rows)]
        ends_whole = content[:length].endswith((b"\n", b"\r"))
        assert table.cut == (not ends_whole)
        assert len(rows) == len(content[:length].split()) - (columns == ["t", "phi"]) - table.cut or columns == [
            "1",
            "2",
        ]
        read.add(len(rows))
    assert read == set(range(1, len(ROWS) + 1))
    assert refused < 60


def test_a_recording_cut_at_any_byte_says_that_its_last_line_was_cut(tmp_path: Path) -> None:
    path, content = tmp_path / "cut.csv", SPELLINGS["LF"].encode()
    whole = len(ROWS)
    for length in cut_everywhere(path, content):
        try:
            record = read_angle(path, WORDS)
        except DataError as error:
            assert length < 400, error
            continue
        count = len(record.time_s)
        assert count == content[:length].count(b"\n") - 1
        assert any("the last line was cut" in note for note in record.notes) == (content[length - 1] != ord("\n"))
        whole = min(whole, count)
    assert whole == 16


def test_zero_bytes_where_the_last_rows_should_be_are_a_cut(tmp_path: Path) -> None:
    path, content = tmp_path / "cut.csv", SPELLINGS["LF"].encode()
    path.write_bytes(content[:500] + bytes(len(content) - 500))
    table = open_table(path)
    assert table.cut
    assert table.numbers(["t", "phi"]).tolist() == ROWS[: content[:500].count(b"\n") - 1]
