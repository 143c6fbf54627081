"""How people write numbers in rig.toml: a value with its uncertainty, grams, and "?" for what is still to measure."""

import re
from collections.abc import Mapping
from decimal import Decimal, InvalidOperation
from typing import Any

from cfid.errors import ConfigError

UNKNOWN = "?"

_UNITS = ("g", "kg", "mm", "deg", "mps2")  # keys that end in them may state a value with its uncertainty
_WITH_STD = re.compile(r"(.+?)\s*(?:±|\+/?-)\s*([^±]+)")
_SEPARATOR = re.compile(r"\s*,\s*|\s+")

# Tables that are of no use without each of their numbers, under which one still to measure leaves out the whole.
_WHOLE = re.compile(r"((?:testbody\.)?mounts\.[^.]+|friction|fixture|testbody)\..+")


def plain(content: Mapping[str, Any], *, name: str) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return the content of a rig.toml with numbers alone, and the keys or tables of what is still to measure.

    `"28.0 ± 0.03"` becomes a key for the value and one for its standard uncertainty, which holds for each number of a
    list such as `"0, 0, 17.4 ± 0.1"`; grams become kilograms. What holds a "?" is left out, and with it the mount or
    the table that is of no use without it. `name` is that of the file.

    Raises ConfigError for text that is neither, and a number or an uncertainty that is stated twice.
    """
    keys: list[str] = []
    rig = _plain_table(content, "", keys, name)
    unknown = tuple(dict.fromkeys(whole[1] if (whole := _WHOLE.fullmatch(key)) else key for key in keys))
    for key in unknown:
        _drop(rig, key.split("."))
    return rig, unknown


def spelled(table: Mapping[str, Any], key: str) -> str | None:
    """Return the key under which a table states what `key` is in SI units, None where it does not."""
    return next((other for other in (key, _in_grams(key)) if other in table), None)


def _in_grams(key: str) -> str:
    return f"{key.removesuffix('_kg')}_g" if key.endswith("_kg") else key


def _drop(table: dict[str, Any], path: list[str]) -> None:
    *outer, last = path
    for part in outer:
        table = table.get(part, {})
    table.pop(last, None)


def _plain_table(table: Mapping[str, Any], path: str, unknown: list[str], name: str) -> dict[str, Any]:
    numbers: dict[str, Any] = {}
    for key, value in table.items():
        place = f"{path}{key}"
        if isinstance(value, Mapping):
            numbers[key] = _plain_table(value, f"{place}.", unknown, name)
            continue
        unit = key.rpartition("_")[2]
        if unit not in _UNITS or "_" not in key:
            numbers[key] = value
            continue
        if UNKNOWN in (value if isinstance(value, str | list) else ()):
            unknown.append(place)
            continue
        for stated_key, number in _numbers(key, unit, value, f"{name}: {place}").items():
            if stated_key in table.keys() - {key} or stated_key in numbers:
                raise ConfigError(f"{name}: {path}{stated_key} is stated twice: {key} states it, too.")
            numbers[stated_key] = number
    return numbers


def _numbers(key: str, unit: str, value: Any, place: str) -> dict[str, Any]:
    """Return the SI keys and numbers of one key of a file."""
    si_unit, power = ("kg", -3) if unit == "g" else (unit, 0)
    stem = key.removesuffix(f"_{unit}")
    if not isinstance(value, str):
        return {f"{stem}_{si_unit}": _shifted(value, power)}
    parts = _WITH_STD.fullmatch(value.strip())
    if parts is None:
        raise ConfigError(
            f'{place}: should be a number, or text such as "28.0 ± 0.03" (value ± standard uncertainty), not '
            f"'{value[:40]}'."
        )
    try:
        values = [float(Decimal(word).scaleb(power)) for word in _SEPARATOR.split(parts[1])]
        std = float(Decimal(parts[2]).scaleb(power))
    except InvalidOperation:
        raise ConfigError(f"{place}: '{value[:40]}' has no numbers before and after the sign.") from None
    if len(values) == 1:
        return {f"{stem}_{si_unit}": values[0], f"{stem}_std_{si_unit}": std}
    return {f"{stem}_{si_unit}": values, f"{stem}_std_{si_unit}": [std] * len(values)}


def _shifted(value: Any, power: int) -> Any:
    """Return a number times a power of ten, to its last digit; what is no number is returned for the model to judge."""
    if power == 0 or isinstance(value, bool) or not isinstance(value, int | float):
        return value
    return float(Decimal(repr(value)).scaleb(power))
