"""Collect the quantities of a campaign or of a published set once for all exports: neither turned nor converted.

What flights give stands for inertia and drag that the rig did not measure.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from cfid.errors import ConfigError
from cfid.published import PublishedSet
from cfid.published.set_file import PublishedValue
from cfid.quantities.plausible import centre_fault, implausible
from cfid.quantities.registry import Platform, unit_of
from cfid.records.parameters import Section, Value, plain
from cfid.records.rig_file import BodyFrame, Rig
from cfid.records.stale import other_facts
from cfid.records.values import Quantity, Values
from cfid.units import FULL_COMMAND, MM, NEAR_FULL, USUAL_GRAVITY_MPS2

# What exports can use, by key. Two models of the drag give one quantity, `drag`; the simple one goes first.
EXPORTED = (
    "mass_kg",
    "arm_m",
    "inertia.matrix_kg_m2",
    "motor.thrust_poly",
    "motor.command_of_thrust",
    "motor.max_thrust_n",
    "motor.thrust_voltage_poly",
    "motor.speed_poly",
    "motor.thrust_per_speed_squared_n_s2",
    "motor.thrust_speed_poly",
    "motor.torque_poly",
    "dynamics.rising",
    "dynamics.falling",
    "tf.time_constant_s",
    "tf.delay_s",
    "drag",
    "flight.moment_per_velocity_ns.roll",
    "flight.moment_per_velocity_ns.pitch",
    "rotor_inertia_kg_m2",
    "rotor_radius_m",
)
_INERTIA = "inertia.matrix_kg_m2"
_SQUARE = "motor.thrust_per_speed_squared_n_s2"
_DRAG = ("drag.simple_kg_per_rad", "drag.cross_coupling_kg_per_rad")
_IN_EVERY_EXPORT = ("gravity_mps2", "centre_of_mass_m")
_MOMENTS_IN_FLIGHT = tuple(f"flight.inertia_kg_m2.{axis}" for axis in ("roll", "pitch", "yaw"))
_DRAG_IN_FLIGHT = tuple(f"flight.drag_kg_per_s.{axis}" for axis in ("forward", "left"))
_AT_FULL_COMMAND = ("motor.max_thrust_n", "motor.speed_poly")
_REFUSED = {
    "REJECTED": "{key} was rejected: {reason}",
    "OUTDATED": "{key} is outdated. {reason}",
    "IMPLAUSIBLE": "{reason}",
}


class Caveat(NamedTuple):
    """A warning on the use of a value: a word that marks it in files, and the reason."""

    mark: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class ExportQuantity:
    """A value with its standard uncertainty of the same shape (None if unknown), its unit and its origin.

    `commands` contains the smallest and the largest motor command of the fit, if the fit had any. `made_of` are the
    keys of the quantities of flights that it was made of, if it was.
    """

    key: str
    value: Value
    std: Value
    unit: str
    origin: str
    caveats: tuple[Caveat, ...] = ()
    commands: tuple[float, float] | None = None
    made_of: tuple[str, ...] = ()

    def is_marked(self, mark: str) -> bool:
        """Return whether a caveat has a mark."""
        return any(caveat.mark == mark for caveat in self.caveats)

    def objections(self) -> list[str]:
        """Return sentences on why the quantity should not be exported: rejected, outdated or implausible."""
        found = [caveat for mark in _REFUSED for caveat in self.caveats if caveat.mark == mark]
        return [_REFUSED[caveat.mark].format(key=self.key, reason=caveat.reason) for caveat in found]


@dataclass(frozen=True, kw_only=True)
class ExportVehicle:
    """All known quantities by key, in the body frame that rig.toml or a published set states.

    Of a campaign, mass, gravity and the centre of mass come from rig.toml, as does the arm unless it was set by hand.
    The centre of mass (3,) in m counts from the vehicle's middle, at the height of the table that the vehicle stands
    on. `partial` contains the quantities with unknown numbers. `further` contains, by kind of fit, values of the fit in
    force whose key was taken from another fit. `covariance` contains, by kind of fit, the covariances and common causes
    of the values. `measured` is the date of the latest fit, "" without fits. `published` is the set that the quantities
    come from, None for a campaign's.
    """

    name: str
    campaign: str
    measured: str
    frame: BodyFrame
    quantities: Mapping[str, ExportQuantity]
    partial: Mapping[str, ExportQuantity] = field(default_factory=dict)
    further: Mapping[str, Sequence[ExportQuantity]] = field(default_factory=dict)
    covariance: Mapping[str, Value] = field(default_factory=dict)
    published: PublishedSet | None = None

    def find(self, key: str) -> ExportQuantity | None:
        """Return a quantity of `EXPORTED`, None if it is not known."""
        return next((self.quantities[name] for name in keys_of(key) if name in self.quantities), None)

    def taken(self, needs: Sequence[str]) -> list[ExportQuantity]:
        """Return the quantities that meet needs: of each, its first choice of which all are known.

        Gravity and the centre of mass are in every export.
        """
        keys = [*_IN_EVERY_EXPORT, *(key for need in needs for key in self.met(need))]
        found = {key: self.find(key) for key in keys}
        return [quantity for quantity in found.values() if quantity is not None]

    def met(self, need: str) -> list[str]:
        """Return the keys that meet a need, none if it is not met: `a|b` is met by either, `a+b` by both."""
        choices = (choice.split("+") for choice in need.split("|"))
        return next((keys for keys in choices if all(self.find(key) for key in keys)), [])


def keys_of(key: str) -> tuple[str, ...]:
    """Return the keys under which a campaign may have a quantity of `EXPORTED`."""
    return _DRAG if key == "drag" else (key,)


def collect(rig: Rig, values: Values, *, rig_file: str = "rig.toml", campaign: str = "") -> ExportVehicle:
    """Collect what the exports need from a campaign's rig and its values.

    Raises ConfigError when the rig does not state which body axis points forward, since nothing could be turned then.
    """
    if "body_frame" not in rig.vehicle.model_fields_set:
        raise ConfigError(
            f"{rig_file}: vehicle.body_frame is missing: state which body axis points forward, left and up "
            '(the thesis: forward = "y", left = "-x", up = "z"); an export without it could be turned wrongly.'
        )
    counting = {value.key: found for value in values if (found := values.find(value.key)) is not None}
    fitted = {key: _quantity(value, rig) for key, value in counting.items()}
    known = {key: quantity for key, quantity in fitted.items() if _is_known(quantity.value)}
    stated = _stated(rig, rig_file)
    if "arm_m" in known or rig.loadcell.arm_mm is None:
        stated.pop("arm_m")
    else:  # fits that took the arm may have taken another one
        of_fits = ((name, other_facts(fit.section, rig)) for name, fit in values.in_force.items())
        other = [Caveat("OTHER RIG", f"{name}: {reason}") for name, reason in of_fits if reason]
        stated["arm_m"] = replace(stated["arm_m"], caveats=(*stated["arm_m"].caveats, *other))
    quantities = _judged(known | stated, rig.vehicle.platform)
    further = {
        name: [
            _quantity(Quantity(key=key, fit=fit, rejection=fit.section.rejected.get(key, "")), rig)
            for key in fit.section.parameters
            if key not in counting or counting[key].fit is not fit
        ]
        for name, fit in values.in_force.items()
    }
    return ExportVehicle(
        name=rig.vehicle.name,
        campaign=campaign,
        measured=max((f"{value.section.found:%Y-%m-%d}" for value in counting.values()), default=""),
        frame=rig.vehicle.body_frame,
        quantities={**quantities, **of_flights(quantities, rig.vehicle.body_frame)},
        partial={key: quantity for key, quantity in fitted.items() if key not in quantities},
        further={name: found for name, found in further.items() if found},
        covariance={name: block for name, section in values.sections().items() if (block := _dependences(section))},
    )


def collect_published(published: PublishedSet) -> ExportVehicle:
    """Collect what the exports need from a published set; what it does not state of every export is assumed."""
    assumed: dict[str, tuple[Value, str]] = {
        "gravity_mps2": (USUAL_GRAVITY_MPS2, f"not stated: {USUAL_GRAVITY_MPS2} m/s^2 is assumed"),
        "centre_of_mass_m": ([0.0, 0.0, 0.0], "not stated: the middle between the motors is assumed"),
    }
    quantities = {
        key: ExportQuantity(
            key=key,
            value=value,
            std=None,
            unit="m" if key == "centre_of_mass_m" else unit_of(key),
            origin="assumed",
            caveats=(Caveat("ASSUMED", reason),),
        )
        for key, (value, reason) in assumed.items()
    }
    for value in reversed(published.values):  # the first value of a key counts
        quantities[value.key] = _of_set(published, value)
    return ExportVehicle(
        name=published.vehicle,
        campaign="",
        measured="",
        frame=published.frame,
        quantities=_judged(quantities, published.platform),
        published=published,
    )


def with_published(vehicle: ExportVehicle, key: str, published: PublishedSet) -> ExportVehicle:
    """Return a vehicle with a set's value of a quantity, marked, which has no direction and was not measured.

    Raises ConfigError for a quantity that was measured, has a direction, or is not in the set.
    """
    value = published.find(key)
    if vehicle.find(key) is not None or key in vehicle.partial:
        raise ConfigError(f"`published` {key}: it was measured, and no published value replaces that.")
    if value is None or key not in EXPORTED:
        raise ConfigError(f"`published` {key}: {published.name} does not state it, or no export takes it.")
    if isinstance(value.value[0] if isinstance(value.value, list) else 0.0, list) or key.startswith("drag"):
        raise ConfigError(f"`published` {key}: it has directions, which are not those of this vehicle.")
    quantity = _of_set(published, value)
    taken = Caveat("PUBLISHED", f"not measured, but taken from {published.name}: {published.origin(value)}")
    quantity = replace(quantity, caveats=(taken, *quantity.caveats))
    return replace(vehicle, quantities={**vehicle.quantities, key: quantity})


def _of_set(published: PublishedSet, value: PublishedValue) -> ExportQuantity:
    """Return a set's value as a quantity, marked with what is known against it."""
    mark = "CALCULATED" if value.calculated else "REMARK"
    return ExportQuantity(
        key=value.key,
        value=value.value,
        std=value.std,
        unit=unit_of(value.key),
        origin=f"published set {published.name}: {published.origin(value)}; not measured here",
        caveats=(Caveat(mark, value.remark),) if value.remark else (),
    )


def of_flights(quantities: Mapping[str, ExportQuantity], frame: BodyFrame) -> dict[str, ExportQuantity]:
    """Return inertia and drag of flights in the body frame, for quantities in which the rig's are missing.

    Flights show neither products of inertia nor drag along z: these are zero. Drag over velocity becomes that over the
    rotors' speeds too by their speed at hovering. What has objections is not taken.
    """
    rigs = {key for key, quantity in quantities.items() if not quantity.made_of}
    sound = {key: quantity for key, quantity in quantities.items() if not quantity.objections()}
    moments = [sound[key] for key in _MOMENTS_IN_FLIGHT if key in sound]
    braking = [sound[key] for key in _DRAG_IN_FLIGHT if key in sound]
    speed_rad_s = _hover_speed_rad_s(quantities["mass_kg"], quantities["gravity_mps2"], sound.get(_SQUARE))
    made = {}
    if _INERTIA not in rigs and len(moments) == len(_MOMENTS_IN_FLIGHT):
        value, std = _in_body([of.value for of in moments], frame), _in_body([of.std for of in moments], frame)
        reason = "products of inertia were not measured and are zero"
        made[_INERTIA] = _made_of(moments, _INERTIA, _diagonal(value, 0.0), _diagonal(std, None), reason)
    if rigs.isdisjoint(_DRAG) and len(braking) == len(_DRAG_IN_FLIGHT) and speed_rad_s > 0:
        value = [*(of.value / (4 * speed_rad_s) for of in braking), 0.0]
        std = [*(of.std and of.std / (4 * speed_rad_s) for of in braking), None]
        reason = "measured in flight at hovering; drag along z was not measured and is zero"
        made[_DRAG[0]] = _made_of(braking, _DRAG[0], _in_body(value, frame), _in_body(std, frame), reason)
    return _judged(made, "other")


def _made_of(parts: Sequence[ExportQuantity], key: str, value: Value, std: Value, reason: str) -> ExportQuantity:
    caveats = [*(caveat for part in parts for caveat in part.caveats), Caveat("ASSUMED", reason)]
    return ExportQuantity(
        key=key,
        value=value,
        std=std,
        unit=unit_of(key),
        origin=" and ".join(dict.fromkeys(part.origin for part in parts)),
        caveats=tuple(dict.fromkeys(caveats)),
        made_of=tuple(part.key for part in parts),
    )


def _in_body(along: Sequence[Value], frame: BodyFrame) -> list[Value]:
    """Return numbers (3,) along forward, left and up, for which no sign matters, by axis of the body frame."""
    of_axis = {axis: number for (axis, _), number in zip(frame.axes, along, strict=True)}
    return [of_axis[axis] for axis in range(3)]


def _diagonal(numbers: Sequence[Value], others: Value) -> Value:
    return [[number if row == column else others for column in range(3)] for row, number in enumerate(numbers)]


def _hover_speed_rad_s(mass: ExportQuantity, gravity: ExportQuantity, square: ExportQuantity | None) -> float:
    """Return the rotors' speed at hovering, 0 where it is unknown or makes no sense."""
    squared = 0.0 if square is None or square.value == 0 else mass.value * gravity.value / 4 / square.value
    return math.sqrt(max(squared, 0.0))


def _stated(rig: Rig, rig_file: str) -> dict[str, ExportQuantity]:
    """Return what rig.toml states."""
    vehicle, cell, site = rig.vehicle, rig.loadcell, rig.site
    centre_std_m = [MM * length for length in vehicle.centre_of_mass_std_mm]
    arm_std_m = None if cell.arm_std_mm is None else MM * cell.arm_std_mm
    stated: dict[str, tuple[Value, Value]] = {
        "mass_kg": (vehicle.mass_kg, vehicle.mass_std_kg or None),
        "arm_m": (MM * (cell.arm_mm or 0.0), arm_std_m),
        "gravity_mps2": (site.gravity_mps2, site.gravity_std_mps2 or None),
        "centre_of_mass_m": (
            [MM * length for length in vehicle.centre_of_mass_mm],
            centre_std_m if any(centre_std_m) else None,
        ),
    }
    return {
        key: ExportQuantity(
            key=key, value=value, std=std, unit="m" if key == "centre_of_mass_m" else unit_of(key), origin=rig_file
        )
        for key, (value, std) in stated.items()
    }


def _quantity(value: Quantity, rig: Rig) -> ExportQuantity:
    key, section = value.key, value.section
    commands = _commands(section)
    recordings = dict.fromkeys(source.run or Path(source.path).name for source in section.sources)
    runs = ", ".join(recordings)
    parts = [f"section {value.fit.name}", f"method {section.method}", f"{section.found:%Y-%m-%d %H:%M} UTC"]
    caveats = [Caveat("OUTDATED", reason) for reason in value.outdated]
    if key in _AT_FULL_COMMAND and commands is not None and commands[1] < NEAR_FULL * FULL_COMMAND:
        caveats.append(Caveat("EXTRAPOLATED", f"{commands[1]:.0f} of {FULL_COMMAND} is the largest command measured"))
    if other := other_facts(section, rig):
        caveats.append(Caveat("OTHER RIG", other))
    if value.rejection:
        caveats.append(Caveat("REJECTED", value.rejection))
    if section.simulated:
        caveats.append(Caveat("SIMULATED", "no vehicle was measured"))
    return ExportQuantity(
        key=key,
        value=plain(value.parameter.value),
        std=plain(value.parameter.std),
        unit=value.parameter.unit,
        origin="; ".join([*parts, f"cfid {section.cfid_version}", *([f"from {runs}"] if runs else [])]),
        caveats=tuple(caveats),
        commands=commands,
    )


def _commands(section: Section) -> tuple[float, float] | None:
    """Return the smallest and the largest command in a section's table, or of its rotors in flight logs."""
    keys = {"motor.table": ("cmd",), "dynamics.time_constant_s": ("cmd_from", "cmd_to")}
    known = [
        command
        for key, columns in keys.items()
        if key in section.parameters
        for row in plain(section.parameters[key].value)
        for column in columns
        if (command := row.get(column)) is not None
    ]
    return (min(known), max(known)) if known else None


def _judged(quantities: Mapping[str, ExportQuantity], platform: Platform) -> dict[str, ExportQuantity]:
    """Return quantities, each marked if its value is implausible for a vehicle of a platform."""
    return {key: _marked_if_implausible(quantity, quantities, platform) for key, quantity in quantities.items()}


def _marked_if_implausible(
    quantity: ExportQuantity, quantities: Mapping[str, ExportQuantity], platform: Platform
) -> ExportQuantity:
    key = quantity.key
    if key == "centre_of_mass_m":
        arm = quantities.get("arm_m")
        fault = "" if arm is None else centre_fault(quantity.value, arm.value)
    else:
        fault = implausible(key, quantity.value, std=quantity.std, platform=platform)
    return replace(quantity, caveats=(*quantity.caveats, Caveat("IMPLAUSIBLE", fault))) if fault else quantity


def _is_known(value: Value) -> bool:
    """Return whether all numbers in nested lists and rows are known."""
    parts = list(value.values()) if isinstance(value, Mapping) else value
    return all(map(_is_known, parts)) if isinstance(parts, list) else parts is not None


def _dependences(section: Section) -> dict[str, Value]:
    """Return the covariances and common causes of a section, as far as there are any."""
    blocks = [{"of": list(block.of), "matrix": plain(block.matrix)} for block in section.covariance]
    return ({"covariance": blocks} if blocks else {}) | ({"common": plain(section.common)} if section.common else {})
