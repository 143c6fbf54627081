"""Find the quantities that are exported only with --force: those rejected, outdated or implausible."""

from collections.abc import Iterator
from dataclasses import replace

from cfid.errors import DataError
from cfid.export.target import Target, taken
from cfid.export.vehicle import SOURCES, ExportQuantity, ExportVehicle
from cfid.quantities.plausible import centre_fault, implausible
from cfid.quantities.registry import Platform
from cfid.records.values import Values


def refuse_rejected(target: Target, vehicle: ExportVehicle, values: Values) -> None:
    """Raise DataError if a fit rejected a quantity that a target can express, and no other source gives it."""
    names = {name for need in (*target.needs, *target.uses) for name in need.replace("+", "|").split("|")}
    for key in sorted(key for name in names if name not in vehicle for key in SOURCES[name].keys):
        if values.find(key) is None and (reason := values.rejected(key)):
            raise DataError(f"{target.name}: nothing was written, since {key} was rejected: {reason}")


def objections(target: Target, vehicle: ExportVehicle) -> tuple[str, ...]:
    """Return sentences on why quantities of a target should not be exported."""
    against = [reason for quantity in taken(target, vehicle) for reason in _against(quantity, vehicle.platform)]
    return (*against, *filter(None, (_gravity_fault(vehicle), _centre_fault(vehicle))))


def marked(vehicle: ExportVehicle) -> ExportVehicle:
    """Return the vehicle with its implausible and rejected quantities marked, for the comments in each file."""
    quantities = {}
    for name, quantity in vehicle.quantities.items():
        marks = [
            *([f"IMPLAUSIBLE: {fault}"] if (fault := _fault(quantity, vehicle.platform)) else []),
            *([f"REJECTED: {quantity.rejection}"] if quantity.rejection else []),
        ]
        caveat = " ".join([*([quantity.caveat] if quantity.caveat else []), *marks])
        quantities[name] = replace(quantity, caveat=caveat)
    return replace(
        vehicle,
        quantities=quantities,
        gravity=_with_mark(vehicle.gravity, _gravity_fault(vehicle)),
        centre=_with_mark(vehicle.centre, _centre_fault(vehicle)),
    )


def _with_mark(quantity: ExportQuantity, fault: str) -> ExportQuantity:
    return replace(quantity, caveat=f"IMPLAUSIBLE: {fault}") if fault else quantity


def _gravity_fault(vehicle: ExportVehicle) -> str:
    return implausible(vehicle.gravity.key, vehicle.gravity.value)


def _centre_fault(vehicle: ExportVehicle) -> str:
    return centre_fault(vehicle.centre_m, vehicle["arm"]) if "arm" in vehicle else ""


def _against(quantity: ExportQuantity, platform: Platform) -> Iterator[str]:
    if quantity.rejection:
        yield f"{quantity.key} was rejected: {quantity.rejection}"
    yield from (f"{quantity.key} is outdated. {reason}" for reason in quantity.outdated)
    if fault := _fault(quantity, platform):
        yield fault


def _fault(quantity: ExportQuantity, platform: Platform) -> str:
    return implausible(quantity.key, quantity.value, std=quantity.std, platform=platform)
