"""Compare the measured vehicle with published values, quantity by quantity, in one unit and one frame."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from cfid.published import Row, Table, tables, turned
from cfid.quantities.values import evaluate
from cfid.records.covariances import shaped_as
from cfid.records.parameters import plain
from cfid.records.rig_file import BodyFrame
from cfid.records.values import Quantity, Values
from cfid.units import FULL_COMMAND, ROTORS

_INERTIA = "inertia.matrix_kg_m2"
_QUANTITIES = {  # of a table: the key, and the column of motor.table that limits a polynomial's range
    "thrust_of_command_n": ("motor.thrust_poly", "cmd"),
    "speed_of_command_rad_s": ("motor.speed_poly", "cmd"),
    "thrust_of_speed_n": ("motor.thrust_speed_poly", "speed_rad_s"),
    "thrust_of_voltage_n": ("motor.thrust_voltage_poly", ""),
    "torque_per_thrust_m": ("motor.torque_poly", ""),
    "time_constant_s": ("tf.time_constant_s", ""),
    "static_gain_n": ("tf.static_gain_n", ""),
}


class _Yours(NamedTuple):
    """The campaign's values, one a column, None where unknown; stds are empty where not stated."""

    values: Sequence[float | None] = ()
    stds: Sequence[float | None] = ()
    sources: tuple[Quantity | None, ...] = ()
    frame: str = ""


def comparisons_of(values: Values) -> list[dict[str, Any]]:
    """Return a comparison for each published table; a quantity that the campaign lacks has only published rows."""
    return [_comparison(values, name, table) for name, table in tables().items()]


def frame_text(frame: BodyFrame) -> str:
    """Return a body frame as text."""
    return f"forward {frame.forward}, left {frame.left}, up {frame.up}"


def _comparison(values: Values, name: str, table: Table) -> dict[str, Any]:
    yours = _yours(values, name, table)
    rejected = dict.fromkeys(source.fit.name for source in yours.sources if source is not None and not source.accepted)
    note = f"REJECTED by its fit, and kept nevertheless ({', '.join(rejected)})" if rejected else ""
    own = _line("this campaign", values.rig.vehicle.name, yours.values, frame=yours.frame, note=note)
    return {
        "title": table.title,
        "about": table.about,
        "columns": list(table.columns),
        "unit": table.unit,
        "yours": own if yours.values else None,
        "yours_std": list(yours.stds),
        "others": [_published(row, is_inertia=name == "inertia_kg_m2") for row in table.rows],
    }


def _published(row: Row, *, is_inertia: bool) -> dict[str, Any]:
    values: list[float | None] = list(row.values)
    if is_inertia:
        entries = turned(shaped_as(_INERTIA, (*row.values, 0.0, 0.0, 0.0)[:6], None), row.frame)
        values = [*list(entries.values())[: len(row.values)], *[None] * (6 - len(row.values))]
    frame = (
        "" if not is_inertia else "x forward" if row.frame == BodyFrame() else f"turned from {frame_text(row.frame)}"
    )
    return _line(row.who, row.vehicle, values, frame=frame, source=row.source, note=row.note)


def _line(who: str, vehicle: str, values: Sequence[float | None], **texts: str) -> dict[str, Any]:
    """Return one line of a comparison; `texts` are its frame, source and note."""
    return {"who": who, "vehicle": vehicle, "values": list(values), "frame": "", "source": "", "note": "", **texts}


def _yours(values: Values, name: str, table: Table) -> _Yours:
    """Return the campaign's values of a published table, empty without a measurement."""
    if name in _MAKERS:
        return _MAKERS[name](values)
    key, column = _QUANTITIES[name]
    quantity = values.find(key)
    if quantity is None:
        return _Yours()
    value, std = quantity.parameter.value, quantity.parameter.std
    if table.at:
        return _Yours(_evaluated(quantity, table.at, column), (), (quantity,))
    if isinstance(value, list):  # the slope of a straight line
        value, std = (value[0], std and std[0]) if len(value) == 2 else (None, None)
    return _Yours() if value is None else _Yours((value,), (std,), (quantity,))


def _mass(values: Values) -> _Yours:
    return _Yours((values.rig.vehicle.mass_kg,), (values.rig.vehicle.mass_std_kg,))


def _inertia(values: Values) -> _Yours:
    """Return the inertia matrix about the axes forward, left and up."""
    inertia, frame = values.find(_INERTIA), values.rig.vehicle.body_frame
    if inertia is None:
        return _Yours()
    stds = turned(inertia.parameter.std, frame).values() if inertia.parameter.std else ()
    return _Yours(
        list(turned(inertia.parameter.value, frame).values()),
        [abs(std) for std in stds],  # turning may change the sign of an entry, which an uncertainty does not have
        (inertia,),
        f"turned from {frame_text(frame)}",
    )


def _drag(values: Values) -> _Yours:
    """Return the drag along forward, left and up for velocity and the sum of the rotors' speeds."""
    drag, frame = values.find("drag.simple_kg_per_rad"), values.rig.vehicle.body_frame
    if drag is None:
        return _Yours()
    places = [place for place, _ in frame.axes]
    value, std = drag.parameter.value, drag.parameter.std
    return _Yours([value[i] for i in places], [std[i] for i in places] if std else (), (drag,))


def _drag_in_hover(values: Values) -> _Yours:
    """Return the drag for velocity alone, at the rotors' speeds in hover."""
    drag, speed_sum_rad_s = _drag(values), _hover_speed_sum_rad_s(values)
    maps = values.find("motor.thrust_poly"), values.find("motor.speed_poly")
    times = [] if speed_sum_rad_s is None else [speed_sum_rad_s * (value or 0.0) for value in drag.values]
    return _Yours(times, (), (*drag.sources, *maps))


def _evaluated(polynomial: Quantity, at: Sequence[float], column: str) -> list[float | None]:
    """Return a polynomial's values, None outside the range of a column of its section's table."""
    table = polynomial.section.parameters.get("motor.table")
    rows: Any = plain(table.value) if table is not None else []
    measured = [row[column] for row in rows if row.get(column)] or at
    return [
        evaluate(polynomial.key, polynomial.parameter.value, x) if min(measured) <= x <= max(measured) else None
        for x in at
    ]


def _hover_speed_sum_rad_s(values: Values) -> float | None:
    """Return the sum of the four rotors' speeds in hover, None where a map is missing or does not reach hover."""
    thrust, speed = values.find("motor.thrust_poly"), values.find("motor.speed_poly")
    if thrust is None or speed is None:
        return None
    weight_n = values.rig.vehicle.mass_kg * values.rig.site.gravity_mps2 / ROTORS
    commands = np.arange(FULL_COMMAND + 1)
    carries = np.polyval(thrust.parameter.value, commands) >= weight_n
    return ROTORS * evaluate(speed.key, speed.parameter.value, commands[carries.argmax()]) if carries.any() else None


_MAKERS: Mapping[str, Callable[[Values], _Yours]] = {
    "mass_kg": _mass,
    "inertia_kg_m2": _inertia,
    "drag_kg_per_rad": _drag,
    "drag_kg_per_s": _drag_in_hover,
}
