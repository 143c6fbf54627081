"""`cfid import`, which makes a run of another program's recording, and `cfid convert` to files of other programs."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cfid.console.flat import flat
from cfid.console.inputs import find_recording, open_workplace
from cfid.console.labels import LabelOptions, LoadOptions
from cfid.console.lists import span
from cfid.console.messages import echo, fitted, in_options, note
from cfid.console.options import RigOptions, positive
from cfid.errors import ConfigError

if TYPE_CHECKING:
    from cfid.recordings.recording import How

_COLUMNS, _SCALES, _RECORDING = "Columns and units", "Scales", "What is recorded"
_NEXT = {
    "swing": "fit swing",
    "drop": "fit friction",
    "encoder": "fit swing",
    "loadcell": "fit rotor",
    "stand": "fit thrust",
    "flight": "fit flight",
    "ping": "tf latency",
}

CampaignFolder = Annotated[
    Path | None, typer.Option(help="Campaign folder; default: the current folder or a parent with a rig.toml.")
]


@dataclass(frozen=True, kw_only=True)
class DescriptionOptions:
    """What a file does not state of itself."""

    columns: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=COLUMN,...",
            help="Columns by the file's names or by numbers, as in t=1,phi=2; or in the order of the kind, as in 1,2.",
            rich_help_panel=_COLUMNS,
        ),
    ] = None
    unit: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COLUMN=UNIT",
            help="Unit of a column that names none, as in t=us, phi=deg, phi=counts, Fz=N; can be repeated.",
            rich_help_panel=_COLUMNS,
        ),
    ] = None
    time_unit: Annotated[
        Literal["s", "ms", "us", "ns"] | None,
        typer.Option(help="Unit of the times, as --unit t=...", rich_help_panel=_COLUMNS),
    ] = None
    angle_unit: Annotated[
        Literal["counts", "rad", "deg"] | None,
        typer.Option(help="Unit of the angle, as --unit phi=...", rich_help_panel=_COLUMNS),
    ] = None
    rows: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COLUMN=WORD",
            help="Take only the rows with that word in that column, as in Propeller=T5143; can be repeated.",
            rich_help_panel=_COLUMNS,
        ),
    ] = None
    rate_hz: Annotated[
        float | None,
        typer.Option(help="Sampling rate in Hz, in place of a column of times.", rich_help_panel=_COLUMNS),
    ] = None
    skip_lines: Annotated[
        int, typer.Option(min=0, help="Lines to skip at the top of the file.", rich_help_panel=_COLUMNS)
    ] = 0
    decimal: Annotated[Literal[".", ","], typer.Option(help="Decimal mark.", rich_help_panel=_COLUMNS)] = "."
    sort_times: Annotated[
        bool,
        typer.Option(
            "--sort-times", help="Put rows in the order of their times where these go back.", rich_help_panel=_COLUMNS
        ),
    ] = False
    clock: Annotated[
        Literal["true", "84/85"] | None,
        typer.Option(
            help="Clock rate of a Crazyflie's uSD-card log (default: as its rows show), or of a table made of one.",
            rich_help_panel=_SCALES,
        ),
    ] = None
    counts_per_turn: Annotated[
        str | None,
        typer.Option(metavar="N|rls-13bit-in-22", help="Encoder counts per turn.", rich_help_panel=_SCALES),
    ] = None
    counts_per_n: Annotated[
        float | None, typer.Option(help="Counts of the load cell per newton.", rich_help_panel=_SCALES)
    ] = None
    counts_per_nm: Annotated[
        float | None, typer.Option(help="Counts of the load cell per newton metre.", rich_help_panel=_SCALES)
    ] = None
    esc_us: Annotated[
        str | None,
        typer.Option(
            metavar="FROM,TO",
            help="Pulse widths of a motor controller, in microseconds, at commands 0 and 65535; default: 1000,2000.",
            rich_help_panel=_SCALES,
        ),
    ] = None
    dshot: Annotated[
        bool, typer.Option("--dshot", help="Commands are DShot's, from 48 to 2047.", rich_help_panel=_SCALES)
    ] = False
    motors: Annotated[
        int | None,
        typer.Option(min=1, max=4, help="Number of motors whose thrust a stand shows.", rich_help_panel=_RECORDING),
    ] = None
    log: Annotated[
        int | None,
        typer.Option(
            min=1, help="Which flight of a file with several; default: the longest.", rich_help_panel=_RECORDING
        ),
    ] = None
    props_out: Annotated[
        bool | None,
        typer.Option(
            "--props-out/--no-props-out",
            help="Rotors turn opposite to a Crazyflie's (--no-props-out: as a Crazyflie's); default: as the log shows.",
            rich_help_panel=_RECORDING,
        ),
    ] = None

    def how(self) -> "How":
        """Return the options in the form that readers take. Raises ConfigError for an invalid one."""
        from cfid.recordings.recording import How

        for value, option in (
            (self.rate_hz, "--rate-hz"),
            (self.counts_per_n, "--counts-per-n"),
            (self.counts_per_nm, "--counts-per-nm"),
        ):
            if value is not None:
                positive(value, option)
        columns = () if self.columns is None else tuple(name.strip() for name in self.columns.split(","))
        pulses = self.esc_us
        units = {"t": self.time_unit, "phi": self.angle_unit}
        return How(
            columns=columns,
            units={name: unit for name, unit in units.items() if unit is not None}
            | dict(_pairs(self.unit, "--unit", "t=us")),
            rows=_pairs(self.rows, "--rows", "Propeller=T5143"),
            rate_hz=self.rate_hz,
            skip_lines=self.skip_lines,
            decimal=self.decimal,
            sort_times=self.sort_times,
            clock=self.clock,
            counts_per_turn=None if self.counts_per_turn is None else _counts(self.counts_per_turn),
            counts_per_n=self.counts_per_n,
            counts_per_nm=self.counts_per_nm,
            esc_us=None if pulses is None else span(pulses, "--esc-us", unit="microseconds", example="1000,2000"),
            dshot=self.dshot,
            motors=self.motors,
            log=self.log,
            props_out=self.props_out,
        )


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


@flat
def import_file(
    *,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A log, or a table, from another program.")],
    kind: Annotated[
        Literal["angle", "wrench", "stand", "flight", "ping", "period"] | None,
        typer.Option(help="Kind of recording; default: as its columns show."),
    ] = None,
    description: DescriptionOptions,
    label: LabelOptions,
    load: LoadOptions,
    campaign: CampaignFolder = None,
) -> None:
    """Make a run from another program's recording. The file stays as it is, and no existing run is changed.

    Without a campaign the run is made in the current folder. With --axis, a vehicle's log is a swing that its gyro
    recorded. With --pull and --weight, forces are those of a known load, for `cfid fit loadcell`.

    Example: [bold]cfid import swing.csv --axis x --unit t=us --counts-per-turn 8192[/bold]
    """
    from cfid.recordings.importing import import_recording
    from cfid.recordings.read import read_recording
    from cfid.records.campaign import find_campaign

    into = find_campaign(campaign)
    how = description.how()
    kept = label.label(into)
    made = import_recording(
        read_recording(file, how, kind=kind),
        how,
        campaign=into,
        kind=kind,
        label=kept if load == LoadOptions() else load.on(kept),
    )
    echo(fitted(in_options(made.understood)))
    for one in made.findings:
        note(one.text)
    rows = ", ".join(f"{name} {device.rows} rows" for name, device in made.run.header.devices.items())
    echo(f"{made.run.folder}: {rows}")
    if next_step := _NEXT.get(made.run.header.kind):
        echo(f"next: cfid {next_step} {made.run.folder}")


@flat
def convert(
    *,
    run: Annotated[str, typer.Argument(metavar="RUN|FILE", help="A run, or a log or table from another program.")],
    to: Annotated[Literal["csv", "parquet", "mcap"], typer.Option(help="The format to write.")],
    out: Annotated[
        Path | None,
        typer.Option(
            help="File, or folder of files, to write; default: named after the recording, in the current folder."
        ),
    ] = None,
    campaign: CampaignFolder = None,
) -> None:
    """Write a recording in another format: every row and column, in its original units.

    Example: [bold]cfid convert last --to parquet[/bold]
    """
    from cfid.recordings import convert as conversion
    from cfid.recordings.read import description, read_recording

    recording = read_recording(find_recording(run, open_workplace(RigOptions(campaign=campaign))))
    paths = conversion.convert(recording, to, out)
    echo(fitted(in_options(description(recording))))
    for one in recording.findings:
        note(one.text)
    for path in paths:
        echo(path)
