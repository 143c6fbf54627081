"""`cfid fit inertia`, `cfid fit testbody`: the inertia matrix from swings, and the test body against its drawing."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.flat import flat
from cfid.console.inputs import Workplace, open_workplace
from cfid.console.lists import measured
from cfid.console.options import (
    Delivery,
    GravityMps2,
    MassKg,
    Method,
    RigOptions,
    Swings,
    WindowOptions,
)
from cfid.console.outcome import deliver
from cfid.console.selection import chosen
from cfid.records.choose import labelled

if TYPE_CHECKING:
    from cfid.records.result import Result


@flat
def inertia(
    *,
    runs: Swings = None,
    window: WindowOptions,
    rig: RigOptions,
    delivery: Delivery,
    propose: Annotated[bool, typer.Option("--propose", help="Propose axes and distances for the next swings.")] = False,
    plan: Annotated[
        bool, typer.Option("--plan", hidden=True, help="Same as --propose, under its name in version 0.1.")
    ] = False,
    mass_kg: MassKg = None,
    gravity_mps2: GravityMps2 = None,
    method: Method = "default",
) -> None:
    """Fit the inertia matrix about the centre of mass to six or more swings about any axes.

    AXIS is a mount in rig.toml; fixture=FILE is a swing of the empty fixture, whose effect is subtracted;
    x=3.12e-05:4e-08 is an axis inertia already known, with its standard uncertainty.

    Example: [bold]cfid fit inertia x=x.csv y=y.csv z=z.csv xy=xy.csv xz=xz.csv yz=yz.csv[/bold]
    """
    from cfid.inertia import result

    gravity = measured(gravity_mps2, "--gravity-mps2")
    workplace = open_workplace(rig, gravity=gravity)
    mass = measured(mass_kg, "--mass-kg")
    fit = partial(
        result.fit,
        mass_kg=mass.value,
        mass_std_kg=mass.std,
        gravity_mps2=gravity.value,
        gravity_std_mps2=gravity.std,
        method=method,
        propose=propose or plan,
    )
    _fit_swings(fit, runs, body="crazyflie", window=window, workplace=workplace, delivery=delivery)


@flat
def testbody(
    *,
    runs: Swings = None,
    window: WindowOptions,
    rig: RigOptions,
    delivery: Delivery,
    mass_kg: MassKg = None,
    gravity_mps2: GravityMps2 = None,
    method: Method = "default",
) -> None:
    r"""Compare the test body's measured inertias with those calculated from its drawing (table 2.5).

    AXIS is a mount in \[testbody.mounts]; cuboids and mass come from \[testbody] in rig.toml.

    Example: [bold]cfid fit testbody x=tb_x.csv z=tb_z.csv[/bold]
    """
    from cfid.inertia import testbody_result

    gravity = measured(gravity_mps2, "--gravity-mps2")
    workplace = open_workplace(rig, gravity=gravity)
    mass = measured(mass_kg, "--mass-kg")
    fit = partial(
        testbody_result.fit_testbody,
        mass_kg=mass.value,
        mass_std_kg=mass.std,
        gravity_mps2=gravity.value,
        gravity_std_mps2=gravity.std,
        method=method,
    )
    _fit_swings(fit, runs, body="testbody", window=window, workplace=workplace, delivery=delivery)


def _fit_swings(
    fit: Callable[..., "Result"],
    runs: Sequence[str] | None,
    *,
    body: str,
    window: WindowOptions,
    workplace: Workplace,
    delivery: Delivery,
) -> None:
    from cfid.swing import arguments, data

    wanted = "swings of the test body" if body == "testbody" else "swings of the vehicle"
    suits = labelled("swing", body, data.FIXTURE)
    words = chosen(runs, workplace.campaign, suits=suits, wanted=wanted)
    found = fit(
        arguments.read_swings(words, workplace, suits),
        rig=None if workplace.borrowed else workplace.rig,
        peaks=arguments.parse_peaks(window.peaks),
        smallest_peak_rad=math.radians(window.min_angle_deg or 1.0),
    )
    deliver(replace(found, folder=workplace.figures), delivery, workplace.campaign, workplace.own_rig)
