"""What is not exported unless it is asked for: quantities that are rejected, doubtful or implausible."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

from cfid.errors import DataError
from cfid.export.target import Target, taken
from cfid.export.vehicle import SOURCES, Quantity, Stale, Vehicle
from cfid.quantities.plausible import centre_fault, implausible
from cfid.records.parameters import Section


def refuse_rejected(target: Target, vehicle: Vehicle, sections: Mapping[str, Section]) -> None:
    """Raise DataError where a fit rejected a quantity that a target has a place for, and nothing else gave it."""
    names = {name for need in (*target.needs, *target.uses) for name in need.replace("+", "|").split("|")}
    lost = {key for name in names if name not in vehicle for key in SOURCES[name].keys}
    for section in sections.values():
        for key in sorted(lost & section.rejected.keys() - section.parameters.keys()):
            raise DataError(f"{target.name}: nothing was written, since {key} was rejected: {section.rejected[key]}")


def objections(
    target: Target, vehicle: Vehicle, sections: Mapping[str, Section], *, stale: Stale = lambda _: ()
) -> tuple[str, ...]:
    """Return why what a target takes should not be exported, a sentence each; none where nothing speaks against it."""
    against = [said for quantity in taken(target, vehicle) for said in _against(quantity, sections, stale)]
    return (*against, *filter(None, (_gravity_fault(vehicle), _centre_fault(vehicle))))


def marked(vehicle: Vehicle, sections: Mapping[str, Section]) -> Vehicle:
    """Return the vehicle with what is implausible or rejected marked so, as the comments of each file show it."""
    quantities = {}
    for name, quantity in vehicle.quantities.items():
        marks = [
            *([f"IMPLAUSIBLE: {said}"] if (said := implausible(quantity.key, quantity.value)) else []),
            *(f"REJECTED: {reason}" for reason in _rejections(quantity, sections)),
        ]
        caveat = " ".join([*([quantity.caveat] if quantity.caveat else []), *marks])
        quantities[name] = replace(quantity, caveat=caveat)
    return replace(
        vehicle,
        quantities=quantities,
        gravity=_with_mark(vehicle.gravity, _gravity_fault(vehicle)),
        centre=_with_mark(vehicle.centre, _centre_fault(vehicle)),
    )


def _with_mark(quantity: Quantity, fault: str) -> Quantity:
    return replace(quantity, caveat=f"IMPLAUSIBLE: {fault}") if fault else quantity


def _gravity_fault(vehicle: Vehicle) -> str:
    return implausible(vehicle.gravity.key, vehicle.gravity.value)


def _centre_fault(vehicle: Vehicle) -> str:
    return centre_fault(vehicle.centre_m, vehicle["arm"]) if "arm" in vehicle else ""


def _against(quantity: Quantity, sections: Mapping[str, Section], stale: Stale) -> Iterator[str]:
    yield from (f"{quantity.key} was rejected: {reason}" for reason in _rejections(quantity, sections))
    holding = [section for section in sections.values() if quantity.key in section.parameters]
    for said in dict.fromkeys(sentence for section in holding for sentence in stale(section)):
        if said in quantity.caveat:
            yield f"{quantity.key} is doubtful. {said}"
    if said := implausible(quantity.key, quantity.value):
        yield said


def _rejections(quantity: Quantity, sections: Mapping[str, Section]) -> Iterator[str]:
    for section in sections.values():
        if quantity.key in section.parameters and quantity.key in section.rejected:
            yield section.rejected[quantity.key]
