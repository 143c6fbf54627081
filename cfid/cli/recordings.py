"""`cfid import`, which makes a run of another program's recording, and `cfid convert` to files of other programs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from cfid.console.inputs import find_recording, open_workplace
from cfid.console.labels import AtMm, Axis, Body, Note, Pull, Weight, label_of, with_load
from cfid.console.lists import span
from cfid.console.messages import echo, fitted, in_options
from cfid.console.messages import note as print_note
from cfid.console.options import positive
from cfid.console.program import program
from cfid.errors import ConfigError

_DSHOT = "dshot"
_NEXT = {
    "swing": "fit swing",
    "drop": "fit friction",
    "encoder": "fit swing",
    "loadcell": "fit speed --vibration",
    "stand": "fit thrust",
    "flight": "fit flight",
    "ping": "tf latency",
}


def _pairs(words: Sequence[str] | None, option: str, example: str) -> tuple[tuple[str, str], ...]:
    """Return COLUMN=WORD pairs; the last `=` divides them, since a column's name may have others."""
    pairs = [tuple(part.strip() for part in word.rpartition("=")[::2]) for word in words or ()]
    if wrong := next((word for word, pair in zip(words or (), pairs, strict=True) if not all(pair)), None):
        raise ConfigError(f"{option} {wrong}: should be COLUMN and a word, as in {example}.")
    return tuple((column, word) for column, word in pairs)


def _counts(text: str) -> "float | Literal['rls-13bit-in-22']":
    if text == "rls-13bit-in-22":
        return "rls-13bit-in-22"
    try:
        return positive(float(text), "--counts-per-turn")
    except ValueError:
        raise ConfigError(f"--counts-per-turn {text}: should be a number or rls-13bit-in-22.") from None


def import_file(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A log, or a table, from another program.")],
    *,
    kind: Annotated[
        Literal["angle", "wrench", "stand", "flight", "ping", "period"] | None,
        typer.Option(
            metavar="KIND",
            help="angle, wrench, stand, flight, ping or period; default: as its columns show.",
        ),
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=COLUMN,...",
            help="Columns by name or number, as in t=1,phi=2; or in the order of the kind, as in 1,2.",
        ),
    ] = None,
    unit: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COLUMN=UNIT",
            help="Unit of a column that names none: t=us, phi=deg, Fz=N; can be repeated.",
        ),
    ] = None,
    time_unit: Annotated[
        Literal["s", "ms", "us", "ns"] | None,
        typer.Option(help="Unit of the times, as --unit t=..."),
    ] = None,
    angle_unit: Annotated[
        Literal["counts", "rad", "deg"] | None,
        typer.Option(help="Unit of the angle, as --unit phi=..."),
    ] = None,
    rows: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COLUMN=WORD",
            help="Take only rows with that word in that column; can be repeated.",
        ),
    ] = None,
    rate_hz: Annotated[
        float | None,
        typer.Option(metavar="HZ", help="Sampling rate, in place of a column of times."),
    ] = None,
    skip_lines: Annotated[int, typer.Option(metavar="N", min=0, help="Lines to skip at the top.")] = 0,
    decimal: Annotated[Literal[".", ","], typer.Option(help="Decimal mark.")] = ".",
    clock: Annotated[
        Literal["true", "84/85"] | None,
        typer.Option(
            help="Clock rate of a uSD-card log or its table; default: as its rows show.",
        ),
    ] = None,
    counts_per_turn: Annotated[
        str | None,
        typer.Option(metavar="N|rls-...", help="Encoder's counts per turn, or rls-13bit-in-22."),
    ] = None,
    counts_per_n: Annotated[float | None, typer.Option(metavar="N", help="Load cell's counts per N.")] = None,
    counts_per_nm: Annotated[
        float | None, typer.Option(metavar="N", help="Load cell's counts per newton metre.")
    ] = None,
    esc_us: Annotated[
        str | None,
        typer.Option(
            metavar="FROM,TO|dshot",
            help="Pulse widths in microseconds at commands 0 and 65535, or DShot's commands from 48 to 2047; "
            "default: 1000,2000.",
        ),
    ] = None,
    motors: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, max=4, help="Motors whose thrust a stand shows."),
    ] = None,
    log: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Which flight of several; default: the longest."),
    ] = None,
    props_out: Annotated[
        bool | None,
        typer.Option(
            "--props-out/--no-props-out",
            help="Rotors turn opposite to a Crazyflie's, or as its; default: as the log shows.",
        ),
    ] = None,
    axis: Axis = None,
    weight: Weight = None,
    body: Body = None,
    pull: Pull = None,
    at_mm: AtMm = None,
    note: Note = None,
) -> None:
    """Make a run from another program's recording.

    The file stays as it is, and no existing run is changed. Without a campaign the run is made in the current
    folder. With --axis, a vehicle's log is a swing that its gyro recorded. With --pull and --weight, forces are those
    of a known load, for `cfid fit loadcell`.

    Example: cfid import swing.csv --axis x --unit t=us --counts-per-turn 8192
    """
    from cfid.recordings.importing import import_recording
    from cfid.recordings.read import read_recording
    from cfid.recordings.recording import How
    from cfid.records.campaign import find_campaign

    for value, option in (
        (rate_hz, "--rate-hz"),
        (counts_per_n, "--counts-per-n"),
        (counts_per_nm, "--counts-per-nm"),
    ):
        if value is not None:
            positive(value, option)
    pulses = None if esc_us in (None, _DSHOT) else esc_us
    how = How(
        columns=() if columns is None else tuple(name.strip() for name in columns.split(",")),
        units={name: word for name, word in (("t", time_unit), ("phi", angle_unit)) if word is not None}
        | dict(_pairs(unit, "--unit", "t=us")),
        rows=_pairs(rows, "--rows", "Propeller=T5143"),
        rate_hz=rate_hz,
        skip_lines=skip_lines,
        decimal=decimal,
        clock=clock,
        counts_per_turn=None if counts_per_turn is None else _counts(counts_per_turn),
        counts_per_n=counts_per_n,
        counts_per_nm=counts_per_nm,
        esc_us=None if pulses is None else span(pulses, "--esc-us", unit="microseconds", example="1000,2000"),
        dshot=esc_us == _DSHOT,
        motors=motors,
        log=log,
        props_out=props_out,
    )
    campaign = find_campaign(program().campaign)
    label = label_of(axis, weight, body, note, campaign)
    made = import_recording(
        read_recording(file, how, kind=kind),
        how,
        campaign=campaign,
        kind=kind,
        label=label if pull is None and at_mm is None else with_load(label, pull, at_mm),
    )
    echo(fitted(in_options(made.understood)))
    for finding in made.findings:
        print_note(finding.text)
    listed = ", ".join(f"{name} {device.rows} rows" for name, device in made.run.header.devices.items())
    echo(f"{made.run.folder}: {listed}")
    if next_step := _NEXT.get(made.run.header.kind):
        echo(f"next: cfid {next_step} {made.run.folder}")


def convert(
    run: Annotated[str, typer.Argument(metavar="RUN|FILE", help="A run, or a log or table from another program.")],
    *,
    to: Annotated[Literal["csv", "parquet", "mcap"], typer.Option(help="The format to write.")],
    out: Annotated[
        Path | None,
        typer.Option(
            help="File, or folder of files, to write; default: named after the recording, in the current folder."
        ),
    ] = None,
) -> None:
    """Write a recording in another format, in its original units.

    Example: cfid convert last --to parquet
    """
    from cfid.recordings import convert as conversion
    from cfid.recordings.read import description, read_recording

    recording = read_recording(find_recording(run, open_workplace()))
    paths = conversion.convert(recording, to, out)
    echo(fitted(in_options(description(recording))))
    for finding in recording.findings:
        print_note(finding.text)
    for path in paths:
        echo(path)
