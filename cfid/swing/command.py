"""Provide `cfid fit swing`: a natural frequency from one swing, and with mass and distance, an axis inertia."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from cfid.console.inputs import open_workplace, read_recording
from cfid.console.lists import measured
from cfid.console.options import (
    Figures,
    Force,
    FromS,
    Geometry,
    GravityMps2,
    MassKg,
    Method,
    MinAngleDeg,
    Out,
    Peaks,
    ToS,
    parse_peaks,
)
from cfid.console.outcome import Delivery, deliver
from cfid.records.choose import labelled


def swing(
    run: Annotated[str, typer.Argument(metavar="RUN", help="A run folder, a run's name, or a CSV file.")],
    *,
    peaks: Peaks = None,
    min_angle_deg: MinAngleDeg = None,
    from_s: FromS = None,
    to_s: ToS = None,
    geometry: Geometry = None,
    axis: Annotated[
        str | None, typer.Option(help="Mount about which the body swung; default: the run's label.")
    ] = None,
    distance_m: Annotated[
        str | None, typer.Option(metavar="M[:STD]", help="Distance from the axis to the centre of mass.")
    ] = None,
    mass_kg: MassKg = None,
    gravity_mps2: GravityMps2 = None,
    method: Method = "default",
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Fit the nonlinear equation of a pendulum to one swing, with the damping that the data support.

    Without mass and distance (from options, or from a mount in rig.toml), the fit gives only the natural frequency.

    Example: cfid fit swing x.csv --mass-kg 0.028 --distance-m 0.022855
    """
    from cfid.swing import result

    gravity = measured(gravity_mps2, "--gravity-mps2")
    workplace = open_workplace(geometry, gravity=gravity)
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
        peaks=parse_peaks(peaks),
        smallest_peak_rad=math.radians(min_angle_deg or 1.0),
        from_s=from_s,
        to_s=to_s,
        method=method,
    )
    folder = None if workplace.campaign is None else Path(fit.sources[0].path).parent
    deliver(replace(fit, folder=folder), Delivery(force, figures, out), workplace)
