"""Find where the rows of a CSV file begin, what separates their fields, and what its header calls them."""

import re
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from cfid.errors import DataError
from cfid.records.tables.text import TextLine, fields_of, filled_lines, has_comma, is_number, separator_of, short

POINTS = "Numbers need decimal points, and no comma inside."
COMMENT = r"[ \t]*(?:#|%|//)"

_LABVIEW_END, _LABVIEW_COMMENT = "***End_of_Header***", "Comment"
_MOST_LINES = 60  # within which the rows have to begin
_LONGEST_NAME, _MOST_COLUMNS = 200, 10_000  # of a table
_UNITS = re.compile(
    r"s|secs?|seconds|radians|volts|newtons|ms|[uµμ]s|hz|rad|deg|°|degrees|counts?|(?:rad|deg|°|m)/s(?:\^?2|²)?|pwm|rpm|n|k?gf?|n[·*.]?m|m?v|a|w|m?m|%|-",
    re.IGNORECASE,
)


class Head(NamedTuple):
    """Names of the columns ('1', '2', ... without a header), the separator, the first row, the lines left out above.

    `row_names` is whether rows begin with a name of their own for which the header has no field, as R writes them.
    """

    names: tuple[str, ...]
    has_head: bool
    separator: str | None
    row: TextLine
    preamble: int = 0
    row_names: bool = False


def head_of(path: Path, text: bytes, *, skip_lines: int = 0) -> Head:
    """Return a table's head, which may stand below lines of prose or comments, and above a line of units.

    Raises DataError where no row of numbers follows.
    """
    lines = list(islice(filled_lines(text, skip=skip_lines), _MOST_LINES))
    if not lines:
        count = text.count(b"\n")
        raise DataError(f"{path}: nothing in its {count} lines beyond the {skip_lines} that `skip_lines` leaves out.")
    ends = [at + 1 for at, line in enumerate(lines) if line.text.startswith(_LABVIEW_END)]
    above = ends[-1] if ends and ends[-1] < len(lines) else 0
    lines = lines[above:]
    heads = (_head_at(lines, place) for place in range(len(lines)))
    head = next((head for head in heads if head is not None), None) or _of_first_line(path, lines)
    _refuse_word_alone(path, lines, head)
    if len(head.names) > _MOST_COLUMNS or max(map(len, head.names)) > _LONGEST_NAME:
        raise DataError(
            f"{path}: {len(head.names)} columns, the longest name of {max(map(len, head.names))} characters: not a "
            f"table's header (at most {_MOST_COLUMNS} columns and {_LONGEST_NAME} characters). It can be left out with "
            "`skip_lines`."
        )
    return head._replace(preamble=above + head.preamble)


def _refuse_word_alone(path: Path, lines: Sequence[TextLine], head: Head) -> None:
    """Raise DataError where the apparent header is a single word below a header as wide as the rows."""
    if (
        not head.has_head
        or not 0 < head.preamble < len(lines)
        or sum(map(bool, head.names)) != 1
        or len(head.names) < 2
    ):
        return
    above = fields_of(lines[head.preamble - 1].text, head.separator)
    if len(above) == len(head.names) and all(above) and not _numbers(above):
        line = lines[head.preamble]
        raise DataError(
            f"{path}:{line.number}: '{short(line.text.strip())}' stands alone between the header and its rows. Write "
            "it into every row that it is of, in a column of its own."
        )


def _head_at(lines: Sequence[TextLine], place: int) -> Head | None:
    """Return the head that begins at a line, if two rows of its width follow."""
    line, below = lines[place], [one for one in lines[place + 1 :] if not _is_comment(one)]
    separator = separator_of(line.text)
    names = _names(line, separator)
    if _numbers(names):
        return _without_names(lines, place, below, separator)
    if _are_rows(below[:2], separator, len(names)):
        return Head(_fitted(names, fields_of(below[0].text, separator)), True, separator, below[0], place)
    if _have_names(below[:2], separator, len(names)):
        return Head(("", *names), True, separator, below[0], place, row_names=True)
    if not _are_rows(below[1:3], separator, len(names)):
        return None
    units = fields_of(below[0].text, separator)
    units = [unit.strip("[]()") for unit in units]
    if len(units) != len(names) or not all(_UNITS.fullmatch(unit) for unit in units if unit):
        return None
    named = [f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)]
    return Head(_fitted(named, fields_of(below[1].text, separator)), True, separator, below[1], place)


def _without_names(
    lines: Sequence[TextLine], place: int, below: Sequence[TextLine], separator: str | None
) -> Head | None:
    """Return the head of rows that have none, unless a line above may be their header or a damaged row."""
    fields = fields_of(lines[place].text, separator)
    width = len(fields)
    above = [fields_of(line.text, separator) for line in lines[:place]]
    damaged = any(len(one) == width and (_numbers(one[:1]) or _numbers(one) > 1) for one in above)
    damaged |= bool(above) and not _numbers(above[-1]) and len(above[-1]) > 1
    whole = _numbers(fields) == len([field for field in fields if field])
    if damaged or not whole or _is_comment(lines[place]) or not _are_rows([lines[place], *below[:1]], separator, width):
        return None
    return Head(_numbered(fields), False, separator, lines[place], place)


def _of_first_line(path: Path, lines: Sequence[TextLine]) -> Head:
    """Return the head of a file whose first line is its header or its first row."""
    first, separator = lines[0], separator_of(lines[0].text)
    names = _names(first, separator)
    has_head = _is_head(path, first, names)
    if has_head and len(lines) == 1:
        raise DataError(f"{path}: a header and no rows; nothing was recorded.")
    row = lines[1] if has_head else first
    fields = fields_of(row.text, separator)
    if not _numbers(fields):
        named = "Names before values are not read: write the numbers alone, below a header. " if ":" in row.text else ""
        raise DataError(
            f"{path}: not a CSV file of numbers: line {row.number} reads '{short(row.text.strip())}'. {named}"
            "A longer header can be left out with `skip_lines`."
        )
    return Head(_fitted(names, fields) if has_head else _numbered(fields), has_head, separator, row)


def _is_head(path: Path, line: TextLine, fields: Sequence[str]) -> bool:
    """Return whether a line is a header, not a row.

    Raises DataError for a line that is neither: a damaged first row must not pass as a header.
    """
    if not _numbers(fields):
        return True
    if sum(is_number(field) for field in fields) == len(fields) - (not fields[-1]):
        return False
    text = short(line.text.strip())
    raise DataError(
        f"{path}:{line.number}: '{text}' is neither a header nor a row of numbers: leave it out with `skip_lines`, or "
        f"repair it. {POINTS}"
    )


def _names(line: TextLine, separator: str | None) -> list[str]:
    return fields_of(re.sub(rf"^{COMMENT}+\s*", "", line.text), separator)


def _is_comment(line: TextLine) -> bool:
    return re.match(COMMENT, line.text) is not None


def _numbers(fields: Sequence[str]) -> int:
    """Return how many fields are numbers, with a decimal point or a comma."""
    return sum(is_number(field) or has_comma(field) for field in fields)


def _are_rows(lines: Sequence[TextLine], separator: str | None, width: int) -> bool:
    """Return whether two lines are rows of a table of that width; one separator at the end adds no column.

    A single number next to words is a setting of the program that wrote the file, as in `Horizontal Scale,1`.
    """
    rows = [fields_of(line.text, separator) for line in lines]
    if len(rows) < 2 or len(rows[0]) != len(rows[1]) or abs(len(rows[0]) - width) > 1:
        return False
    filled = [len([field for field in row if field]) for row in rows]
    if any(_numbers(row) < min(2, count) for row, count in zip(rows, filled, strict=True)):
        return False
    return all(_numbers(row) and (len(row) <= width or not row[-1]) for row in rows)


def _have_names(lines: Sequence[TextLine], separator: str | None, width: int) -> bool:
    """Return whether two lines are rows of a table of that width, each after a name: in quotes, or counted from 1.

    Between commas, a number without quotes may be the first half of one with a decimal comma.
    """
    rows = [fields_of(line.text, separator) for line in lines]
    if len(rows) < 2 or any(len(row) != width + 1 or _numbers(row[1:]) < width for row in rows):
        return False
    quoted = all(line.text.lstrip().startswith('"') for line in lines)
    return quoted or (separator != "," and [row[0] for row in rows] == ["1", "2"])


def _numbered(row: list[str]) -> tuple[str, ...]:
    """Return the columns' numbers; a separator at the end of the row adds no column."""
    return tuple(str(i + 1) if field or i + 1 < len(row) else "" for i, field in enumerate(row))


def _fitted(names: list[str], row: list[str]) -> tuple[str, ...]:
    """Return the columns' names, where a separator at the end of every row, or of the header alone, is ignored.

    So is LabVIEW's column of comments, which its rows do not have.
    """
    if len(row) == len(names) + 1 and not row[-1]:
        return (*names, "")
    if len(names) == len(row) + 1 and names[-1] in ("", _LABVIEW_COMMENT):
        return tuple(names[:-1])
    return tuple(names)
