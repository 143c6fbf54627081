"""Compare the measured vehicle with published values, quantity by quantity, in one unit and one frame."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from cfid.quantities.registry import registered, unit_of
from cfid.quantities.values import coefficient_units, evaluate
from cfid.records.covariances import shaped_as
from cfid.records.parameters import plain
from cfid.records.rig_file import BodyFrame
from cfid.records.values import Quantity, Values
from cfid.report import published
from cfid.report.axes import axis_of, turned
from cfid.report.published import Published, PublishedInertia
from cfid.units import FULL_COMMAND, ROTORS

_INERTIA = "inertia.matrix_kg_m2"
_TABLE_SCALE = 2**16  # full scale of Bitcraze's tables, which state commands as shares of it
_HOVERS = 0.01  # of the weight: tolerance for the thrust of a hovering command


@dataclass(frozen=True)
class ComparisonRow:
    """A row with author, vehicle, a value for each column (None if unknown), frame, source and a note."""

    who: str
    vehicle: str
    values: tuple[float | None, ...]
    frame: str
    source: str
    note: str


@dataclass(frozen=True)
class PublishedComparison:
    """A quantity in a unit common to all columns; `yours` is the campaign's row, None without a measurement."""

    title: str
    about: str
    columns: tuple[str, ...]
    unit: str
    yours: ComparisonRow | None
    yours_std: tuple[float | None, ...]
    others: tuple[ComparisonRow, ...]


Numbers = tuple[float | None, ...]


def comparisons(known: Values) -> tuple[PublishedComparison, ...]:
    """Return comparisons of all published quantities; a quantity that the campaign lacks has only published rows."""
    return (
        _mass(known),
        _inertia(known),
        _over_command(known, "Thrust of the command", "motor.thrust_poly", published.THRUST_N),
        _over_command(known, "Rotor speed of the command", "motor.speed_poly", published.SPEED_RAD_S),
        _thrust_at_speed(known),
        _thrust_at_voltage(known),
        _torque(known),
        *_dynamics(known),
        *_drag(known),
    )


def _mass(known: Values) -> PublishedComparison:
    vehicle = known.rig.vehicle
    own = (vehicle.mass_kg,), (vehicle.mass_std_kg,)
    return _compared(known, "Mass", published.MASS_KG, *own, columns=("mass",), unit=unit_of("mass_kg"))


def _inertia(known: Values) -> PublishedComparison:
    found = known.find(_INERTIA)
    frame = known.rig.vehicle.body_frame
    values: Numbers = ()
    std: Numbers = ()
    if found is not None:
        values = tuple(turned(found.parameter.value, frame).values())
        # Turning an entry may change its sign, which a standard uncertainty does not have.
        std = tuple(abs(x) for x in turned(found.parameter.std, frame).values()) if found.parameter.std else ()
    others = tuple(_turned_line(one) for one in published.INERTIA)
    return PublishedComparison(
        title="Inertia about the centre of mass",
        about="Roll is about the axis that points forward, pitch about the one to the left, yaw about the one up. "
        "Yours and the thesis' matrix are turned there from their own frame. The others are given as they are used.",
        columns=tuple(turned(shaped_as(_INERTIA, (0.0,) * 6, None), frame)),
        unit=unit_of(_INERTIA),
        yours=_yours(known, values, (found,), f"turned from {frame_text(frame)}") if values else None,
        yours_std=std,
        others=others,
    )


def frame_text(frame: BodyFrame) -> str:
    """Return a body frame as text."""
    return f"forward {frame.forward}, left {frame.left}, up {frame.up}"


def _turned_line(one: PublishedInertia) -> ComparisonRow:
    values = tuple(turned(shaped_as(_INERTIA, one.matrix_kg_m2, None), one.axes).values())
    frame = "x forward" if one.axes == published.X_FORWARD else f"turned from {frame_text(one.axes)}"
    diagonal = not any(one.matrix_kg_m2[3:])
    return ComparisonRow(
        one.who, one.vehicle, values[:3] + (None,) * 3 if diagonal else values, frame, one.source, one.note
    )


def _over_command(known: Values, title: str, key: str, others: tuple[Published, ...]) -> PublishedComparison:
    found = known.find(key)
    return _compared(
        known,
        title,
        others,
        _polynomial(found, key, published.COMMANDS, "cmd"),
        by=(found,),
        columns=tuple(f"{100 * command / _TABLE_SCALE:.4g} %" for command in published.COMMANDS),
        unit=registered(key).of,
        about="At a share of full scale; one motor. Empty beyond the commands that this campaign measured.",
    )


def _polynomial(found: Quantity | None, key: str, at: Sequence[float], column: str) -> Numbers:
    """Return a polynomial's values, None outside the range of its section's table."""
    if found is None:
        return ()
    table = found.section.parameters.get("motor.table")
    measured = [row[column] for row in plain(table.value) if row.get(column)] if table is not None else []
    low, high = (min(measured), max(measured)) if measured else (min(at), max(at))
    return tuple(evaluate(key, found.parameter.value, x) if low <= x <= high else None for x in at)


def _thrust_at_speed(known: Values) -> PublishedComparison:
    key = "motor.thrust_speed_poly"
    found = known.find(key)
    return _compared(
        known,
        "Thrust of the rotor's speed",
        published.THRUST_AT_SPEED_N,
        _polynomial(found, key, published.SPEEDS_RAD_S, "speed_rad_s"),
        by=(found,),
        columns=tuple(f"{speed:.0f} rad/s" for speed in published.SPEEDS_RAD_S),
        unit=registered(key).of,
        about="One rotor; each form evaluated at the same speeds.",
    )


def _thrust_at_voltage(known: Values) -> PublishedComparison:
    key = "motor.thrust_voltage_poly"
    found = known.find(key)
    return _compared(
        known,
        "Thrust of the motor's voltage",
        published.THRUST_AT_VOLTAGE_N,
        () if found is None else tuple(evaluate(key, found.parameter.value, volts) for volts in published.VOLTS),
        by=(found,),
        columns=tuple(f"{volts:g} V" for volts in published.VOLTS),
        unit=registered(key).of,
        about="One motor; its voltage is the battery's by the share of the command. A polynomial may be continued here "
        "beyond the voltages that it was measured at.",
    )


def _torque(known: Values) -> PublishedComparison:
    key = "motor.torque_poly"
    found = known.find(key)
    values: Numbers = ()
    std: Numbers = ()
    if found is not None and len(found.parameter.value) == 2:
        values, std = (found.parameter.value[0],), (found.parameter.std[0],) if found.parameter.std else ()
    return _compared(
        known,
        "Torque per thrust",
        published.TORQUE_PER_THRUST_M,
        values,
        std,
        by=(found,),
        columns=("slope",),
        unit=coefficient_units(key, 2)[0],
        about="The slope of a straight line, N m of torque for N of thrust.",
    )


def _dynamics(known: Values) -> Iterator[PublishedComparison]:
    rows = (
        ("Time constant of motor and rotor", "tf.time_constant_s", "time constant"),
        ("Static gain of the transfer function", "tf.static_gain_n", "static gain"),
    )
    for place, (title, key, column) in enumerate(rows):
        others = tuple(one._replace(values=one.values[place : place + 1]) for one in published.DYNAMICS)
        others = tuple(one for one in others if one.values[0] is not None)
        found = known.find(key)
        own: tuple[Numbers, Numbers] = ((), ()) if found is None else ((found.parameter.value,), (found.parameter.std,))
        yield _compared(known, title, others, *own, by=(found,), columns=(column,), unit=unit_of(key))


def _drag(known: Values) -> tuple[PublishedComparison, PublishedComparison]:
    key = "drag.simple_kg_per_rad"
    found = known.find(key)
    frame = known.rig.vehicle.body_frame
    places = [axis_of(name)[0] for name in (frame.forward, frame.left, frame.up)]
    values = () if found is None else tuple(found.parameter.value[i] for i in places)
    std = () if found is None or not found.parameter.std else tuple(found.parameter.std[i] for i in places)
    speed_sum = _hover_speed_sum_rad_s(known)
    columns = ("forward", "left", "up")
    return (
        _compared(
            known,
            "Drag per rotor speed and velocity",
            published.DRAG_KG_PER_RAD,
            values,
            std,
            by=(found,),
            columns=columns,
            unit=unit_of(key),
            about="Force along an axis for velocity along it and the sum of the rotors' speeds.",
        ),
        _compared(
            known,
            "Drag per velocity",
            published.DRAG_KG_PER_S,
            () if speed_sum is None else tuple(value * speed_sum for value in values),
            by=(found, known.find("motor.thrust_poly"), known.find("motor.speed_poly")),
            columns=columns,
            unit="kg/s",
            about="Another model, of another unit: force for velocity alone. Yours is the one above at the rotors' "
            "speeds in hover, where mass, thrust and speed maps are known.",
        ),
    )


def _hover_speed_sum_rad_s(known: Values) -> float | None:
    """Return the sum of the four rotors' speeds in hover, None where a map is missing or does not reach hover."""
    thrust, speed = known.find("motor.thrust_poly"), known.find("motor.speed_poly")
    if thrust is None or speed is None:
        return None
    wanted_n = known.rig.vehicle.mass_kg * known.rig.site.gravity_mps2 / ROTORS
    commands = range(0, FULL_COMMAND + 1, 16)
    lacking_n = {cmd: abs(evaluate("motor.thrust_poly", thrust.parameter.value, cmd) - wanted_n) for cmd in commands}
    command = min(lacking_n, key=lambda cmd: lacking_n[cmd])
    if lacking_n[command] > _HOVERS * wanted_n:
        return None
    return ROTORS * evaluate("motor.speed_poly", speed.parameter.value, command)


def _compared(
    known: Values,
    title: str,
    others: tuple[Published, ...],
    values: Numbers = (),
    std: Numbers = (),
    *,
    by: Sequence[Quantity | None] = (),
    columns: tuple[str, ...],
    unit: str,
    about: str = "",
) -> PublishedComparison:
    """Return a comparison; `by` contains the parameters that the campaign's own values come from."""
    lines = tuple(ComparisonRow(one.who, one.vehicle, one.values, "", one.source, one.note) for one in others)
    return PublishedComparison(title, about, columns, unit, _yours(known, values, by) if values else None, std, lines)


def _yours(known: Values, values: Numbers, by: Sequence[Quantity | None], frame: str = "") -> ComparisonRow:
    rejected = dict.fromkeys(found.fit.name for found in by if found is not None and not found.accepted)
    note = f"REJECTED by its fit, and kept nevertheless ({', '.join(rejected)})" if rejected else ""
    return ComparisonRow("this campaign", known.rig.vehicle.name, values, frame, "", note)
