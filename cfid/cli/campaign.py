"""`cfid new` and `cfid runs`: a campaign folder, and what was recorded in it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cfid.cli.speech import note
from cfid.errors import ConfigError

if TYPE_CHECKING:
    from cfid.campaign import Campaign
    from cfid.errors import DataError
    from cfid.run import Run


def new(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to make; it may exist and be empty.")],
) -> None:
    """Make a campaign folder with a commented rig.toml.

    Example: [bold]cfid new my-crazyflie[/bold]
    """
    path = make_campaign(folder)
    typer.echo(f"{path}: put your vehicle's mass, centre of mass and mounts there, then record.")


def make_campaign(folder: Path) -> Path:
    """Make a campaign folder and return the path of its rig.toml.

    Raises ConfigError when there is one already.
    """
    from cfid.campaign import RIG_FILE, RUNS_FOLDER, new_rig_text

    try:
        (folder / RUNS_FOLDER).mkdir(parents=True, exist_ok=True)
        with (folder / RIG_FILE).open("x", encoding="utf-8") as file:
            file.write(new_rig_text())
    except FileExistsError:
        raise ConfigError(f"{folder / RIG_FILE} is there already: nothing was changed.") from None
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be made: {error.strerror}.") from None
    return folder / RIG_FILE


def runs(
    campaign: Annotated[Path | None, typer.Option(help="Campaign folder; default: this one or a parent.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """List the campaign's runs: what, when, state, rows, losses.

    Example: [bold]cfid runs --campaign my-crazyflie[/bold]
    """
    from cfid.run import list_runs

    _print_runs(list_runs(here(campaign).runs_folder), json=json)


def here(folder: Path | None) -> "Campaign":
    """Return the campaign named, else the one at or above the current folder.

    Raises ConfigError when there is none.
    """
    from cfid.campaign import RIG_FILE, find_campaign

    found = find_campaign(folder, start=Path.cwd())
    if found is None:
        raise ConfigError(f"no {RIG_FILE} here or above: `cfid new DIR` makes a campaign; --campaign DIR names one.")
    return found


def _print_runs(runs: "list[Run | DataError]", *, json: bool) -> None:
    from cfid.errors import DataError

    rows = [_row(run) for run in runs if not isinstance(run, DataError)]
    broken = [str(run) for run in runs if isinstance(run, DataError)]
    if json:
        import json as encoder

        typer.echo(encoder.dumps({"command": "runs", "runs": rows, "warnings": broken}, indent=2))
        return
    if not rows and not broken:
        typer.echo("no runs yet")
        return
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Table

    # A run's name is what the other commands take: it is never cut.
    table = Table(box=SIMPLE, pad_edge=False)
    table.add_column("run", no_wrap=True, min_width=max((len(row["run"]) for row in rows), default=0))
    for heading in ("state", "rows", "lost"):
        table.add_column(heading, justify="left" if heading == "state" else "right", no_wrap=True)
    table.add_column("note", overflow="fold")
    for row in rows:
        table.add_row(*(str(row[key]) for key in ("run", "state", "rows", "lost", "note")))
    Console().print(table)
    for sentence in broken:
        note(sentence)


def _row(run: "Run") -> dict[str, Any]:
    header, devices = run.header, run.header.devices.values()
    label = header.label
    weight = None if label.weight_g is None else f"{label.weight_g:g} g"
    known = [device.rows for device in devices if device.rows is not None]
    return {
        "run": run.folder.name,
        "what": " ".join(filter(None, [header.kind, label.body, label.axis, weight])),
        "started": header.started.isoformat(),
        "state": "cut" if run.cut else header.state,
        "rows": sum(known) if known else "?",
        "lost": sum(device.lost for device in devices),
        "simulated": header.simulated,
        "note": "; ".join(filter(None, ["simulated" * header.simulated, label.note, header.reason])),
    }
