"""Read a table of any size, one block of whole lines after the other."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from cfid.errors import DataError
from cfid.records.files import check_regular
from cfid.records.tables.matlab import is_matlab
from cfid.records.tables.table import CsvTable, open_table, table_in
from cfid.records.tables.text import check_text

BLOCK_BYTES = 1 << 20


def table_blocks(path: Path, *, sha256: str, skip_lines: int = 0, columns: Sequence[str] = ()) -> Iterator[CsvTable]:
    """Yield the blocks of a CSV file as tables, of which the last may have no row; `sha256` is that of the file.

    A MATLAB file is one block. Raises DataError as `open_table`, in the block where the fault is.
    """
    if is_matlab(path):
        yield open_table(path, columns=columns)
        return
    try:
        check_regular(path)
        with path.open("rb") as file:
            content = file.read(BLOCK_BYTES) + file.readline()
            check_text(path, content)
            table = table_in(path, content, sha256=sha256, skip_lines=skip_lines)
            yield table
            while content := file.read(BLOCK_BYTES) + file.readline():
                table = table.continued(content)
                yield table
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.") from None
