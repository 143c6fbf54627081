"""`cfid fit dynamics`: how fast rotors follow their commands, from steps."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from cfid.console.inputs import find_recording, open_workplace
from cfid.console.options import Delivery, EscUs, LoadCellOptions, ReadingOptions, RigOptions, flat, pulses_us
from cfid.console.outcome import deliver


@flat
def dynamics(
    *,
    runs: Annotated[
        list[str] | None,
        typer.Argument(metavar="FILE|RUN", help="A run with steps, or a stand's CSV file with speeds over time."),
    ] = None,
    table: Annotated[Path | None, typer.Option(help="A thrust stand's CSV file with speeds over time.")] = None,
    esc_us: EscUs = None,
    rig: RigOptions,
    reading: ReadingOptions,
    scale: LoadCellOptions,
    delivery: Delivery,
) -> None:
    """Fit a first-order lag to each step of the command, and the rotor model of four coefficients to all.

    Example: [bold]cfid fit dynamics 2026-11-21_083012_speed[/bold]
    """
    from cfid.errors import ConfigError
    from cfid.motors.steps import fit
    from cfid.motors.steps.data import of_run, of_table
    from cfid.records.tables.stand import read_stand_table
    from cfid.records.tables.times import run_at

    workplace = open_workplace(rig)
    if not runs and table is None:
        raise ConfigError("nothing to fit: give a RUN with steps, or a thrust stand's CSV file.")
    if len(runs or []) + (table is not None) > 1:
        raise ConfigError("several runs have several clocks: give one at a time.")
    path = table or find_recording((runs or [])[0], workplace)
    run = run_at(path)
    if run is not None:
        record = of_run(run, scale.reading(reading))
    else:
        stand = read_stand_table(
            path,
            rate_hz=reading.rate_hz,
            skip_lines=reading.skip_lines,
            time_unit=reading.time_unit,
            esc_us=pulses_us(esc_us),
        )
        record = of_table(stand)
    result = replace(fit(record), folder=workplace.figures_beside([record.path]))
    deliver(result, delivery, workplace.campaign, workplace.own_rig)
