"""`cfid watch` shows a run in the browser while it is recorded."""

from typing import Annotated

import typer

from cfid.console.inputs import Workplace, find_recording
from cfid.console.messages import echo
from cfid.console.program import program
from cfid.records.extras import optional_library


def watch(
    run: Annotated[
        str | None,
        typer.Argument(
            metavar="RUN", help="A run folder or a run's name; default: the run being recorded, else the last run."
        ),
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; default: any free one.")] = 0,
) -> None:
    """Show a run in the browser as it is recorded, and stop its motors.

    Ctrl-C ends the command.

    Example: cfid watch
    """
    from cfid.errors import ConfigError
    from cfid.records.campaign import Campaign, find_folder
    from cfid.records.files import RIG_FILE
    from cfid.records.rig_file import thesis_rig

    folder = program().campaign or find_folder()
    if folder is None and run is None:
        raise ConfigError("there is no campaign here whose runs could be shown: name a run folder, or --campaign.")
    if folder is not None and not (folder / RIG_FILE).is_file():
        raise ConfigError(f"{folder}: has no {RIG_FILE}: name a campaign's folder.")
    optional_library("bokeh", extra="watch", what="cfid watch")
    from cfid.watch.live_run import ShownRun
    from cfid.watch.server import serve

    # The page needs no rig, so that it opens, and stops motors, also while rig.toml is invalid.
    rig = thesis_rig()
    opened = None if folder is None else Campaign(folder=folder, rig=rig)
    shown = ShownRun(
        folder=None if run is None else find_recording(run, Workplace(opened, rig, borrowed=True)),
        runs_folder=None if opened is None else opened.runs_folder,
    )
    serve(shown, campaign=folder, port=port, ready=lambda address: echo(f"{address} (Ctrl-C ends it)", err=True))
