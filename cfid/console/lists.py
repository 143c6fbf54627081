"""Parse the value of an option: numbers separated by commas, a span FROM,TO, or a number with its uncertainty."""

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeVar

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
    """Return the numbers of an option, each from `least` to `most`; the values of a repeated option form one list.

    Raises ConfigError, which names the option and the expected form.
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
    """Return the numbers of FROM,TO or FROM:TO, of which the second is greater. Raises ConfigError."""
    try:
        low, high = (_number(word, float) for word in text.replace(":", ",").split(","))
    except ValueError:
        low = high = math.nan
    if not (0 <= low < high < math.inf):
        raise ConfigError(f"{option} {text}: should be FROM,TO in {unit}, from 0 on and rising, as {example}.")
    return low, high


class Measured(NamedTuple):
    """A measured number and its standard uncertainty, each None where it was not given."""

    value: float | None
    std: float | None


NOT_GIVEN = Measured(None, None)


def measured(text: str | None, option: str) -> Measured:
    """Return a number above zero, with its standard uncertainty if one follows a colon.

    Raises ConfigError, which names the option.
    """
    if text is None:
        return NOT_GIVEN
    number, colon, spread = text.partition(":")
    try:
        value, std = _number(number, float), _number(spread, float) if colon else None
    except ValueError:
        value = std = math.nan
    if not (0 < value < math.inf and (std is None or 0 < std < value)):
        raise ConfigError(
            f"{option} {text}: has to be above zero, a number alone or with its standard uncertainty, as 0.23:0.001; "
            "that is above zero too, since nothing measured is exact, and smaller than the number."
        )
    return Measured(value, std)


def _number(word: str, kind: type[Value]) -> Value:
    if "_" in word:  # Python would accept it
        raise ValueError(word)
    return kind(word)
