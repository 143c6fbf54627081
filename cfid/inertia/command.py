"""`cfid fit inertia`, `cfid fit testbody`: the inertia matrix from swings, and the test body against its drawing."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from cfid.console.flat import flat
from cfid.console.inputs import Workplace, open_workplace, read_recording, split_label
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
from cfid.records.choose import Matches, labelled

if TYPE_CHECKING:
    from cfid.recordings.angle import AxisRecord
    from cfid.records.result import Result
    from cfid.swing.body import KnownInertia


@flat
def inertia(
    *,
    runs: Swings = None,
    window: WindowOptions,
    rig: RigOptions,
    delivery: Delivery,
    mass_kg: MassKg = None,
    gravity_mps2: GravityMps2 = None,
    method: Method = "default",
) -> None:
    """Fit the inertia matrix about the centre of mass to six or more swings about any axes.

    AXIS is a mount in rig.toml; fixture=FILE is a swing of the empty fixture, whose effect is subtracted;
    x=3.12e-05:4e-08 is an axis inertia already known, with its standard uncertainty.

    Example: [bold]cfid fit inertia x=x.csv y=y.csv z=z.csv xy=xy.csv xz=xz.csv yz=yz.csv[/bold]
    """
    from cfid.inertia import fit

    given = {"mass_kg": mass_kg, "gravity_mps2": gravity_mps2}
    _fit_swings(fit, runs, body="crazyflie", window=window, rig=rig, delivery=delivery, method=method, **given)


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
    from cfid.inertia import fit_testbody

    given = {"mass_kg": mass_kg, "gravity_mps2": gravity_mps2}
    _fit_swings(fit_testbody, runs, body="testbody", window=window, rig=rig, delivery=delivery, method=method, **given)


def _fit_swings(
    fit: Callable[..., "Result"],
    runs: Sequence[str] | None,
    *,
    body: str,
    window: WindowOptions,
    rig: RigOptions,
    delivery: Delivery,
    mass_kg: str | None,
    gravity_mps2: str | None,
    method: str,
) -> None:
    from cfid.swing.body import FIXTURE
    from cfid.swing.command import parse_peaks

    gravity, mass = measured(gravity_mps2, "--gravity-mps2"), measured(mass_kg, "--mass-kg")
    workplace = open_workplace(rig, gravity=gravity)
    wanted = "swings of the test body" if body == "testbody" else "swings of the vehicle"
    suits = labelled("swing", body, FIXTURE)
    words = chosen(runs, workplace.campaign, suits=suits, wanted=wanted)
    result = fit(
        [_read_swing(word, workplace, suits) for word in words],
        rig=None if workplace.borrowed else workplace.rig,
        mass_kg=mass.value,
        mass_std_kg=mass.std,
        gravity_mps2=gravity.value,
        gravity_std_mps2=gravity.std,
        method=method,
        peaks=parse_peaks(window.peaks),
        smallest_peak_rad=math.radians(window.min_angle_deg or 1.0),
    )
    deliver(replace(result, folder=workplace.figures), delivery, workplace.campaign, workplace.own_rig)


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
