"""Look up a key's row of the registry, and a name's unit."""

import re
from functools import cache

from cfid.quantities.quantity import Quantity
from cfid.quantities.table import QUANTITIES

UNITS = {  # by the ending of a name
    "kg_m2": "kg m^2",
    "rad_per_s": "rad/s",
    "mps2": "m/s^2",
    "mps": "m/s",
    "nm": "N m",
    "kg": "kg",
    "mm": "mm",
    "rad": "rad",
    "deg": "deg",
    "ohm": "ohm",
    "hz": "Hz",
    "m": "m",
    "s": "s",
    "n": "N",
    "v": "V",
    "a": "A",
}


@cache
def find(key: str) -> Quantity | None:
    """Return the quantity of a key, None for a key outside the registry, such as a name stored by hand."""
    return _BY_KEY.get(key) or next((found for pattern, found in _PATTERNS if pattern.fullmatch(key)), None)


def registered(key: str) -> Quantity:
    """Return the quantity of a key. Raises KeyError for a key outside the registry, which is a bug."""
    found = find(key)
    if found is None:
        raise KeyError(key)
    return found


def unit_of(key: str) -> str:
    """Return the unit of a key from the registry, else from the ending of its name; "" without either."""
    found = find(key)
    return found.unit if found is not None and found.unit else _at_the_end_of(key)


def is_of_the_run(key: str) -> bool:
    """Return whether a key is a property of the run, not of the vehicle, such as the release of a swing."""
    found = find(key)
    return found is not None and found.of_the_run


def _at_the_end_of(name: str) -> str:
    """Return the unit that a name's ending states, "" without one or for part of a unit, as in `_m_per_s`."""
    suffix = next((suffix for suffix in UNITS if name.endswith(f"_{suffix}")), "")
    before = name.removesuffix(f"_{suffix}").rpartition("_")[-1]
    return "" if not suffix or before in {"per", *UNITS} else UNITS[suffix]


def _pattern(key: str) -> re.Pattern[str]:
    """Return the pattern of a key, where `<name>` is any name and `[...]` is optional."""
    words = re.split(r"<\w+>", key)
    return re.compile(".+".join(re.escape(word) for word in words).replace(r"\[", "(?:").replace(r"\]", ")?"))


_BY_KEY = {quantity.key: quantity for quantity in QUANTITIES}
_PATTERNS = [(_pattern(quantity.key), quantity) for quantity in QUANTITIES if "<" in quantity.key]
