"""Compare the measured vehicle with published values, quantity by quantity, in one unit and one frame."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from cfid.published import PublishedSet, published_sets, turned
from cfid.published.set_file import PublishedValue
from cfid.quantities.values import evaluate
from cfid.records.parameters import plain
from cfid.records.rig_file import BodyFrame
from cfid.records.values import Quantity, Values
from cfid.units import FULL_COMMAND, ROTORS

_INERTIA = "inertia.matrix_kg_m2"
_COMMANDS = ("25 %", "50 %", "75 %", "93.75 %")
_AT_COMMANDS = (16384.0, 32768.0, 49152.0, 61440.0)
_OF_COMMANDS = "At a share of full scale; one motor. Empty beyond the commands that this campaign measured."
_ALONG = ("forward", "left", "up")


class _Table(NamedTuple):
    """A comparison in one unit, of the quantities with some keys: of a campaign, the first.

    Polynomials are evaluated `at` the abscissa of each column; `column` is the one of motor.table that limits the
    campaign's, `measured` the one that has values of a set which states points.
    """

    title: str
    unit: str
    columns: tuple[str, ...]
    keys: tuple[str, ...]
    about: str = ""
    at: tuple[float, ...] = ()
    column: str = ""
    measured: str = ""


_MASS = _Table("Mass", "kg", ("mass",), ("mass_kg",))
_INERTIAS = _Table(
    "Inertia about the centre of mass",
    "kg m^2",
    ("roll", "pitch", "yaw", "roll-pitch", "roll-yaw", "pitch-yaw"),
    (_INERTIA,),
    "Roll is about the axis that points forward, pitch about the one to the left, yaw about the one up. Yours and the "
    "thesis' matrix are turned there from their own frame. The others are given as they are used.",
)
_DRAG = _Table(
    "Drag per rotor speed and velocity",
    "kg/rad",
    _ALONG,
    ("drag.simple_kg_per_rad", "drag.cross_coupling_kg_per_rad"),
    "Force along an axis for velocity along it and the sum of the rotors' speeds.",
)
_DRAG_IN_HOVER = _Table(
    "Drag per velocity",
    "kg/s",
    _ALONG,
    ("drag.complex.k4",),
    "Another model, of another unit: force for velocity alone. Yours is the one above at the rotors' speeds in hover, "
    "where mass, thrust and speed maps are known.",
)
_TABLES = (
    _MASS,
    _INERTIAS,
    _Table(
        "Thrust of the command", "N", _COMMANDS, ("motor.thrust_poly",), _OF_COMMANDS, _AT_COMMANDS, "cmd", "thrust_n"
    ),
    _Table(
        "Rotor speed of the command",
        "rad/s",
        _COMMANDS,
        ("motor.speed_poly",),
        _OF_COMMANDS,
        _AT_COMMANDS,
        "cmd",
        "speed_rad_s",
    ),
    _Table(
        "Thrust of the rotor's speed",
        "N",
        ("1000 rad/s", "1500 rad/s", "2000 rad/s"),
        ("motor.thrust_speed_poly", "motor.thrust_per_speed_squared_n_s2"),
        "One rotor; each form evaluated at the same speeds.",
        (1000.0, 1500.0, 2000.0),
        "speed_rad_s",
    ),
    _Table(
        "Thrust of the motor's voltage",
        "N",
        ("2 V", "2.5 V", "3 V", "3.5 V"),
        ("motor.thrust_voltage_poly",),
        "One motor; its voltage is the battery's by the share of the command. A polynomial may be continued here "
        "beyond the voltages that it was measured at.",
        (2.0, 2.5, 3.0, 3.5),
    ),
    _Table(
        "Torque per thrust",
        "m",
        ("slope",),
        ("motor.torque_poly",),
        "The slope of a straight line, N m of torque for N of thrust.",
    ),
    _Table("Time constant of motor and rotor", "s", ("time constant",), ("tf.time_constant_s",)),
    _Table("Static gain of the transfer function", "N", ("static gain",), ("tf.static_gain_n",)),
    _DRAG,
    _DRAG_IN_HOVER,
)


class _Yours(NamedTuple):
    """The campaign's values, one a column, None where unknown; stds are empty where not stated."""

    values: Sequence[float | None] = ()
    stds: Sequence[float | None] = ()
    sources: tuple[Quantity | None, ...] = ()
    frame: str = ""


def comparisons_of(values: Values) -> list[dict[str, Any]]:
    """Return a comparison for each published quantity; one that the campaign lacks has only published rows."""
    return [_comparison(values, table) for table in _TABLES]


def frame_text(frame: BodyFrame) -> str:
    """Return a body frame as text."""
    return f"forward {frame.forward}, left {frame.left}, up {frame.up}"


def _comparison(values: Values, table: _Table) -> dict[str, Any]:
    yours = _yours(values, table)
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
        "others": [row for published in published_sets().values() for row in _published(published, table)],
    }


def _published(published: PublishedSet, table: _Table) -> list[dict[str, Any]]:
    """Return the lines of a set: one for each of its values, of thrust over speed for the first alone."""
    stated = [value for value in published.values if value.key in table.keys]
    if table.at and not stated and table.measured:
        points = published.find("motor.table")
        stated = [points] if points is not None and table.measured in points.value[0] else []
    lines = []
    for value in stated[:1] if table.at else stated:
        frame = ""
        if table is _INERTIAS:
            is_along = published.frame == BodyFrame()
            frame = "x forward" if is_along else f"turned from {frame_text(published.frame)}"
        who = f"{published.title} ({value.variant})" if value.variant else published.title
        notes = [value.remark, published.payload if table is _MASS else ""]
        if table is _DRAG and value.key != table.keys[0]:
            notes.append("diagonal of its matrix")
        lines.append(
            _line(
                who,
                published.vehicle,
                _published_values(published, value, table),
                frame=frame,
                source=published.origin(value),
                note="; ".join(filter(None, notes)),
            )
        )
    return lines


def _published_values(published: PublishedSet, stated: PublishedValue, table: _Table) -> list[float | None]:
    """Return the values of a set's line; products of inertia are left out where the set's matrix is diagonal."""
    value = stated.value
    if stated.key == "motor.table":
        at_command = {row["cmd"]: row[table.measured] for row in value}
        return [at_command.get(command) for command in table.at]
    if stated.key == "motor.thrust_per_speed_squared_n_s2":
        return [value * speed_rad_s**2 for speed_rad_s in table.at]
    if table.at:
        return [evaluate(stated.key, value, x) for x in table.at]
    if stated.key == _INERTIA:
        entries = list(turned(value, published.frame).values())
        return [*entries] if any(entries[3:]) else [*entries[:3], None, None, None]
    if table in (_DRAG, _DRAG_IN_HOVER):
        along = [row[i] for i, row in enumerate(value)] if isinstance(value[0], list) else value
        return [along[place] for place, _ in published.frame.axes]
    return [value[-2] if isinstance(value, list) else value]


def _line(who: str, vehicle: str, values: Sequence[float | None], **texts: str) -> dict[str, Any]:
    """Return one line of a comparison; `texts` are its frame, source and note."""
    return {"who": who, "vehicle": vehicle, "values": list(values), "frame": "", "source": "", "note": "", **texts}


def _yours(values: Values, table: _Table) -> _Yours:
    """Return the campaign's values of a comparison, empty without a measurement."""
    if table in _MAKERS:
        return _MAKERS[table](values)
    quantity = values.find(table.keys[0])
    if quantity is None:
        return _Yours()
    value, std = quantity.parameter.value, quantity.parameter.std
    if table.at:
        return _Yours(_evaluated(quantity, table.at, table.column), (), (quantity,))
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


_MAKERS: Mapping[_Table, Callable[[Values], _Yours]] = {
    _MASS: _mass,
    _INERTIAS: _inertia,
    _DRAG: _drag,
    _DRAG_IN_HOVER: _drag_in_hover,
}
