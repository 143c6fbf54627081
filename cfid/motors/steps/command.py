"""`cfid fit dynamics`: how fast rotors follow their commands, from steps."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from cfid.console.inputs import find_recording, open_workplace
from cfid.console.options import Delivery, LoadCellOptions, ReadingOptions, RigOptions, flat
from cfid.console.outcome import deliver


@flat
def dynamics(
    *,
    runs: Annotated[
        list[str] | None,
        typer.Argument(metavar="RUN ...", help="A run with steps: speeds reported, or in the vibration."),
    ] = None,
    table: Annotated[Path | None, typer.Option(help="A thrust stand's CSV file with speeds over time.")] = None,
    rig: RigOptions,
    reading: ReadingOptions,
    scale: LoadCellOptions,
    delivery: Delivery,
) -> None:
    """Fit a first-order lag to each step of the command, and the rotor model of four coefficients to all.

    Example: [bold]cfid fit dynamics 2026-11-21_083012_speed[/bold]
    """
    from cfid.errors import ConfigError, DataError
    from cfid.motors.steps import fit
    from cfid.motors.steps.data import of_run, of_table
    from cfid.records.tables.stand import read_stand_table
    from cfid.records.tables.times import run_at

    workplace = open_workplace(rig)
    if not runs and table is None:
        raise ConfigError("nothing to fit: give a RUN with steps, or --table FILE.")
    if len(runs or []) + (table is not None) > 1:
        raise ConfigError("several runs have several clocks: give one at a time.")
    if table is not None:
        record = of_table(read_stand_table(table, rate_hz=reading.rate_hz, skip_lines=reading.skip_lines))
    else:
        path = find_recording((runs or [])[0], workplace)
        if (run := run_at(path)) is None:
            raise DataError(f"{path}: no run folder; steps need the commands that a run has.")
        record = of_run(run, scale.reading(reading))
    result = replace(fit(record), folder=workplace.figures_beside([record.path]))
    deliver(result, delivery, workplace.campaign, workplace.own_rig)
