"""Parse an option's list of numbers with commas between, or its span FROM:TO."""

import math
from collections.abc import Sequence
from typing import TypeVar

from cfid.errors import ConfigError

Value = TypeVar("Value", int, float)


def comma_list(
    words: str | Sequence[str],
    option: str,
    kind: type[Value],
    *,
    least: float = -math.inf,
    most: float = math.inf,
    example: str,
) -> tuple[Value, ...]:
    """Return the numbers of an option, from `least` to `most`; a repeated option counts as one list.

    Raises ConfigError that names the option and what it should be.
    """
    text = words if isinstance(words, str) else ",".join(words)
    try:
        values = tuple(_number(word, kind) for word in text.split(","))
    except ValueError:
        values = ()
    if values and all(least <= value <= most and math.isfinite(value) for value in values):
        return values
    bounds = f" from {least:g} to {most:g}" if math.isfinite(most) else ""
    what = "whole numbers" if kind is int else "numbers"
    raise ConfigError(f"{option} {text}: should be {what}{bounds} with commas between, as {example}.")


def span(text: str, option: str, *, unit: str, example: str) -> tuple[float, float]:
    """Return the two numbers of FROM:TO, of which the second is greater. Raises ConfigError."""
    try:
        low, high = (_number(word, float) for word in text.split(":"))
    except ValueError:
        low = high = math.nan
    if not (0 <= low < high < math.inf):
        raise ConfigError(f"{option} {text}: should be FROM:TO in {unit}, from 0 on and rising, as {example}.")
    return low, high


def _number(word: str, kind: type[Value]) -> Value:
    if "_" in word:  # Python would accept it
        raise ValueError(word)
    return kind(word)
