"""Provide `cfid fit flight`: thrust, lag, moments of inertia and drag from logs of flights."""

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.flat import flat
from cfid.console.inputs import Workplace, find_recording, open_workplace
from cfid.console.lists import Measured, measured
from cfid.console.options import CutOptions, Delivery, RigOptions
from cfid.console.outcome import deliver
from cfid.records.choose import labelled

if TYPE_CHECKING:
    from cfid.flight.values import Body

_BODY = "Vehicle and rig"


@flat
def flight(
    *,
    logs: Annotated[
        list[str] | None, typer.Argument(metavar="LOG ...", help="Flights of one vehicle: logs or runs.")
    ] = None,
    mass_kg: Annotated[
        str | None,
        typer.Option(metavar="KG[:STD]", help="Mass in flight; default: rig.toml's.", rich_help_panel=_BODY),
    ] = None,
    arm_mm: Annotated[
        str | None,
        typer.Option(
            metavar="MM[:STD]",
            help="Distance from the centre to each motor's axis, for four motors on a square; default: rig.toml's.",
            rich_help_panel=_BODY,
        ),
    ] = None,
    torque_m: Annotated[
        str | None,
        typer.Option(
            metavar="M[:STD]",
            help="Ratio of a rotor's torque to its thrust; default: the campaign's motor.torque_poly.",
            rich_help_panel=_BODY,
        ),
    ] = None,
    props_out: Annotated[
        bool,
        typer.Option(
            "--props-out",
            help="Rotors turn opposite to a Crazyflie's: the front right one clockwise, seen from above.",
            rich_help_panel=_BODY,
        ),
    ] = False,
    cut: CutOptions,
    rig: RigOptions,
    delivery: Delivery,
) -> None:
    """Fit thrust, lag, moments of inertia and drag to flight logs, as far as the flights excite them.

    Example: [bold]cfid fit flight log10.usd log15.usd --mass-kg 0.027:0.0005 --arm-mm 46:0.3[/bold]
    """
    from cfid.flight.data import read_flight
    from cfid.flight.result import fit

    workplace = open_workplace(rig)
    body = _body(
        workplace, measured(mass_kg, "--mass-kg"), measured(arm_mm, "--arm-mm"), measured(torque_m, "--torque-m")
    )
    paths = [find_recording(word, workplace, labelled("flight")) for word in logs or []]
    flights = [read_flight(path, from_s=cut.from_s, to_s=cut.to_s, props_out=props_out) for path in paths]
    result = fit(flights, body=body)
    deliver(replace(result, folder=workplace.figures), delivery, workplace.campaign, workplace.own_rig)


def _body(workplace: Workplace, mass: Measured, arm_mm: Measured, torque_m: Measured) -> "Body":
    """Return mass, arm and torque over thrust, as given, else from rig.toml and the campaign's parameters."""
    from cfid.errors import ConfigError
    from cfid.flight.values import Body
    from cfid.units import MM

    vehicle, cell = workplace.rig.vehicle, workplace.facts.loadcell
    if mass.value is None and workplace.borrowed:
        raise ConfigError("--mass-kg: is needed outside a campaign: a flight shows accelerations alone.")
    if arm_mm.value is None:
        arm_mm = Measured(cell.arm_mm, cell.arm_std_mm)
    if torque_m.value is None:
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
    """Return the slope of the campaign's torque over thrust with its standard uncertainty, where it has one."""
    key = "motor.torque_poly"
    found = None if workplace.campaign is None else workplace.campaign.values().find(key)
    if found is None or not found.accepted or len(found.parameter.value) < 2:
        return Measured(None, None)
    value, std = found.parameter.value, found.parameter.std
    return Measured(float(value[-2]), None if std is None else float(std[-2]))
