"""Explain why a line of a file is not a row of its table, and what to do about it."""

import re
from collections.abc import Sequence

from cfid.counted import counted
from cfid.records.tables.head import POINTS
from cfid.records.tables.parsed import Spelling
from cfid.records.tables.text import fields_of, has_comma, is_finite, short

REPAIR = "Repair or cut that line."
_ROW_NAMES = "Does each row begin with a name or number of its own? Give that a name in the header, too."
NO_THOUSANDS = "Write thousands without a sign or a space between digits."
# Thousands separated by a point, a comma, an apostrophe or a space of any width.
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:[.,'\u2019\s]\d{3})+(?:[.,]\d*)?")
_CLOCK_TIME = re.compile(r"\d:\d\d|\d{4}-\d\d-\d\d")


def fault_of(line: str, names: Sequence[str], places: Sequence[int], spelling: Spelling) -> str | None:
    """Return a sentence on a line with too many or too few fields, or without a number at a place; None for neither."""
    if "\0" in line:
        return f"zero bytes in the middle of the file. {REPAIR}"
    fields = fields_of(line, spelling.separator)
    if len(fields) != len(names):
        commas = spelling.separator == "," and len(fields) > len(names)
        advice = (_ROW_NAMES if any("." in field for field in fields) else POINTS) if commas else REPAIR
        return f"{counted(len(fields), 'field')} where the file has {counted(len(names), 'column')}. {advice}"
    for place in places:
        field, column = fields[place], f"column '{names[place]}'"
        if not field:
            return f"{column} is empty. {REPAIR}"
        if not is_finite(field.replace(spelling.decimal, ".")):
            return f"'{short(field)}' in {column} is not a number. {_advice(field)}"
    return None


def _advice(field: str) -> str:
    if _CLOCK_TIME.search(field):
        return (
            "Dates and times of day are not read: write seconds, or give `rate_hz` where rows are evenly spaced "
            "(`columns`, where given, then without this one)."
        )
    if _THOUSANDS.fullmatch(field):
        return NO_THOUSANDS
    if field.endswith("%"):
        return "Write per cent without the sign."
    return POINTS if has_comma(field) else REPAIR
