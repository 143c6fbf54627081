"""A device's file that was cut at any byte gives its complete rows or an error, and never a truncated number."""

from pathlib import Path

import numpy as np
import pytest

from cfid.errors import DataError
from cfid.recordings.table import read_table

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
