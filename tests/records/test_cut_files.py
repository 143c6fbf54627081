"""A file that was cut at any byte gives its complete rows or an error message, and never a truncated number."""

from pathlib import Path

import pytest

from cfid.errors import DataError
from cfid.records.tables.blocks import open_table

ROWS = [[round(1e9 + 0.001 * i, 6), 4194047 - 512 * 40 * i] for i in range(20)]
SHORT = ROWS[:5]
SPELLINGS = {
    "LF": "t,phi\n" + "".join(f"{t:.6f},{phi}\n" for t, phi in SHORT),
    "CRLF": "t,phi\r\n" + "".join(f"{t:.6f},{phi}\r\n" for t, phi in SHORT),
    "CR": "t;phi\r" + "".join(f"{t:.6f};{phi}\r" for t, phi in SHORT),
    "quotes": '"t","phi"\n' + "".join(f'"{t:.6f}","{phi}"\n' for t, phi in SHORT),
    "another column": "phi,t,x\n" + "".join(f"{phi},{t:.6f},17\n" for t, phi in SHORT),
    "spaces": "  t phi \n" + "".join(f"{t:.6f} {phi:9d}  \n" for t, phi in SHORT),
    "blank lines": "\nt,phi\n\n" + "".join(f"{t:.6f},{phi}\n\n" for t, phi in SHORT),
}


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_a_table_cut_at_any_byte_is_its_first_rows_or_is_refused(tmp_path: Path, spelling: str) -> None:
    path, content = tmp_path / "cut.csv", SPELLINGS[spelling].encode()
    for length in range(len(content) + 1):
        path.write_bytes(content[:length])
        lines = content[:length].replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        rows = max(sum(bool(line.strip()) for line in lines[:-1]) - 1, 0)  # one line is the header
        if rows == 0:
            with pytest.raises(DataError, match=r"empty|no end|no rows"):
                open_table(path)
            continue
        table = open_table(path)
        assert table.numbers(["t", "phi"]).tolist() == SHORT[:rows]
        assert table.cut == bool(lines[-1].strip())


def test_a_table_without_a_head_is_cut_like_any_other(tmp_path: Path) -> None:
    path, content = tmp_path / "cut.csv", "".join(f"{t:.6f},{phi}\n" for t, phi in SHORT).encode()
    for length in range(content.index(b"\n") + 1, len(content) + 1):
        path.write_bytes(content[:length])
        assert open_table(path).numbers(["1", "2"]).tolist() == SHORT[: content.count(b"\n", 0, length)]


def test_zero_bytes_where_the_last_rows_should_be_are_a_cut(tmp_path: Path) -> None:
    path, content = tmp_path / "cut.csv", SPELLINGS["LF"].encode()
    path.write_bytes(content[:90] + bytes(len(content)))
    table = open_table(path)
    assert table.cut
    assert table.numbers(["t", "phi"]).tolist() == SHORT[: content.count(b"\n", 0, 90) - 1]
