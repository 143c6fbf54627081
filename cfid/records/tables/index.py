"""Read an index: a CSV file with a row per run, for facts that the runs' own files do not contain."""

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from cfid.counted import counted
from cfid.errors import DataError
from cfid.findings import Finding, of_recording
from cfid.records.parameters import Source
from cfid.records.tables.text import (
    fields_of,
    filled_lines,
    has_comma,
    has_decimal_comma,
    is_finite,
    read_text,
    separator_of,
    whole_lines,
)

_SPELT = {"periods": "l", "samples": "n"} | {
    spelt: name for name in ("loadcell", "crossings") for spelt in (f"{name}_file", f"{name}_csv")
}


@dataclass(frozen=True, kw_only=True)
class IndexRow:
    """One row: its fields by column, its file and its line, and whether the file's numbers have decimal commas."""

    path: Path
    line: int
    fields: Mapping[str, str]
    decimal_commas: bool = False

    def number(self, column: str) -> float:
        """Return a finite number. Raises DataError with file and line."""
        text = self.fields[column]
        decimal = has_decimal_comma(text) or (self.decimal_commas and text.count(",") == 1)
        number = text.replace(",", ".") if decimal else text
        if not is_finite(number):
            advice = " Its comma may mark thousands: write a decimal point, or no comma." if has_comma(text) else ""
            raise self.fault(f"'{text}' in column '{column}' is not a number.{advice}")
        return float(number)

    def whole(self, column: str, least: int, most: int) -> int:
        """Return a whole number within bounds. Raises DataError with file and line."""
        value = self.number(column)
        if not (value.is_integer() and least <= value <= most):
            raise self.fault(f"{column} is {value:g}: it should be a whole number from {least} to {most}.")
        return int(value)

    def file(self, column: str) -> Path:
        """Return a path, relative to the index. Raises DataError where there is none."""
        if not self.fields[column]:
            raise self.fault(f"column '{column}' is empty.")
        return self.path.parent / self.fields[column]

    def fault(self, what: str) -> DataError:
        """Return an error that names the file and the line."""
        return DataError(f"{self.path}:{self.line}: {what}")


class Index(NamedTuple):
    """The rows of an index, its file, and findings about it."""

    rows: list[IndexRow]
    source: Source
    findings: tuple[Finding, ...]


def read_index(path: Path, *, columns: Sequence[str], optional: Sequence[str] = ()) -> Index:
    """Read an index with the named columns, in any order. Raises DataError with file, line and next step.

    Case, spaces and brackets of their names do not matter: `Angle [deg]` is `angle_deg`, `wind min (m/s)` is
    `wind_min_mps`. Numbers may have decimal commas between semicolons or tabs. A comma before
    three digits is a decimal comma where other fields show decimal commas, and none a decimal point.
    """
    content = read_text(path)
    lines = filled_lines(whole_lines(content.rstrip() + b"\n")[0])
    head = next(lines)
    separator = separator_of(head.text)
    wanted_names = {*columns, *optional}
    names = [key if (key := _key(name)) in wanted_names else name for name in fields_of(head.text, separator)]
    repeated = [name for name in dict.fromkeys(names) if name in wanted_names and names.count(name) > 1]
    if repeated:
        raise DataError(f"{path}: more than one column {', '.join(repeated)} in its header: leave one.")
    missing = [name for name in columns if name not in names]
    if missing:
        wanted = ",".join(columns) + "".join(f"[,{name}]" for name in optional)
        raise DataError(
            f"{path}: no column {', '.join(missing)} among {', '.join(names)}: its header should be {wanted}."
        )
    each: list[tuple[int, list[str]]] = []
    for line in lines:
        fields = fields_of(line.text, separator)
        if len(fields) != len(names):
            raise DataError(f"{path}:{line.number}: {counted(len(fields), 'field')} where its header has {len(names)}.")
        each.append((line.number, fields))
    every = [field for _, fields in each for field in fields]
    commas = any(map(has_decimal_comma, every)) and not any("." in field and is_finite(field) for field in every)
    rows = [
        IndexRow(path=path, line=line, fields=dict(zip(names, fields, strict=True)), decimal_commas=commas)
        for line, fields in each
    ]
    if not rows:
        raise DataError(f"{path}: a header and no rows: it names no run.")
    unused = [name for name in names if name not in {*columns, *optional}]
    known = f"it may have {', '.join(optional)}"
    notes = (f"not used: column {', '.join(unused)}; {known}.",) if unused else ()
    return Index(rows, Source(str(path), hashlib.sha256(content).hexdigest()), of_recording(path.name, notes))


def _key(name: str) -> str:
    """Return a column's name as cfid spells it."""
    key = re.sub(r"[\s_()\[\]-]+", "_", name.strip().lower().replace("m/s", "mps").replace("°", "deg")).strip("_")
    return _SPELT.get(key, key)
