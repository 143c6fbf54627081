"""Collect a campaign's quantities once for all exports, without turning or converting them."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from cfid.errors import ConfigError
from cfid.quantities.registry import Platform, registered, unit_of
from cfid.records.parameters import Section, Value, plain
from cfid.records.rig_file import BodyFrame, Rig, thesis_rig
from cfid.records.stale import other_facts
from cfid.records.values import Quantity, Values
from cfid.units import FULL_COMMAND, MM, NEAR_FULL

_AT_FULL_COMMAND = ("motor.max_thrust_n", "motor.speed_poly")


@dataclass(frozen=True)
class ExportSource:
    """The keys that a quantity may have; the first key found is used."""

    keys: tuple[str, ...]

    @property
    def given_by(self) -> str:
        """The way to measure the quantity."""
        return registered(self.keys[0]).given_by


SOURCES: Mapping[str, ExportSource] = {
    "mass": ExportSource(("mass_kg",)),
    "arm": ExportSource(("arm_m",)),
    "inertia": ExportSource(("inertia.matrix_kg_m2",)),
    "thrust_of_command": ExportSource(("motor.thrust_poly",)),
    "thrust_range": ExportSource(("motor.command_of_thrust",)),
    "max_thrust": ExportSource(("motor.max_thrust_n",)),
    "thrust_of_voltage": ExportSource(("motor.thrust_voltage_poly",)),
    "speed_of_command": ExportSource(("motor.speed_poly",)),
    "thrust_per_speed_squared": ExportSource(("motor.thrust_per_speed_squared_n_s2",)),
    "thrust_of_speed": ExportSource(("motor.thrust_speed_poly",)),
    "torque_of_thrust": ExportSource(("motor.torque_poly",)),
    "rising": ExportSource(("dynamics.rising",)),
    "falling": ExportSource(("dynamics.falling",)),
    "thrust_lag": ExportSource(("tf.time_constant_s",)),
    "delay": ExportSource(("tf.delay_s",)),
    "drag": ExportSource(("drag.simple_kg_per_rad", "drag.cross_coupling_kg_per_rad")),
    "rotor_inertia": ExportSource(("rotor_inertia_kg_m2",)),
    "rotor_radius": ExportSource(("rotor_radius_m",)),
}


@dataclass(frozen=True, kw_only=True)
class ExportQuantity:
    """A value with its standard uncertainty of the same shape (None if unknown), its unit and its origin.

    `rejection` states why its fit rejected it, `outdated` why its fit is no longer current; both are empty for sound
    quantities. `caveat` is a warning on the use of the value. `commands` contains the smallest and the largest motor
    command of the fit, if the fit had any. `simulated` marks a quantity from simulated recordings.
    """

    key: str
    value: Value
    std: Value
    unit: str
    origin: str
    rejection: str = ""
    outdated: tuple[str, ...] = ()
    caveat: str = ""
    commands: tuple[float, float] | None = None
    simulated: bool = False

    @property
    def accepted(self) -> bool:
        """Whether its fit accepted the quantity."""
        return not self.rejection


@dataclass(frozen=True, kw_only=True)
class ExportVehicle:
    """All known quantities, in the body frame that rig.toml states; the keys of `quantities` are those of `SOURCES`.

    `gravity` and `centre` come from rig.toml, as does the mass, and the arm unless it was set by hand. `centre` is the
    centre of mass (3,) in m from the vehicle's middle, at the height of the table that the vehicle stands on. `others`
    contains the quantities that no target uses. `further` contains, by kind of fit, values of the fit in force whose
    key was taken from another fit. `covariance` contains, by kind of fit, the covariances and common causes of the
    values. `platform` determines what is plausible.
    """

    name: str
    frame: BodyFrame
    gravity: ExportQuantity
    centre: ExportQuantity
    quantities: Mapping[str, ExportQuantity]
    others: Sequence[ExportQuantity] = ()
    further: Mapping[str, Sequence[ExportQuantity]] = field(default_factory=dict)
    covariance: Mapping[str, Value] = field(default_factory=dict)
    platform: Platform = "crazyflie"

    def __contains__(self, name: str) -> bool:
        """Return whether a quantity is known."""
        return name in self.quantities

    def __getitem__(self, name: str) -> Value:
        """Return the value of a quantity, which has to be known."""
        return self.quantities[name].value

    @property
    def gravity_mps2(self) -> float:
        """The acceleration of free fall in m/s^2."""
        return float(self.gravity.value)

    @property
    def centre_m(self) -> Sequence[float]:
        """The centre of mass (3,) in m, in the campaign's axes."""
        return list(self.centre.value)


def collect(rig: Rig, values: Values, *, rig_file: str = "rig.toml", simulated: Collection[str] = ()) -> ExportVehicle:
    """Collect what the exports need from a campaign's rig and its values.

    `simulated` contains the names of the runs that were recorded on a simulated rig.

    Raises ConfigError when the rig does not state which body axis points forward, since nothing could be turned then.
    """
    if "body_frame" not in rig.vehicle.model_fields_set:
        raise ConfigError(
            f"{rig_file}: vehicle.body_frame is missing: state which body axis points forward, left and up "
            '(the thesis: forward = "y", left = "-x", up = "z"); an export without it could be turned wrongly.'
        )
    unlike: dict[str, str] = {name: other_facts(fit.section, rig) for name, fit in values.in_force.items()}
    counting = {value.key: found for value in values if (found := values.find(value.key)) is not None}
    every = {key: _quantity(value, rig, simulated) for key, value in counting.items()}
    known = [key for key, quantity in every.items() if _known(quantity.value)]
    # of several keys the last one that is put in stays: the first one of its source
    keys = {name: key for name, source in SOURCES.items() for key in reversed(source.keys) if key in known}
    quantities = {name: every[key] for name, key in keys.items()}
    others = [quantity for key, quantity in every.items() if key not in keys.values()]
    further = {
        name: [
            _quantity(Quantity(key=key, fit=fit, rejection=fit.section.rejected.get(key, "")), rig, simulated)
            for key in fit.section.parameters
            if key not in counting or counting[key].fit is not fit
        ]
        for name, fit in values.in_force.items()
    }
    quantities["mass"] = _weighed(rig, rig_file)  # the mass is only in rig.toml
    if "arm" not in quantities and rig.loadcell.arm_mm is not None:
        arm = _arm(rig, rig.loadcell.arm_mm, rig_file)
        by_other = [f"{name}: {sentence}" for name, sentence in unlike.items() if sentence]
        quantities["arm"] = replace(arm, caveat=" ".join(filter(None, [arm.caveat, *by_other])))
    return ExportVehicle(
        name=rig.vehicle.name,
        frame=rig.vehicle.body_frame,
        gravity=_gravity(rig, rig_file),
        centre=_centre(rig, rig_file),
        quantities=quantities,
        others=others,
        further={name: found for name, found in further.items() if found},
        covariance={name: block for name, section in values.sections().items() if (block := _dependences(section))},
        platform=rig.vehicle.platform,
    )


def _weighed(rig: Rig, rig_file: str) -> ExportQuantity:
    own, preset = rig.vehicle, thesis_rig().vehicle
    unweighed = (own.mass_kg, own.mass_std_kg) == (preset.mass_kg, preset.mass_std_kg)
    return ExportQuantity(
        key="mass_kg",
        value=own.mass_kg,
        std=own.mass_std_kg or None,
        unit=unit_of("mass_kg"),
        origin=rig_file,
        caveat=f"As `cfid new` writes it, which is the thesis' vehicle: was yours weighed? ({rig_file})" * unweighed,
    )


def _arm(rig: Rig, arm_mm: float, rig_file: str) -> ExportQuantity:
    own, preset = rig.loadcell, thesis_rig().loadcell
    unmeasured = (own.arm_mm, own.arm_std_mm) == (preset.arm_mm, preset.arm_std_mm)
    return ExportQuantity(
        key="arm_m",
        value=MM * arm_mm,
        std=None if own.arm_std_mm is None else MM * own.arm_std_mm,
        unit=unit_of("arm_m"),
        origin=rig_file,
        caveat=f"As `cfid new` writes it, which is the thesis' vehicle: was yours measured? ({rig_file})" * unmeasured,
    )


def _gravity(rig: Rig, rig_file: str) -> ExportQuantity:
    site = rig.site
    return ExportQuantity(
        key="gravity_mps2",
        value=site.gravity_mps2,
        std=site.gravity_std_mps2 or None,
        unit=unit_of("gravity_mps2"),
        origin=rig_file,
    )


def _centre(rig: Rig, rig_file: str) -> ExportQuantity:
    own = rig.vehicle
    std = [MM * length for length in own.centre_of_mass_std_mm]
    return ExportQuantity(
        key="centre_of_mass_m",
        value=[MM * length for length in own.centre_of_mass_mm],
        std=std if any(std) else None,
        unit="m",
        origin=rig_file,
    )


def _dependences(section: Section) -> dict[str, Value]:
    """Return the covariances and common causes of a section, as far as there are any."""
    blocks = [{"of": list(block.of), "matrix": plain(block.matrix)} for block in section.covariance]
    return ({"covariance": blocks} if blocks else {}) | ({"common": plain(section.common)} if section.common else {})


def _quantity(value: Quantity, rig: Rig, simulated: Collection[str]) -> ExportQuantity:
    key, section, parameter = value.key, value.section, value.parameter
    commands = _commands(section)
    recordings = dict.fromkeys(source.run or Path(source.path).name for source in section.sources)
    runs = ", ".join(recordings)
    caveat = _extrapolated(commands) if key in _AT_FULL_COMMAND else ""
    parts = [f"section {value.fit.name}", f"method {section.method}", f"{section.found:%Y-%m-%d %H:%M} UTC"]
    return ExportQuantity(
        key=key,
        value=plain(parameter.value),
        std=plain(parameter.std),
        unit=parameter.unit,
        origin="; ".join([*parts, f"cfid {section.cfid_version}", *([f"from {runs}"] if runs else [])]),
        rejection=value.rejection,
        outdated=value.outdated,
        caveat=" ".join(filter(None, [caveat, *value.outdated, other_facts(section, rig)])),
        commands=commands,
        simulated=any(run in simulated for run in recordings),
    )


def _commands(section: Section) -> tuple[float, float] | None:
    """Return the smallest and the largest command in a section's table, or of its rotors in flight logs."""
    keys = {"motor.table": ("cmd",), "dynamics.time_constant_s": ("cmd_from", "cmd_to")}
    known = [
        row[column]
        for key, columns in keys.items()
        if key in section.parameters
        for row in plain(section.parameters[key].value)
        for column in columns
        if row[column] is not None
    ]
    return (min(known), max(known)) if known else None


def _extrapolated(commands: tuple[float, float] | None) -> str:
    """Return a sentence if the motors were only measured well below the full command, else ""."""
    if commands is None or commands[1] >= NEAR_FULL * FULL_COMMAND:
        return ""
    return f"EXTRAPOLATED at the full command: {commands[1]:.0f} of {FULL_COMMAND} is the largest that was measured."


def _known(value: Value) -> bool:
    return all(part is not None for part in _leaves(value))


def _leaves(value: Value) -> Iterator[object]:
    if isinstance(value, Mapping):
        for part in value.values():
            yield from _leaves(part)
    elif isinstance(value, Sequence) and not isinstance(value, str):
        for part in value:
            yield from _leaves(part)
    else:
        yield None if isinstance(value, float) and not math.isfinite(value) else value
