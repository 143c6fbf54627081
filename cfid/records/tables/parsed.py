"""Parse columns of numbers in rows that have as many fields as the table has columns."""

import csv
import io
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd  # half of the start-up time of a fit, and not needed to refuse a bad file

from cfid.records.tables.text import NUMBER

Array = npt.NDArray[np.float64]

_NUMBERS = (np.dtype(np.int64), np.dtype(np.float64))
_TRUTHS = (b"rue", b"RUE", b"alse", b"ALSE")
_WHOLE = r"[+-]?\d{16,300}"  # fewer digits are exact; more are not a number


class Spelling(NamedTuple):
    """How fields are written: what is between them, None for any run of spaces and tabs, and the decimal sign."""

    separator: str | None
    decimal: str


def columns_in(rows: bytes, places: list[int], spelling: Spelling) -> Array | None:
    """Return columns (rows, columns) by their places, None where one holds anything but numbers.

    Whole numbers are parsed faster as integers.
    """
    try:
        frame = _frame(rows, places, spelling)
        if any(kind not in _NUMBERS for kind in frame.dtypes):  # too large for integers, or not numbers
            frame = _frame(rows, places, spelling, np.float64)
        values: Array = frame.to_numpy(np.float64)
    except (ValueError, OverflowError):
        return None
    return values


def known_columns_in(rows: bytes, places: list[int], spelling: Spelling) -> Array:
    """Return columns (rows, columns) by their places, parsed field by field, nan where one is not a number; slow."""
    fields = _frame(rows, places, spelling, str)
    spelt = fields.apply(lambda column: column.str.strip().str.replace(spelling.decimal, "."))
    known = spelt.apply(lambda column: column.str.fullmatch(NUMBER))
    values: Array = spelt.where(known).astype(np.float64).to_numpy()
    return values


def words_in(rows: bytes, place: int, spelling: Spelling) -> list[str]:
    """Return a column by its place, as it is written."""
    if not rows:
        return []
    fields = _frame(rows, [place], spelling, str).iloc[:, 0].str.strip()
    return [field.encode("latin-1").decode(errors="replace") for field in fields]


def is_exact_in(rows: bytes, place: int, spelling: Spelling) -> bool:
    """Return whether all whole numbers of a column, as they are written, are exact as 64-bit floats."""
    fields = _frame(rows, [place], spelling, str).iloc[:, 0].str.strip()
    return all(int(field) == int(float(field)) for field in fields[fields.str.fullmatch(_WHOLE)])


def holds_truths(rows: bytes) -> bool:
    """Return whether `true` or `false` may be among the fields: pandas reads a column of `true` as ones."""
    return any(word[-1:] in rows and word in rows for word in _TRUTHS)  # one letter is searched for much faster


def _frame(rows: bytes, places: list[int], spelling: Spelling, kind: type | None = None) -> pd.DataFrame:
    frame = pd.read_csv(
        io.BytesIO(rows),
        sep=spelling.separator or r"\s+",
        header=None,
        usecols=sorted(set(places)),
        dtype=kind,
        skipinitialspace=b" " in rows or b"\t" in rows,  # looking for spaces takes a third of the time
        quoting=csv.QUOTE_NONE,
        na_filter=False,
        decimal=spelling.decimal,
        encoding="latin-1",
    )
    return frame if places == list(frame) else frame[places]
