"""A target of an export: what it needs, what it can also use, its file, and the comments at the head of every file."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from cfid.errors import DataError
from cfid.export.frame import is_turned
from cfid.export.hover import (
    hover_command,
    hover_speed_rad_s,
    hover_thrust_n,
    inertia_kg_m2,
    inertia_std_kg_m2,
    value_of,
)
from cfid.export.vehicle import SOURCES, ExportQuantity, ExportVehicle
from cfid.export.wording import commented, shown
from cfid.units import FULL_COMMAND, RPM
from cfid.version import __version__

EXCHANGE_FILE = "vehicle.json"
_SIGNED = ("tf.delay_s",)  # negative where the force is earlier than its stamped input


@dataclass(frozen=True, kw_only=True)
class Target:
    """A file that another program reads.

    `needs` and `uses` name quantities of `SOURCES`; `a|b` means either, `a+b` both. `no_place` names quantities that
    the format cannot express. `write` returns the text of the file without the comments at its head, for a vehicle that
    has all needs; a format without comments (empty `comment`) has no head. `notes` state units and meanings. A file
    that contains only scalars is not `directional` and states no frame.
    """

    name: str
    file_name: str
    about: str
    comment: str
    needs: tuple[str, ...]
    uses: tuple[str, ...] = ()
    no_place: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    directional: bool = True
    write: Callable[[ExportVehicle], str]


def has(vehicle: ExportVehicle, need: str) -> bool:
    """Return whether a quantity is known, or for `a|b` one of the two, or for `a+b` both."""
    return bool(_met(vehicle, need))


def missing(target: Target, vehicle: ExportVehicle) -> tuple[str, ...]:
    """Return the needs that a vehicle does not meet."""
    return tuple(need for need in target.needs if not has(vehicle, need))


def keys_of(need: str) -> str:
    """Return the keys of a need for a message: `a + b or c`."""
    choices = [" + ".join(SOURCES[name].keys[0] for name in choice.split("+")) for choice in need.split("|")]
    return " or ".join(choices)


def given_by(need: str) -> str:
    """Return the commands that determine the quantities of a need, each once."""
    return " or ".join(dict.fromkeys(SOURCES[name].given_by for name in _names(need)))


def need_text(need: str) -> str:
    """Return the keys of a need and the commands that determine them."""
    return f"{keys_of(need)} ({given_by(need)})"


def text_of(target: Target, vehicle: ExportVehicle) -> str:
    """Return the whole file of a target.

    Raises DataError when a quantity that the target needs was not measured.
    """
    lacking = missing(target, vehicle)
    if lacking:
        needs = "; ".join(need_text(need) for need in lacking)
        raise DataError(f"{target.name} needs what is not measured yet: {needs}.")
    _refuse_senseless(target, vehicle)
    body = target.write(vehicle)
    if not target.comment:
        return body
    head = commented(_heading(target, vehicle), target.comment)
    if body.startswith(("<?xml", "#!", "#VRML")):  # such a line must stay first
        declaration, _, rest = body.partition("\n")
        return f"{declaration}\n{head}{rest}"
    return head + body


def _refuse_senseless(target: Target, vehicle: ExportVehicle) -> None:
    """Raise DataError for divisors and sizes that are not above zero, which --force may have kept."""
    for quantity in taken(target, vehicle):
        if isinstance(quantity.value, int | float) and quantity.value <= 0 and quantity.key not in _SIGNED:
            raise DataError(f"{quantity.key} is {shown(quantity.value)}, and {target.name} needs it above zero.")


def unaccepted(target: Target, vehicle: ExportVehicle) -> tuple[str, ...]:
    """Return the keys of a target's quantities that their fit rejected."""
    return tuple(q.key for q in taken(target, vehicle) if not q.accepted)


def caveats(target: Target, vehicle: ExportVehicle) -> tuple[str, ...]:
    """Return the caveats of a target's quantities, one sentence each."""
    known = [f"{q.key}: {q.caveat}" for q in (*taken(target, vehicle), *_marked_in_rig(vehicle)) if q.caveat]
    return (*known, *(line.strip() for line in _hovering(vehicle) if "EXTRAPOLATED" in line))


def simulated(target: Target, vehicle: ExportVehicle) -> tuple[str, ...]:
    """Return the keys of a target's quantities that were measured on a simulated rig."""
    return tuple(q.key for q in taken(target, vehicle) if q.simulated)


def left_out(target: Target, vehicle: ExportVehicle) -> tuple[str, ...]:
    """Return what a target could use but the vehicle lacks."""
    return tuple(use for use in target.uses if not has(vehicle, use))


def _heading(target: Target, vehicle: ExportVehicle) -> Iterator[str]:
    yield f"{target.about} of {vehicle.name}, written by cfid {__version__}."
    if simulated(target, vehicle):
        yield "WARNING: made of SIMULATED recordings: quantities marked so below are not of a vehicle."
    yield ""
    if target.directional:
        yield from _frame(vehicle)
        yield from _inertia(target, vehicle)
    else:
        yield "Nothing here has a direction, so nothing was turned."
    yield ""
    yield "Measured, with standard uncertainty after +- , in the body frame of the campaign (not turned):"
    for quantity in (*taken(target, vehicle), *_marked_in_rig(vehicle)):
        yield from _measured(quantity)
    yield from _hovering(vehicle)
    lacking = left_out(target, vehicle)
    if lacking:
        yield "NOT MEASURED, and left out or marked below:"
        yield from (f"  {need_text(use)}" for use in lacking)
    yield from _no_place(target, vehicle)
    yield f"{EXCHANGE_FILE} (`cfid export json`) has every quantity with its uncertainty and covariance as numbers."
    if target.notes:
        yield ""
        yield from target.notes


def _marked_in_rig(vehicle: ExportVehicle) -> Sequence[ExportQuantity]:
    """Return gravity and the centre of mass, if they need a comment."""
    return [quantity for quantity in (vehicle.gravity, vehicle.centre) if quantity.caveat]


def _no_place(target: Target, vehicle: ExportVehicle) -> Iterator[str]:
    """Yield the measured quantities that this format cannot express."""
    keys = [vehicle.quantities[name].key for name in target.no_place if name in vehicle]
    if keys:
        yield "Measured, but this format has no place for:"
        yield from (f"  {key}" for key in keys)


def _frame(vehicle: ExportVehicle) -> Iterator[str]:
    frame = vehicle.frame
    yield "Frame: x forward, y left, z up; origin in the centre of mass; inertia entries are the matrix' own."
    yield f"The campaign's body frame has forward = {frame.forward}, left = {frame.left}, up = {frame.up}."
    if is_turned(frame):
        axes = [frame.turned(axis) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
        matrix = [[axis[row] for axis in axes] for row in range(3)]
        yield f"Turned from it by R = {shown(matrix)}: R v for vectors, R I R^T for the inertia."
    else:
        yield "It is the same frame, so nothing was turned."
    yield "Motors m1 to m4 are in front right, behind right, behind left, in front left; seen from above m1 and m3 turn"
    yield "counter-clockwise, as a Crazyflie has them."
    yield "WARNING: the thesis' numbers that many projects copied (16.57e-6 as Ixx, 16.66e-6 as Iyy) were never turned."
    yield "Its x is the pitch axis: with x forward, Ixx and Iyy change places, Ixz and Iyz too, and signs change."


def _inertia(target: Target, vehicle: ExportVehicle) -> Iterator[str]:
    if "inertia" in vehicle and "inertia" in (*target.needs, *target.uses):
        yield f"Inertia in this file's frame: {shown(inertia_kg_m2(vehicle))} kg m^2"
        std = inertia_std_kg_m2(vehicle)
        yield f"  +- {shown(std, 2)}" if std else "  +- unknown"


def _hovering(vehicle: ExportVehicle) -> Iterator[str]:
    """Yield command and rotor speed of hovering, to check a simulation; the speed comes from two maps if known."""
    if not has(vehicle, "thrust_of_command"):
        return
    try:
        command = hover_command(vehicle)
    except DataError as error:
        yield f"WARNING: {error}"
        return
    share = f"command {command:.0f} of {FULL_COMMAND}"
    yield f"It hovers at {hover_thrust_n(vehicle):.4g} N per motor, {share}."
    measured = vehicle.quantities["thrust_of_command"].commands
    if measured is not None and not measured[0] <= command <= measured[1]:
        yield f"  EXTRAPOLATED: hovering's command {command:.0f}; {measured[0]:.0f} to {measured[1]:.0f} were measured."
    if "speed_of_command" in vehicle:
        speed = value_of(vehicle["speed_of_command"], command)
        yield f"  rotor speed {speed:.1f} rad/s ({speed / RPM:.0f} rpm) by motor.speed_poly at that command"
    if "thrust_per_speed_squared" in vehicle:
        speed = hover_speed_rad_s(vehicle)
        yield f"  rotor speed {speed:.1f} rad/s ({speed / RPM:.0f} rpm) by motor.thrust_per_speed_squared_n_s2"


def _measured(quantity: ExportQuantity) -> Iterator[str]:
    spread = "unknown" if quantity.std is None else shown(quantity.std, 2)
    yield f"  {quantity.key} = {shown(quantity.value)} +- {spread} {quantity.unit}"
    yield f"    {quantity.origin}"
    if quantity.caveat:
        yield f"    {quantity.caveat}"
    if quantity.simulated:
        yield "    SIMULATED: no vehicle was measured."
    if not quantity.accepted:
        yield "    REJECTED by its fit, and kept nevertheless."


def taken(target: Target, vehicle: ExportVehicle) -> Sequence[ExportQuantity]:
    """Return the quantities that a target's file contains."""
    names = dict.fromkeys(name for need in (*target.needs, *target.uses) for name in _met(vehicle, need))
    return [vehicle.quantities[name] for name in names]


def _met(vehicle: ExportVehicle, need: str) -> Sequence[str]:
    """Return the quantities that meet a need: those of its first choice of which all are known."""
    choices = (choice.split("+") for choice in need.split("|"))
    return next((names for names in choices if all(name in vehicle for name in names)), [])


def _names(need: str) -> list[str]:
    return need.replace("+", "|").split("|")
