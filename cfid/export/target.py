"""A target of an export: a template whose head states what it needs, uses and is, and which vehicles it refuses.

A head is TOML in the first comment of the template.
"""

import tomllib
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, StringConstraints, ValidationError

from cfid.errors import ConfigError, DataError
from cfid.export.derived import Derived
from cfid.export.vehicle import EXPORTED, Caveat, ExportQuantity, ExportVehicle, keys_of
from cfid.quantities.registry import find, registered
from cfid.records.files import first_fault
from cfid.records.values import Values

TORQUE = "motor.torque_poly"
_BORROWED = " `published` torque takes the torque over thrust that others state for such a vehicle, and marks it."
FOLDER = "exports"  # in a campaign's folder: exported files, and templates of its own
_SIGNED = (  # negative where the force is earlier than its stamped input, or where a moment points against its axis
    "tf.delay_s", "flight.moment_per_velocity_ns.roll", "flight.moment_per_velocity_ns.pitch",
)  # fmt: skip
_MARKS = (  # the worst first
    "REJECTED", "IMPLAUSIBLE", "OUTDATED", "SIMULATED", "PUBLISHED",
    "NO HOVERING", "EXTRAPOLATED", "OTHER RIG", "ASSUMED", "CALCULATED", "REMARK",
)  # fmt: skip


def _registered(need: str) -> str:
    for key in atoms(need):
        if key not in EXPORTED and find(key) is None:
            raise ValueError(f"there is no quantity {key}")
    return need


Need = Annotated[str, AfterValidator(_registered)]


class Target(BaseModel, frozen=True, extra="forbid"):
    """A file that another program reads.

    `needs` and `uses` are keys of quantities; `a|b` means either, `a+b` both. A file without directions has no frame,
    one whose format has no comments an empty `comment` and no head. `note` states how the file is used. `own` marks a
    template of a campaign, which may be written by others.
    """

    name: str
    about: Annotated[str, StringConstraints(max_length=80)]
    file_name: Annotated[str, StringConstraints(pattern=r"^\w[\w.-]{0,99}$")]
    comment: Literal["#", "//", "--", ";", "%", "<!--", ""] = "#"
    frame: Literal["forward-left-up", "none"] = "forward-left-up"
    needs: tuple[Need, ...]
    uses: tuple[Need, ...] = ()
    note: Annotated[str, StringConstraints(max_length=200)] = ""
    template: str
    own: bool = False

    @property
    def keys(self) -> dict[str, None]:
        """The keys of all quantities that it can express, without repetition."""
        return dict.fromkeys(key for need in (*self.needs, *self.uses) for key in atoms(need))

    def missing(self, vehicle: ExportVehicle) -> list[str]:
        """Return the needs that a vehicle does not meet."""
        return [need for need in self.needs if not vehicle.met(need)]

    def not_measured(self, vehicle: ExportVehicle) -> list[str]:
        """Return what it could use but the vehicle lacks."""
        return [use for use in self.uses if not vehicle.met(use)]

    def no_place(self, vehicle: ExportVehicle) -> list[str]:
        """Return the keys of the vehicle's quantities that its format cannot express."""
        quantities = (vehicle.find(key) for key in EXPORTED if key not in self.keys)
        return [quantity.key for quantity in quantities if quantity is not None]

    def taken(self, vehicle: ExportVehicle) -> list[ExportQuantity]:
        """Return the quantities that its file contains."""
        return vehicle.taken((*self.needs, *self.uses))


def atoms(need: str) -> list[str]:
    """Return the keys in a need."""
    return need.replace("+", "|").split("|")


def targets(campaign: Path) -> tuple[dict[str, Target], list[ConfigError]]:
    """Return all targets by name, with those of the campaign's own templates, and the faults of invalid templates."""
    found, faults = dict(_shipped()), list[ConfigError]()
    for path in sorted(path for path in (campaign / FOLDER).glob("*.j2") if path.is_file()):
        try:
            found[path.stem] = _own(path)
        except ConfigError as fault:
            faults.append(fault)
    return found, faults


def target_named(name: str, campaign: Path) -> Target:
    """Return a target. Raises ConfigError for an unknown name, and for an invalid template of the campaign."""
    if name in _shipped():
        return _shipped()[name]
    path = campaign / FOLDER / f"{name}.j2"
    if name != path.stem or not path.is_file():
        raise ConfigError(
            f"export {name}: no such target. There are {', '.join(_shipped())}, and templates {FOLDER}/NAME.j2 of a "
            "campaign; `cfid export list` shows what each needs."
        )
    return _own(path)


@cache
def _shipped() -> dict[str, Target]:
    templates = [path for path in files("cfid.export").joinpath("targets").iterdir() if not path.name.startswith("_")]
    found = [_target(path.name.removesuffix(".j2"), path.read_text(encoding="utf-8")) for path in templates]
    return {target.name: target for target in sorted(found, key=lambda target: target.name)}


def _own(path: Path) -> Target:
    if path.stem in _shipped():
        raise ConfigError(f"{path}: cfid has a target {path.stem}: give the template another name.")
    try:
        target = _target(path.stem, path.read_text(encoding="utf-8"), own=True)
    except ValidationError as error:
        raise ConfigError(f"{path}: head: {first_fault(error, {})}") from None
    except (OSError, ValueError, RecursionError) as error:  # text that is no UTF-8 or no TOML, too
        reason = str(error).rstrip(".")
        raise ConfigError(f"{path}: no template with a head, which is TOML between {{# and #}}: {reason}.") from None
    if target.file_name.endswith(".j2") or target.file_name in {shipped.file_name for shipped in _shipped().values()}:
        raise ConfigError(f"{path}: head: file_name: {target.file_name} is the name of another file of {FOLDER}.")
    return target


def _target(name: str, text: str, *, own: bool = False) -> Target:
    head = tomllib.loads(text.removeprefix("{#").partition("#}")[0])
    return Target.model_validate({**head, "name": name, "template": text, "own": own})


def need_text(need: str, vehicle: ExportVehicle) -> str:
    """Return the keys of a need and, for a campaign, the commands that determine them."""
    return need_keys(need) if vehicle.published else f"{need_keys(need)} ({given_by(need)})"


def need_keys(need: str) -> str:
    """Return the keys of a need for a message: `a + b or c`."""
    choices = [" + ".join(keys_of(key)[0] for key in choice.split("+")) for choice in need.split("|")]
    return " or ".join(choices)


def given_by(need: str) -> str:
    """Return the commands that determine the quantities of a need, each once."""
    return " or ".join(dict.fromkeys(registered(keys_of(key)[0]).given_by for key in atoms(need)))


def check_sense(target: Target, vehicle: ExportVehicle) -> None:
    """Raise DataError for needs that are not met, and for divisors and sizes that are not above zero."""
    if lacking := target.missing(vehicle):
        lack = f"the set {vehicle.published.name} does not state" if vehicle.published else "is not measured yet"
        needs = "; ".join(need_text(need, vehicle) for need in lacking)
        remedy = "" if vehicle.published or TORQUE not in lacking else _BORROWED
        raise DataError(f"{target.name} needs what {lack}: {needs}.{remedy}")
    for quantity in target.taken(vehicle):
        if isinstance(quantity.value, int | float) and quantity.value <= 0 and quantity.key not in _SIGNED:
            raise DataError(f"{quantity.key} is {quantity.value:.7g}, and {target.name} needs it above zero.")


def refuse(target: Target, vehicle: ExportVehicle, values: Values | None, *, force: bool = False) -> None:
    """Raise DataError for quantities that should not be exported; with `force`, these are exported and marked.

    A quantity that a fit rejected, and that no other source gives, is refused in any case; `values` are the campaign's,
    None for a published set.
    """
    lacking = [name for key in target.keys if vehicle.find(key) is None for name in keys_of(key)]
    for key in sorted(lacking):
        if values is not None and values.find(key) is None and (reason := values.rejected(key)):
            raise DataError(f"{target.name}: nothing was written, since {key} was rejected: {reason}")
    objections = [sentence for quantity in target.taken(vehicle) for sentence in quantity.objections()]
    if objections and not force:
        raise DataError(
            f"{target.name}: nothing was written. {' '.join(objections)} Use `force` to write it anyway, marked."
        )


def caveats(target: Target, vehicle: ExportVehicle) -> dict[Caveat, Sequence[str]]:
    """Return the caveats of a target's quantities and of hovering, the worst first, each with the keys it is of."""
    found: dict[Caveat, list[str]] = {}
    for quantity in target.taken(vehicle):
        for caveat in quantity.caveats:
            found.setdefault(caveat, []).append(quantity.key)
    if (thrust := vehicle.find("motor.thrust_poly")) is not None:
        try:
            command = Derived(vehicle).hover_command
        except DataError as error:
            found[Caveat("NO HOVERING", str(error))] = [thrust.key]
        else:
            low, high = thrust.commands or (command, command)
            if not low <= command <= high:
                reason = f"hovering's command is {command:.0f}, and {low:.0f} to {high:.0f} were measured"
                found[Caveat("EXTRAPOLATED", reason)] = ["hovering"]
    return {caveat: found[caveat] for mark in _MARKS for caveat in found if caveat.mark == mark}


def warnings(target: Target, vehicle: ExportVehicle) -> list[str]:
    """Return a sentence for each caveat."""
    found = caveats(target, vehicle)
    return [f"{caveat.mark}: {', '.join(keys)}: {caveat.reason.rstrip('.')}." for caveat, keys in found.items()]
