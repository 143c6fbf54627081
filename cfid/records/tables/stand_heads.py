"""Recognise a table of motors by its header alone."""

import re
from collections.abc import Container, Sequence

from cfid.units import split_unit

_NAMES = {
    "command": r"cmd|command|pwm|esc|throttle|esc (signal|throttle)|.* - esc throttle",
    "thrust": r"thrust|thrust total|weight|.* - force fz \(thrust\)",
    "torque": r"torque|torque z|.* - torque mz \(torque\)",
    "speed": r"rpm ?\d*|rpm mean|speed|omega|(motor|motor optical|motor electrical|rotation) speed|.* - rotation speed",
    "grams": "grams",
}


def heads_of(names: Sequence[str]) -> set[str]:
    """Return the quantities of motors among a table's columns."""
    words = [re.sub(r"[\s_]+", " ", split_unit(name)[0].lower()) for name in names]
    return {quantity for quantity, called in _NAMES.items() if any(re.fullmatch(called, word) for word in words)}


def shows_stand(called: Container[str]) -> bool:
    """Return whether known quantities make a table of motors: something measured, and a command or another."""
    measured = [quantity for quantity in ("thrust", "torque", "speed", "grams") if quantity in called]
    return bool(measured) and ("command" in called or ("thrust" in measured and len(measured) > 1))
