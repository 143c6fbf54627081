"""Format numbers and comments for exported files."""

import re
from collections.abc import Iterable, Sequence

from cfid.records.parameters import Value

HASH, SLASHES, XML = "#", "//", "<!--"


def number(value: float) -> str:
    """Return a number that C, TOML, YAML, XML and Python all read as a floating-point number."""
    mantissa, exponent_mark, exponent = f"{value + 0.0:.10g}".partition("e")
    return f"{mantissa}{'' if '.' in mantissa else '.0'}{exponent_mark}{exponent}"


def numbers(values: Iterable[float], separator: str = ", ") -> str:
    """Return numbers with a separator between them."""
    return separator.join(number(value) for value in values)


def rows(matrix: Iterable[Sequence[float]]) -> str:
    """Return a matrix as a nested list of TOML and Python, one line per row."""
    return "[\n" + "".join(f"    [{numbers(row)}],\n" for row in matrix) + "]"


def shown(value: Value, digits: int = 7) -> str:
    """Return a value as text for a comment."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} {shown(item, digits)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(shown(item, digits) for item in value) + "]"
    return f"{value:.{digits}g}" if isinstance(value, int | float) else "-" if value is None else str(value)


def commented(lines: Iterable[str], style: str) -> str:
    """Return lines as comments, whatever they contain, since names come from files that people write."""
    safe = ["".join(c if c.isprintable() else "?" for c in line).rstrip("\\ ") for line in lines]
    if style == XML:
        inside = "".join(f"  {re.sub('-(?=-)', '- ', line).removesuffix('-')}".rstrip() + "\n" for line in safe)
        return f"<!--\n{inside}-->\n"
    return "".join(f"{style} {line}".rstrip() + "\n" for line in safe)


def identifier(name: str) -> str:
    """Return a name reduced to letters, digits and underscores."""
    kept = "".join(c if c.isascii() and c.isalnum() else "_" for c in name).strip("_")
    return kept or "vehicle"
