"""Provide `cfid fit swing`: a natural frequency from one swing, and with mass and distance, an axis inertia."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from cfid.console.flat import flat
from cfid.console.inputs import open_workplace, read_recording
from cfid.console.lists import measured
from cfid.console.options import (
    CutOptions,
    Delivery,
    GravityMps2,
    MassKg,
    Method,
    RigOptions,
    WindowOptions,
)
from cfid.console.outcome import deliver
from cfid.errors import ConfigError
from cfid.records.choose import labelled


@flat
def swing(
    *,
    run: Annotated[str, typer.Argument(metavar="RUN", help="A run folder, a run's name, or a CSV file.")],
    window: WindowOptions,
    cut: CutOptions,
    rig: RigOptions,
    delivery: Delivery,
    axis: Annotated[
        str | None, typer.Option(help="Mount about which the body swung; default: the run's label.")
    ] = None,
    distance_m: Annotated[
        str | None, typer.Option(metavar="M[:STD]", help="Distance from the axis to the centre of mass.")
    ] = None,
    mass_kg: MassKg = None,
    gravity_mps2: GravityMps2 = None,
    method: Method = "default",
) -> None:
    """Fit the nonlinear equation of a pendulum to one swing, with the damping that the data support.

    Without mass and distance (from options, or from a mount in rig.toml), the fit gives only the natural frequency.

    Example: [bold]cfid fit swing x.csv --mass-kg 0.028 --distance-m 0.022855[/bold]
    """
    from cfid.swing import result

    gravity = measured(gravity_mps2, "--gravity-mps2")
    workplace = open_workplace(rig, gravity=gravity)
    mass, distance = measured(mass_kg, "--mass-kg"), measured(distance_m, "--distance-m")
    fit = result.fit(
        read_recording(run, workplace, labelled("swing")),
        axis=axis,
        rig=None if workplace.borrowed else workplace.rig,
        mass_kg=mass.value,
        mass_std_kg=mass.std,
        distance_m=distance.value,
        distance_std_m=distance.std,
        gravity_mps2=gravity.value,
        gravity_std_mps2=gravity.std,
        peaks=parse_peaks(window.peaks),
        smallest_peak_rad=math.radians(window.min_angle_deg or 1.0),
        from_s=cut.from_s,
        to_s=cut.to_s,
        method=method,
    )
    folder = None if workplace.campaign is None else Path(fit.sources[0].path).parent
    deliver(replace(fit, folder=folder), delivery, workplace.campaign, workplace.own_rig)


def parse_peaks(text: str | None) -> int | dict[str, int] | None:
    """Return the number of peaks for all axes, or for each: one number, or `x=11,z=16`.

    Raises ConfigError when it is neither.
    """
    if text is None:
        return None
    try:
        if "=" not in text:
            return int(text)
        pairs = (part.split("=") for part in text.split(","))
        return {axis.strip(): int(count) for axis, count in pairs}
    except ValueError:
        raise ConfigError(f"`peaks` {text}: expected a number, or AXIS=NUMBER,AXIS=NUMBER,...") from None
