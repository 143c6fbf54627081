"""`cfid watch` shows a run in the browser while it is recorded."""

from pathlib import Path
from typing import Annotated

import typer

from cfid.console.inputs import Workplace, find_recording
from cfid.console.messages import echo, note
from cfid.records.extras import optional_library


def watch(
    run: Annotated[
        str | None,
        typer.Argument(
            metavar="RUN", help="A run folder or a run's name; default: the run being recorded, else the last run."
        ),
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; default: any free one.")] = 0,
    browser: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    campaign: Annotated[
        Path | None, typer.Option(help="Campaign folder; default: the current folder or a parent.")
    ] = None,
) -> None:
    """Show a run in the browser while it is recorded, with a button that stops all motors; Ctrl-C ends the command.

    Example: [bold]cfid watch --open[/bold]
    """
    from cfid.errors import ConfigError
    from cfid.records.campaign import Campaign, find_campaign, find_folder
    from cfid.records.files import RIG_FILE
    from cfid.records.rig_file import thesis_rig

    try:
        found = find_campaign(campaign)
    except ConfigError as error:
        folder = find_folder() if campaign is None else campaign
        if folder is None or not (folder / RIG_FILE).is_file():
            raise
        note(f"{error} The page needs no valid rig.toml.")
        found = Campaign(folder=folder, rig=thesis_rig())
    if run is None and found is None:
        raise ConfigError("there is no campaign here whose runs could be shown: name a run folder, or --campaign.")
    optional_library("bokeh", extra="watch", what="cfid watch")
    from cfid.watch.server import serve
    from cfid.watch.watched import Watched

    watched = Watched(
        folder=None if run is None else find_recording(run, Workplace(found, thesis_rig(), borrowed=True)),
        runs_folder=None if found is None else found.runs_folder,
    )
    serve(
        watched,
        campaign=None if found is None else found.folder,
        port=port,
        ready=lambda address: _announce(address, browser),
    )


def _announce(address: str, opened: bool) -> None:
    echo(f"{address} (Ctrl-C ends it)", err=True)
    if opened:
        import threading
        import webbrowser

        # A browser in the terminal returns only when it is closed: the thread lets the page be served meanwhile.
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
