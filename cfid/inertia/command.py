"""`cfid fit inertia`, `cfid fit testbody`: the inertia matrix from swings, and the test body against its drawing."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from cfid.console.inputs import Workplace, open_workplace, read_recording, split_label
from cfid.console.lists import Measured, measured
from cfid.console.options import (
    Figures,
    Force,
    Geometry,
    GravityMps2,
    MassKg,
    Method,
    MinAngleDeg,
    Out,
    Peaks,
    Swings,
    parse_peaks,
)
from cfid.console.outcome import Delivery, deliver
from cfid.console.selection import chosen
from cfid.records.choose import Matches, labelled

if TYPE_CHECKING:
    from cfid.recordings.angle import AxisRecord
    from cfid.swing.body import KnownInertia


def inertia(
    runs: Swings = None,
    *,
    peaks: Peaks = None,
    min_angle_deg: MinAngleDeg = None,
    geometry: Geometry = None,
    mass_kg: MassKg = None,
    gravity_mps2: GravityMps2 = None,
    method: Method = "default",
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Fit the inertia matrix about the centre of mass to six or more swings about any axes.

    AXIS is a mount in rig.toml; fixture=FILE is a swing of the empty fixture, whose effect is subtracted;
    x=3.12e-05:4e-08 is an axis inertia already known, with its standard uncertainty.

    Example: cfid fit inertia x=x.csv y=y.csv z=z.csv xy=xy.csv xz=xz.csv yz=yz.csv
    """
    from cfid.inertia import fit

    gravity = measured(gravity_mps2, "--gravity-mps2")
    workplace = open_workplace(geometry, gravity=gravity)
    result = fit(
        _read_swings(runs, workplace, body="crazyflie"),
        **_rig_of(workplace, gravity, measured(mass_kg, "--mass-kg")),
        method=method,
        peaks=parse_peaks(peaks),
        smallest_peak_rad=math.radians(min_angle_deg or 1.0),
    )
    deliver(result, Delivery(force, figures, out), workplace)


def testbody(
    runs: Swings = None,
    *,
    peaks: Peaks = None,
    min_angle_deg: MinAngleDeg = None,
    geometry: Geometry = None,
    mass_kg: MassKg = None,
    gravity_mps2: GravityMps2 = None,
    method: Method = "default",
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Compare the test body's measured inertias with those calculated from its drawing (table 2.5).

    AXIS is a mount in [testbody.mounts]; cuboids and mass come from [testbody] in rig.toml.

    Example: cfid fit testbody x=tb_x.csv z=tb_z.csv
    """
    from cfid.inertia import fit_testbody

    gravity = measured(gravity_mps2, "--gravity-mps2")
    workplace = open_workplace(geometry, gravity=gravity)
    result = fit_testbody(
        _read_swings(runs, workplace, body="testbody"),
        **_rig_of(workplace, gravity, measured(mass_kg, "--mass-kg")),
        method=method,
        peaks=parse_peaks(peaks),
        smallest_peak_rad=math.radians(min_angle_deg or 1.0),
    )
    deliver(result, Delivery(force, figures, out), workplace)


def _read_swings(runs: Sequence[str] | None, workplace: Workplace, *, body: str) -> "list[AxisRecord | KnownInertia]":
    from cfid.swing.body import FIXTURE

    wanted = "swings of the test body" if body == "testbody" else "swings of the vehicle"
    suits = labelled("swing", body, FIXTURE)
    return [
        _read_swing(word, workplace, suits) for word in chosen(runs, workplace.campaign, suits=suits, wanted=wanted)
    ]


def _rig_of(workplace: Workplace, gravity: Measured, mass: Measured) -> dict[str, Any]:
    """Return the rig of a fit, and the mass and gravity that replace its own."""
    return {
        "rig": None if workplace.borrowed else workplace.rig,
        "mass_kg": mass.value,
        "mass_std_kg": mass.std,
        "gravity_mps2": gravity.value,
        "gravity_std_mps2": gravity.std,
    }


def _read_swing(word: str, workplace: Workplace, suits: Matches) -> "AxisRecord | KnownInertia":
    """Read AXIS=FILE, AXIS=NUMBER, AXIS=NUMBER:STD, fixture=FILE, or a RUN whose label has the axis.

    `suits` describes the runs among which `last` is. Raises ConfigError for numbers that are not an inertia.
    """
    from cfid.recordings.angle import labelled as with_label
    from cfid.swing.body import FIXTURE, KnownInertia

    label, rest = split_label(word, workplace)
    value, colon, std = rest.partition(":")
    try:
        numbers = float(value), float(std) if colon else 0.0
    except ValueError:
        numbers = None
    if label and numbers:
        return KnownInertia(label, *numbers)
    record = read_recording(rest, workplace, suits)
    if label == FIXTURE:
        return with_label(record, body=FIXTURE)
    return with_label(record, axis=label) if label else record
