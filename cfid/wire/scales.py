"""Reads the lines in which scales send weights unprompted, in the forms that most makers share; sends no command.

It reads three forms, each with a number, its unit, and spaces between them:

    ST,GS,+0001.23 kg    A&D, Kern, Tiger, Brecknell: ST stable or US not, then perhaps GS gross or NT net
    S S     12.34 g      Mettler's SICS: S stable or D not, as the answer to its commands S, SI and SIR
      12.34 g            nothing more: the line does not state whether it is stable

Anything else is counted and left out: overload (OL, "S +"), a tare (TR), pieces, another unit, or none.

A line that lost its beginning would read as another number. So the first line counts only with a head (the letters
before the number), and after a line with a head, lines without one are rejected. There is no checksum: a flipped bit
can turn one digit into another, a last 0 into a space, a space there into a 0, and a minus in a line without a head
into an end of line; all other flips are found.
"""

import re
from typing import NamedTuple

from cfid.wire.lines import Splitter

GRAMS = {
    "g": 1.0,
    "kg": 1e3,
    "mg": 1e-3,
    "lb": 453.59237,  # by the international agreement of 1959, as is the ounce, its sixteenth
    "oz": 453.59237 / 16,
}

_LONGEST = 64  # bytes of a line; the longest known has 24
_LINE = re.compile(
    rb"\s*(?:(?P<head>ST|US),(?:\s*(?:GS|NT),)?|S (?P<sics>[SD]) )?"
    rb"\s*(?P<sign>[+-]?)\s*(?P<number>\d{1,9}(?:\.\d{0,9})?|\.\d{1,9})\s*,?\s*(?P<unit>kg|g|mg|lb|oz)\s*",
    re.IGNORECASE,
)
_STABLE = {b"ST": True, b"US": False, b"S": True, b"D": False}


class Weight(NamedTuple):
    """One line of scales: grams, and whether they were stable, None where the line does not state it."""

    grams: float
    stable: bool | None


def read_weight(line: bytes) -> Weight | None:
    """Return the weight in one line, given without its line end, or None when the line has none of the forms."""
    match = _LINE.fullmatch(line)
    if match is None:
        return None
    grams = float(match["sign"] + match["number"]) * GRAMS[match["unit"].decode().lower()]
    head = match["head"] or match["sics"]
    return Weight(grams, _STABLE[head.upper()] if head else None)


class ScalesReader:
    """Reads weights; `rejected` counts lines without one. A line ends in CR, LF or both."""

    def __init__(self) -> None:
        """Start anywhere in a line."""
        self.rejected = 0
        self._lines = Splitter(longest=_LONGEST)
        self._first, self._headed = True, False

    def feed(self, data: bytes) -> list[Weight]:
        """Return the weights that `data` completes."""
        lines = self._lines.feed(data)
        weights = [weight for line in lines if (weight := self._read(line)) is not None]
        self.rejected += sum(map(bool, lines)) - len(weights)
        return weights

    def _read(self, line: bytes) -> Weight | None:
        weight = read_weight(line) if len(line) <= _LONGEST else None
        headed = weight is not None and weight.stable is not None
        whole = headed or not (self._first or self._headed)
        self._first, self._headed = False, self._headed or headed
        return weight if whole else None
