"""Which shapes the values of parameters have, checked where files are read that somebody may have edited."""

from collections.abc import Mapping
from typing import Any

_NUMBER: Any = 0  # stands for any number in a form
_VECTOR = [_NUMBER] * 3
_MATRIX = [_VECTOR] * 3
_FORMS: Mapping[str, Any] = {
    "inertia.matrix_kg_m2": _MATRIX,
    "drag.cross_coupling_kg_per_rad": _MATRIX,
    "drag.simple_kg_per_rad": _VECTOR,
    "dynamics.rising": [_NUMBER] * 2,
    "dynamics.falling": [_NUMBER] * 2,
    "motor.thrust_speed_poly": _VECTOR,
    **dict.fromkeys(
        (
            "motor.max_thrust_n",
            "motor.thrust_per_speed_squared_n_s2",
            "tf.time_constant_s",
            "tf.static_gain_n",
            "arm_m",
            "rotor_inertia_kg_m2",
            "rotor_radius_m",
        ),
        _NUMBER,
    ),
}
_ROWS: Mapping[str, tuple[str, ...]] = {  # and what each of them has
    "motor.table": ("cmd",),
    "motor.command_of_thrust": ("thrust_min_n",),
}


def misshapen(key: str, value: Any, std: Any) -> str:
    """Return what is wrong with a parameter as a file gave it, "" where nothing is; a deviation may be None.

    Only parameters that a calculation takes are asked for their shape, and a deviation to be shaped as its value.
    """
    if not (key in _FORMS or key in _ROWS or _is_polynomial(key)):
        return ""
    if isinstance(value, list) and value and all(isinstance(row, Mapping) for row in value):
        return _misshapen_rows(key, value)
    try:
        found = _form(value)
        spread = None if std is None else _form(std)
    except TypeError:
        return "should be made of numbers"
    if wanted := _wanted(key, found):
        return f"should be {wanted}"
    return "" if spread in (None, found) else "and its deviation should be shaped alike"


def _wanted(key: str, found: Any) -> str:
    """Return what a value of a form should be instead, "" where it is that."""
    if key in _ROWS:
        return "a list of rows"
    if key in _FORMS:
        return "" if found == _FORMS[key] else _words(_FORMS[key])
    return "" if found and found == [_NUMBER] * len(found) else "a list of coefficients"


def _misshapen_rows(key: str, rows: list[Mapping[str, Any]]) -> str:
    if key not in _ROWS:
        return "should be made of numbers"
    lacking = [name for name in _ROWS[key] if not all(_may_be_number(row.get(name, "")) for row in rows)]
    return f"should have a number {lacking[0]} in each row" if lacking else ""


def _is_polynomial(key: str) -> bool:
    return key.startswith("motor.") and key.endswith("_poly")


def _form(value: Any) -> Any:
    if isinstance(value, list):
        return [_form(item) for item in value]
    if not _may_be_number(value):
        raise TypeError
    return _NUMBER


def _may_be_number(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def _words(form: Any) -> str:
    if form == _NUMBER:
        return "a number"
    return "a matrix of 3 times 3 numbers" if form == _MATRIX else f"a list of {len(form)} numbers"
