"""Where the lines and fields of a table's text are, seen in its bytes: much faster than line by line."""

import re

import numpy as np
import numpy.typing as npt

from cfid.records.tables.head import COMMENT

Places = npt.NDArray[np.intp]

_SPACE = 32


def evenly_filled(body: bytes, separator: str | None, columns: int) -> bool:
    """Return whether every line has the right number of separators and none is blank; fast."""
    if separator not in (",", ";") or columns < 2:
        return False
    signs = np.frombuffer(body, np.uint8)
    ends, separators = (np.flatnonzero(signs == ord(sign)) for sign in ("\n", separator))
    if len(separators) != len(ends) * (columns - 1):
        return False
    of_lines = separators.reshape(len(ends), -1)
    return bool(np.all(of_lines[:, -1] < ends) and np.all(of_lines[1:, 0] > ends[:-1]))


def fields_of_lines(body: bytes, separator: str | None) -> tuple[Places, Places]:
    """Return for every line of the body its number of fields, 0 where it is blank, and where it ends."""
    signs = np.frombuffer(body, np.uint8)
    ends = np.flatnonzero(signs == ord("\n"))
    if separator is None:
        begins = signs > _SPACE
        begins[1:] &= signs[:-1] <= _SPACE
        return np.diff(np.searchsorted(np.flatnonzero(begins), ends), prepend=0), ends
    separators = np.flatnonzero(signs == ord(separator))
    fields = np.diff(np.searchsorted(separators, ends), prepend=0) + 1
    starts = np.concatenate([[0], ends[:-1] + 1])
    if np.any(signs[starts] <= _SPACE):
        fields[~np.logical_or.reduceat(signs > _SPACE, starts)] = 0
    return fields, ends


def without_comments(body: bytes) -> bytes:
    """Return the body with its comments blanked out, so that lines keep their numbers."""
    if not any(sign in body for sign in (b"#", b"%", b"/")):  # one letter is searched for much faster than `//`
        return body
    return re.sub(rf"(?m)^{COMMENT}[^\n]*".encode(), lambda found: b" " * len(found.group()), body)
