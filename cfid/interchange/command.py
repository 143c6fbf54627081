"""Define `cfid import`, which makes runs of other programs' recordings, and `cfid convert` to other formats."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from cfid.console.campaign import here
from cfid.console.flat import flat
from cfid.console.inputs import find_recording, open_workplace
from cfid.console.labels import LabelOptions, LoadOptions
from cfid.console.messages import echo, fitted, in_options, note
from cfid.console.options import LoadCellOptions, LogClock, ReadingOptions, RigOptions
from cfid.errors import ConfigError


@flat
def import_file(
    *,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A log, or a table with times, from another program.")],
    label: LabelOptions,
    load: LoadOptions,
    reading: ReadingOptions,
    loadcell: LoadCellOptions,
    clock: LogClock = None,
    kind: Annotated[
        Literal["angle", "wrench", "flight", "stand"] | None,
        typer.Option(help="Kind of recording; default: inferred from its columns."),
    ] = None,
    campaign: Annotated[
        Path | None, typer.Option(help="Campaign folder; default: the current folder or a parent.")
    ] = None,
) -> None:
    """Make a run from another program's recording. The file stays as it is, and no existing run is changed.

    With --axis, a vehicle's log is a swing that its gyro recorded. With --pull and --weight, forces are those of a
    known load, for `cfid fit loadcell`.

    Example: [bold]cfid import LOG00.BIN[/bold]
    """
    from cfid.interchange import importing

    into = here(campaign)
    kept = label.label(into)
    found = kind or importing.kind_of(file, reading.reading())
    if found == "wrench" and load.pull is not None:
        kept = load.on(kept)
    elif load.pull is not None or load.at_mm is not None:
        raise ConfigError("--pull and --at-mm are for forces of a load cell under a known weight.")
    if found == "angle":
        angles = replace(reading.reading(), clock=clock)
        made = importing.import_angle(into, file, angles, label=kept, kind=label.kind_of_angles)
    elif found == "wrench":
        made = importing.import_wrench(into, file, loadcell.how(reading, clock), label=kept)
    elif found == "stand":
        made = importing.import_stand(into, file, reading.foreign(clock), label=kept)
    else:
        hung = label.kind_of_angles
        made = importing.import_flight(
            into,
            file,
            reading.foreign(clock),
            label=kept,
            kind="flight" if hung == "encoder" else hung,
        )
    echo(fitted(in_options(made.understood)))
    for text in made.notes:
        note(text)
    rows = ", ".join(f"{name} {device.rows} rows" for name, device in made.run.header.devices.items())
    echo(f"{made.run.folder}: {rows}")


@flat
def convert(
    *,
    run: Annotated[str, typer.Argument(metavar="RUN|FILE", help="A run, or a log or table from another program.")],
    to: Annotated[Literal["csv", "parquet", "mat", "mcap"], typer.Option(help="The format to write.")],
    out: Annotated[
        Path | None,
        typer.Option(
            help="File, or folder of files, to write; default: named after the recording, in the current folder."
        ),
    ] = None,
    reading: ReadingOptions,
    clock: LogClock = None,
    campaign: Annotated[
        Path | None, typer.Option(help="Campaign folder; default: the current folder or a parent.")
    ] = None,
) -> None:
    """Write a recording in another format: every row and column, in its original units.

    Example: [bold]cfid convert last --to parquet[/bold]
    """
    from cfid.interchange import convert as conversion
    from cfid.interchange.recording import recording_at

    path = find_recording(run, open_workplace(RigOptions(campaign=campaign)))
    found = recording_at(path, reading.foreign(clock))
    paths = conversion.convert(found, to, out)
    echo(fitted(in_options(found.understood)))
    for text in found.notes:
        note(text)
    for path in paths:
        echo(path)
