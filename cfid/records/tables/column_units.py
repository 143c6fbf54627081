"""Find the units of columns: their spellings, and the unit that a column's name, its file or a setting states."""

import re
from collections.abc import Sequence

from cfid.errors import ConfigError
from cfid.records.tables.table import CsvTable

PER_SECOND: dict[str, float] = {"s": 1.0, "ms": 1e3, "us": 1e6}  # to divide by: 1e-3 and 1e-6 are not exact
SECONDS: dict[str, float] = {unit: 1 / count for unit, count in PER_SECOND.items()}
_UNITS: dict[str, tuple[str, ...]] = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "msecs", "millis", "milliseconds"),
    "us": ("us", "µs", "μs", "usec", "usecs", "micros", "microseconds", "timeus"),
    "rad": ("rad", "radian", "radians"),
    "deg": ("deg", "degree", "degrees", "°"),
    "n": ("n", "newton", "newtons"),
    "nm": ("nm", "n m", "n-m", "n*m", "n·m", "n⋅m"),
    "counts": ("counts", "count"),
}

# Bytes of the micro and middle-dot signs that were saved in another encoding are read as signs of their own.
_MICRO, _DOT = re.compile("[µμ�]"), re.compile("[·⋅∙•*]")
_INVERSE = re.compile(r"\^[({]-1[)}]|⁻¹")


def spelt(name: str) -> str:
    """Return a name in lower case, without spaces, and with ASCII characters for micro and middle-dot signs."""
    bare = re.sub(r"[\sâÂ]", "", name)
    return _DOT.sub(".", _MICRO.sub("u", _INVERSE.sub("^-1", bare))).lower()


def column_name(names: str, units: Sequence[str], *, others: str = "") -> re.Pattern[str]:
    """Return the pattern of a column's names: `t`, `t_s`, `t [s]`, `t in s`, `angle(deg)`, `angle__deg_`, ...

    `others` is a pattern of further units.
    """
    words = "|".join([*(re.escape(word) for unit in units for word in _UNITS[unit]), *([others] if others else [])])
    return re.compile(rf"(?:{names})(?:(?: in)?[ _/,\[(]+({words})[\])_]?)?", re.IGNORECASE)


ANGLE_NAMES = column_name(
    r"(?:phi|angle|theta|alpha|winkel|auslenkung|[φϕθϑα]|pos|position|enc|encoder(?:[ _]angle)?)_?\d?",
    ("rad", "deg", "counts"),
)


def unit_word(word: str) -> str | None:
    """Return the unit that a word in a column's name stands for, None for another word."""
    return next((unit for unit, words in _UNITS.items() if word.lower() in words), None)


def unit_of(table: CsvTable, pattern: re.Pattern[str], column: str, given: str | None, setting: str) -> str | None:
    """Return the unit that a setting gives, that the column's name has or is, or that the file states; None for none.

    Raises ConfigError when the two contradict each other.
    """
    name = table.names[table.place(column)]
    match = pattern.fullmatch(name)
    word = (match.group(1) if match else None) or table.units.get(name) or (name if match else "")
    named = unit_word(word)
    if given and named and given != named:
        raise ConfigError(f"{table.path}: column '{name}' is in {named}, but `{setting}` is {given}.")
    return given or named
