"""Recognise forms of rows that only certain programs write, and turn them into plain rows.

Arduino's serial monitor writes a time of day before each line; LabVIEW leaves its column of times empty and states
their step.
"""

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

from cfid.records.tables.head import Head
from cfid.records.tables.text import decoded, fields_of, filled_lines, is_finite

_STAMP = re.compile(rb"(?m)^\d\d:\d\d:\d\d\.\d{3} -> ?")
_LOOKED_AT = 60  # lines
_STEP = re.compile(r"(?m)^Delta_X[\t;,](?P<steps>.*)$")
_ALONG_TIME = re.compile(r"(?m)^X_Dimension[\t;,]Time\b")


@dataclass(frozen=True)
class Form:
    """How rows are written: after times of day, or without times whose step is known."""

    stamped: bool = False
    step_s: float | None = None
    notes: tuple[str, ...] = ()

    def plain(self, text: bytes) -> bytes:
        """Return whole lines without times of day."""
        return _STAMP.sub(b"", text) if self.stamped else text

    def completed(self, above: bytes, head: Head) -> "Form":
        """Return the form with what a table's head and the lines above its rows show: the step of its times."""
        if head.row_names:
            return replace(self, notes=(*self.notes, "the names before the rows, as R writes them, are not used."))
        step_s = _labview_step_s(above, head)
        if step_s is None:
            return self
        text = f"column 'X_Value' is empty: times are assumed to be {step_s:g} s apart, as Delta_X states (`rate_hz`)."
        return replace(self, step_s=step_s, notes=(*self.notes, text))

    def timed(self, body: bytes, separator: str | None, decimal: str, *, row: int) -> bytes:
        """Return lines with the rows' times in first fields that are empty; `row` is the number of the first row."""
        if self.step_s is None or separator is None:
            return body
        step_s, rows = self.step_s, itertools.count(row)
        begin = re.compile(rb"(?m)^(?=" + re.escape(separator.encode()) + rb")")
        return begin.sub(lambda _: f"{next(rows) * step_s:.12g}".replace(".", decimal).encode(), body)


def form_of(text: bytes) -> Form:
    """Return the form of a text's rows, by its first lines."""
    lines = [line.text for line in itertools.islice(filled_lines(text), _LOOKED_AT)]
    if sum(_STAMP.match(line.encode()) is not None for line in lines) <= len(lines) / 2:
        return Form()
    return Form(stamped=True, notes=("the times of day that a serial monitor wrote before its lines are left out.",))


def _labview_step_s(above: bytes, head: Head) -> float | None:
    """Return the step of times that LabVIEW's head states where the column of times is empty; None otherwise.

    Channels with different steps have no common step.
    """
    if head.names[:1] != ("X_Value",) or fields_of(head.row.text, head.separator)[:1] != [""]:
        return None
    stated = decoded(above)
    if not _ALONG_TIME.search(stated):
        return None
    steps = {step for found in _STEP.finditer(stated) for step in _numbers(found["steps"], head.separator)}
    return steps.pop() if len(steps) == 1 else None


def _numbers(fields: str, separator: str | None) -> Iterator[float]:
    for field in fields_of(fields, separator):
        plain = field if separator == "," else field.replace(",", ".")
        if is_finite(plain) and float(plain) > 0:
            yield float(plain)
