"""`cfid fit inertia`: six swings or more to the inertia matrix."""

from typing import Annotated

import typer

from cfid.console.inputs import open_workplace
from cfid.console.options import (
    Delivery,
    GravityMps2,
    MassKg,
    Method,
    ReadingOptions,
    RigOptions,
    Swings,
    WindowOptions,
    flat,
)
from cfid.console.outcome import deliver
from cfid.console.selection import chosen, labelled
from cfid.swing.data import FIXTURE, check_mounts, read_swings


@flat
def inertia(
    *,
    runs: Swings = None,
    window: WindowOptions,
    rig: RigOptions,
    reading: ReadingOptions,
    delivery: Delivery,
    plan: Annotated[bool, typer.Option("--plan", help="Propose axes and distances for the next swings.")] = False,
    mass_kg: MassKg = None,
    gravity_mps2: GravityMps2 = None,
    method: Method = "default",
) -> None:
    """Fit the inertia matrix about the centre of mass to six or more swings about any axes.

    AXIS is a mount of rig.toml; fixture=FILE is a swing of the empty fixture, which is taken off;
    x=3.12e-05:4e-08 is an axis inertia already known, with its standard deviation.

    Example: [bold]cfid fit inertia x=x.csv y=y.csv z=z.csv xy=xy.csv xz=xz.csv yz=yz.csv --time-unit us[/bold]
    """
    from cfid.inertia.result import inertia_outcome
    from cfid.inertia.swings import measure_all
    from cfid.swing.axis_inertias import AxisInertias
    from cfid.swing.geometry import surroundings, vehicle

    workplace = open_workplace(rig, gravity_mps2=gravity_mps2)
    suits = labelled("swing", "crazyflie", FIXTURE)
    words = chosen(runs, workplace.campaign, suits=suits, wanted="swings of the vehicle")
    items = read_swings(words, reading.reading(), workplace, body="crazyflie")
    body = vehicle(workplace, mass_kg)
    check_mounts((item.name for item in items if item.name != FIXTURE), body.mounts, table="mounts")
    swings = measure_all(items, window, method)
    axis_inertias = AxisInertias(swings.mounted, body, surroundings(workplace, swings.fixture))
    outcome = inertia_outcome(axis_inertias, swings, workplace, method=method, plan=plan)
    deliver(outcome, delivery, workplace.campaign)
