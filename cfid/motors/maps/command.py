"""`cfid fit thrust`, `cfid fit speed` and `cfid fit torque`: from steady points of the motors to maps."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.inputs import Workplace, find_recording, open_workplace
from cfid.console.lists import measured, span
from cfid.console.options import (
    Figures,
    FlipFz,
    Force,
    FromS,
    Geometry,
    GravityMps2,
    Markers,
    Method,
    Out,
    ToS,
    positive,
)
from cfid.console.outcome import Delivery, deliver
from cfid.errors import ConfigError
from cfid.records.choose import labelled

if TYPE_CHECKING:
    from cfid.motors.vibration.data import Rotors
    from cfid.recordings.wrench import WrenchRecord


Words = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="FILE|COMMAND=FILE|RUN ...",
        help="Thrust stands' CSV files, load-cell files by command, or runs; default: all complete runs.",
    ),
]


Table = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Table cmd, thrust_n, ..., or a stand's CSV file."),
]
Motors = Annotated[
    int | None,
    typer.Option(metavar="N", min=1, max=4, help="Motors that ran, for files."),
]


def thrust(
    runs: Words = None,
    *,
    table: Table = None,
    motors: Motors = None,
    from_s: FromS = None,
    to_s: ToS = None,
    flip_fz: FlipFz = None,
    verify: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE|RUN",
            help="Scales to compare with: a table cmd,grams, or a run of cfid log scales; can be repeated.",
        ),
    ] = None,
    geometry: Geometry = None,
    gravity_mps2: GravityMps2 = None,
    method: Method = "default",
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Fit one motor's thrust over command, its inverse and largest thrust, and thrust over a logged voltage.

    Example: cfid fit thrust 2026-11-21_083012_thrust
    """
    from cfid.motors.maps import fit_thrust
    from cfid.motors.maps.data import Stand, read_evidence

    workplace = open_workplace(geometry, gravity=measured(gravity_mps2, "--gravity-mps2"))
    stand = Stand(motors=motors, window_s=_window(from_s, to_s), flip_fz=flip_fz)
    result = fit_thrust(
        read_evidence(runs or [], workplace, known=stand, table=table, kind="thrust", method=method),
        gravity_mps2=workplace.rig.site.gravity_mps2,
        stand=replace(stand, facts=workplace.rig.facts),
        scales=[find_recording(str(path), workplace, labelled("scales")) for path in verify or ()],
        method=method,
    )
    deliver(result, Delivery(force, figures, out), workplace)


def speed(
    runs: Words = None,
    *,
    table: Table = None,
    motors: Motors = None,
    markers: Markers = None,
    from_s: FromS = None,
    to_s: ToS = None,
    vibration: Annotated[
        bool,
        typer.Option(
            "--vibration",
            help="List one recording's speeds from vibration; fit no map.",
        ),
    ] = False,
    blades: Annotated[int, typer.Option(metavar="N", min=1, max=6, help="Blades per propeller.")] = 2,
    expect: Annotated[
        str | None,
        typer.Option(metavar="FROM,TO", help="Range of speeds to search, in rad/s."),
    ] = None,
    geometry: Geometry = None,
    method: Method = "default",
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Fit one rotor's speed over command; a tachometer's readings are divided by its markers.

    Without a tachometer, the speed is estimated from the load cell's vibration.

    Example: cfid fit speed --table rpm.csv --markers 2
    """
    from cfid.motors.maps import fit_speed
    from cfid.motors.maps.data import Stand, read_evidence
    from cfid.motors.vibration import fit as fit_vibration

    rotors = _rotors(motors if vibration else None, blades, expect)
    workplace = open_workplace(geometry)
    if vibration:
        if table is not None or markers is not None:
            raise ConfigError("--vibration reads a load cell: leave --table and --markers out.")
        result = fit_vibration(_wrench(runs, workplace), rotors=rotors, from_s=from_s, to_s=to_s)
    else:
        stand = Stand(motors=motors, markers=markers, window_s=_window(from_s, to_s))
        evidence = read_evidence(
            runs or [], workplace, known=stand, table=table, kind="speed", method=method, rotors=rotors
        )
        result = fit_speed(evidence, method=method)
    deliver(result, Delivery(force, figures, out), workplace)


def torque(
    runs: Words = None,
    *,
    table: Table = None,
    motors: Motors = None,
    from_s: FromS = None,
    to_s: ToS = None,
    flip_fz: FlipFz = None,
    geometry: Geometry = None,
    method: Method = "default",
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Fit one motor's torque over its thrust.

    Example: cfid fit torque 2026-11-21_083012_thrust
    """
    from cfid.motors.maps import fit_torque
    from cfid.motors.maps.data import Stand, read_evidence

    workplace = open_workplace(geometry)
    stand = Stand(motors=motors, window_s=_window(from_s, to_s), flip_fz=flip_fz)
    evidence = read_evidence(runs or [], workplace, known=stand, table=table, kind="torque", method=method)
    deliver(fit_torque(evidence, method=method), Delivery(force, figures, out), workplace)


def _window(from_s: float | None, to_s: float | None) -> tuple[float, float] | None:
    """Return the window to use in every file, in seconds; None for all of it. Raises ConfigError for an empty one."""
    if from_s is None and to_s is None:
        return None
    begin_s, end_s = from_s or 0.0, math.inf if to_s is None else to_s
    if begin_s >= end_s:
        raise ConfigError(f"--from {begin_s:g} --to {end_s:g}: the window is empty.")
    return begin_s, end_s


def _rotors(number: int | None, blades: int, expect: str | None) -> "Rotors":
    """Return what vibrates, in the form that fits take. Raises ConfigError for an invalid range of speeds."""
    from cfid.motors.vibration.data import Rotors

    low_high = None if expect is None else span(expect, "--expect", unit="rad/s", example="400,3500")
    if low_high is not None:
        positive(low_high[0], "--expect")
    return Rotors(number=number, blades=blades, expected_rad_per_s=low_high)


def _wrench(runs: list[str] | None, workplace: Workplace) -> "WrenchRecord":
    """Return the load cell's record of the one run given. Raises ConfigError for none or several."""
    from cfid.recordings.read import read_recording
    from cfid.recordings.wrench import LOADCELL, wrench_of

    if len(runs or ()) != 1:
        raise ConfigError("--vibration: name one run with the load cell, or one load-cell file.")
    path = find_recording((runs or [])[0], workplace, lambda run: LOADCELL in run.header.devices)
    return wrench_of(read_recording(path))
