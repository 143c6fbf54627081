"""Provide `cfid fit flight`: thrust, lag, moments of inertia and drag from logs of flights."""

from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.inputs import Workplace, find_recording, open_workplace
from cfid.console.lists import Measured, measured
from cfid.console.options import Figures, Force, FromS, Geometry, Out, PropsOut, ToS
from cfid.console.outcome import Delivery, deliver
from cfid.records.choose import labelled

if TYPE_CHECKING:
    from cfid.flight.values import Body


def flight(
    logs: Annotated[
        list[str] | None, typer.Argument(metavar="LOG ...", help="Flights of one vehicle: logs or runs.")
    ] = None,
    *,
    mass_kg: Annotated[
        str | None,
        typer.Option(metavar="KG[:STD]", help="Mass in flight; default: rig.toml's."),
    ] = None,
    arm_mm: Annotated[
        str | None,
        typer.Option(
            metavar="MM[:STD]",
            help="Distance from the centre to each motor's axis, for four motors on a square; default: rig.toml's.",
        ),
    ] = None,
    props_out: PropsOut = False,
    from_s: FromS = None,
    to_s: ToS = None,
    geometry: Geometry = None,
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Fit thrust, lag, moments of inertia and drag to flight logs, as far as the flights excite them.

    Example: cfid fit flight log10.usd log15.usd --mass-kg 0.027:0.0005 --arm-mm 46:0.3
    """
    from cfid.flight.data import read_flight
    from cfid.flight.result import fit

    workplace = open_workplace(geometry)
    body = _body(workplace, measured(mass_kg, "--mass-kg"), measured(arm_mm, "--arm-mm"))
    paths = [find_recording(word, workplace, labelled("flight")) for word in logs or []]
    flights = [read_flight(path, from_s=from_s, to_s=to_s, props_out=props_out) for path in paths]
    result = fit(flights, body=body)
    deliver(result, Delivery(force, figures, out), workplace)


def _body(workplace: Workplace, mass: Measured, arm_mm: Measured) -> "Body":
    """Return mass and arm, as given, else from rig.toml, and the campaign's torque over thrust."""
    from cfid.errors import ConfigError
    from cfid.flight.values import Body
    from cfid.units import MM

    vehicle, cell = workplace.rig.vehicle, workplace.facts.loadcell
    if mass.value is None and workplace.borrowed:
        raise ConfigError("--mass-kg: is needed outside a campaign: a flight shows accelerations alone.")
    if arm_mm.value is None:
        arm_mm = Measured(cell.arm_mm, cell.arm_std_mm)
    torque_m = _torque_of(workplace)
    return Body(
        mass_kg=vehicle.mass_kg if mass.value is None else mass.value,
        mass_std_kg=(vehicle.mass_std_kg if mass.value is None else mass.std) or 0.0,
        arm_m=None if arm_mm.value is None else MM * arm_mm.value,
        arm_std_m=None if arm_mm.std is None else MM * arm_mm.std,
        torque_m=torque_m.value,
        torque_std_m=torque_m.std,
    )


def _torque_of(workplace: Workplace) -> Measured:
    """Return the slope of the campaign's torque over thrust with its uncertainty, where other than flights gave one."""
    key = "motor.torque_poly"
    found = None if workplace.campaign is None else workplace.campaign.values().find(key)
    if found is None or found.fit.name == "flight" or not found.accepted or len(found.parameter.value) < 2:
        return Measured(None, None)
    value, std = found.parameter.value, found.parameter.std
    return Measured(float(value[-2]), None if std is None else float(std[-2]))
