"""`cfid fit dynamics`: how fast rotors follow their commands, from steps, or from a command that never rests."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.flat import flat
from cfid.console.inputs import find_recording, open_workplace
from cfid.console.options import (
    CutOptions,
    Delivery,
    RigOptions,
)
from cfid.console.outcome import deliver

if TYPE_CHECKING:
    from cfid.motors.lag.data import RotorLog
    from cfid.recordings.stand import StandTable
    from cfid.records.run import Run


_KINDS = ("thrust", "stand", "flight")


@flat
def dynamics(
    *,
    runs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="FILE|RUN", help="A run with steps, a flight log, or a stand's CSV file with speeds over time."
        ),
    ] = None,
    table: Annotated[Path | None, typer.Option(help="A thrust stand's CSV file with speeds over time.")] = None,
    rotor: Annotated[int | None, typer.Option(min=1, max=4, help="Fit only this rotor of a log.")] = None,
    cut: CutOptions,
    rig: RigOptions,
    delivery: Delivery,
) -> None:
    """Fit how rotors follow commands: a lag to each step and one rotor model, or one lag to a flight log.

    Example: [bold]cfid fit dynamics 2026-11-21_083012_speed[/bold]
    """
    from cfid.errors import ConfigError
    from cfid.motors import lag
    from cfid.motors.lag.data import RotorLog
    from cfid.motors.steps import fit
    from cfid.motors.steps.data import of_run, of_table
    from cfid.recordings.stand import holds_stand
    from cfid.records.run import Run, run_at

    workplace = open_workplace(rig)
    if not runs and table is None:
        raise ConfigError("nothing to fit: give a RUN with steps, a flight log, or a thrust stand's CSV file.")
    if len(runs or []) + (table is not None) > 1:
        raise ConfigError("several runs have several clocks: give one at a time.")
    path = table or find_recording((runs or [])[0], workplace, lambda run: run.header.kind in _KINDS)
    is_table = table is not None or holds_stand(path)
    found = _recorded(path, None if is_table else run_at(path), is_table=is_table)
    if isinstance(found, RotorLog):
        log = found if rotor is None else found.only(rotor)
        result = lag.fit(log.between(cut.from_s, cut.to_s))
    elif rotor is not None or cut != CutOptions():
        raise ConfigError(f"{path}: --rotor, --from and --to are for commands that never rest, not for steps.")
    else:
        result = fit(of_run(found) if isinstance(found, Run) else of_table(found))
    result = replace(result, folder=workplace.figures)
    deliver(result, delivery, workplace.campaign, workplace.own_rig)


def _recorded(path: Path, run: "Run | None", *, is_table: bool) -> "RotorLog | StandTable | Run":
    """Return commands that never rest as a log, and steps as they were recorded: as a run, or as a stand's table."""
    from cfid.motors.lag.data import of_log, of_stand, rotor_log
    from cfid.recordings.read import of_run as recording_of_run
    from cfid.recordings.stand import read_stand, stand_of

    if run is not None:
        return of_log(recording_of_run(run)) if run.header.kind == "flight" else run
    log = None if is_table else rotor_log(path)
    if log is not None:
        return log
    stand = stand_of(read_stand(path))
    return of_stand(stand) or stand
