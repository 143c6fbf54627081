"""`cfid fit dynamics`: how fast rotors follow their commands, from steps, or from a command that never rests."""

from pathlib import Path
from typing import Annotated

import typer

from cfid.console.inputs import find_recording, open_workplace
from cfid.console.options import Figures, Force, FromS, Geometry, Out, ToS
from cfid.console.outcome import Delivery, deliver

_KINDS = ("thrust", "stand", "flight")


def dynamics(
    runs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="FILE|RUN", help="A run with steps, a flight log, or a stand's CSV file with speeds over time."
        ),
    ] = None,
    *,
    table: Annotated[Path | None, typer.Option(help="A thrust stand's CSV file with speeds over time.")] = None,
    motor: Annotated[int | None, typer.Option(min=1, max=4, help="Fit only this motor's rotor of a log.")] = None,
    from_s: FromS = None,
    to_s: ToS = None,
    geometry: Geometry = None,
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Fit how rotors follow commands: one rotor model for steps, staircases, logs and stands.

    Example: cfid fit dynamics 2026-11-21_083012_speed
    """
    from cfid.errors import ConfigError
    from cfid.motors.rotor import fit
    from cfid.recordings.stand import read_stand, stand_of

    workplace = open_workplace(geometry)
    if not runs and table is None:
        raise ConfigError("nothing to fit: give a RUN with steps, a flight log, or a thrust stand's CSV file.")
    if len(runs or []) + (table is not None) > 1:
        raise ConfigError("several runs have several clocks: give one at a time.")
    if table is not None:
        result = fit(stand_of(read_stand(table)), rotor=motor, from_s=from_s, to_s=to_s)
    else:
        path = find_recording((runs or [])[0], workplace, lambda run: run.header.kind in _KINDS)
        result = fit(path, rotor=motor, from_s=from_s, to_s=to_s)
    deliver(result, Delivery(force, figures, out), workplace)
