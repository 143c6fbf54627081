"""Options that several commands share: each group is a dataclass, whose fields `flat` adds to a command."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

if TYPE_CHECKING:
    from cfid.recordings.recording import How
    from cfid.records.tables.angle import Reading
    from cfid.records.tables.schema import Foreign

_FILE = "Files that something else wrote"
_OUTPUT = "Output"
_RIG = "Vehicle and rig"

Method = Annotated[Literal["default", "thesis"], typer.Option(help="'thesis' applies the thesis method.")]


MassKg = Annotated[
    str | None,
    typer.Option(
        metavar="KG[:STD]",
        help="Mass of the swinging body; default, for the mass and for STD: rig.toml's.",
        rich_help_panel=_RIG,
    ),
]
GravityMps2 = Annotated[
    str | None,
    typer.Option(
        metavar="MPS2[:STD]",
        help="Local gravity; default, for the value and for STD: rig.toml's.",
        rich_help_panel=_RIG,
    ),
]
YawDeg = Annotated[
    float | None,
    typer.Option(
        help="Angle from the vehicle's nose to the load cell's x axis, in degrees, positive to the left, seen "
        "from above; default: the run's, else rig.toml's.",
        rich_help_panel="What was measured",
    ),
]
Markers = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Reflective markers that the tachometer counts per turn; default: the run's, else rig.toml's.",
        rich_help_panel="What was measured",
    ),
]
FlipFz = Annotated[
    bool | None,
    typer.Option(
        "--flip-fz/--no-flip-fz",
        help="Reverse the sign of Fz, which the load cell counts downwards; default: the run's, else rig.toml's.",
        rich_help_panel="What was measured",
    ),
]
EscUs = Annotated[
    str | None,
    typer.Option(
        metavar="FROM,TO",
        help="Pulse widths of a motor controller, in microseconds, at commands 0 and 65535; default: 1000,2000.",
        rich_help_panel="What was measured",
    ),
]
LogClock = Annotated[
    Literal["true", "84/85"] | None,
    typer.Option(
        help="Clock rate of a Crazyflie's uSD-card log (default: inferred from its rows), or of a table made from one "
        "(default: true).",
        rich_help_panel=_FILE,
    ),
]
Swings = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="AXIS=FILE|AXIS=NUMBER[:STD]|RUN ...",
        help="Swings, or known axis inertias; default: the campaign's complete, labelled swings.",
    ),
]


@dataclass(frozen=True, kw_only=True)
class ReadingOptions:
    """How to read a file whose header does not state its format."""

    time_unit: Annotated[
        Literal["s", "ms", "us"] | None,
        typer.Option(help="Unit of the time column; default: the suffix of its name, else s.", rich_help_panel=_FILE),
    ] = None
    angle_unit: Annotated[
        Literal["counts", "rad", "deg"] | None,
        typer.Option(
            help="Unit of the angle column; default: the suffix of its name; whole numbers are counts.",
            rich_help_panel=_FILE,
        ),
    ] = None
    counts_per_turn: Annotated[
        str | None,
        typer.Option(metavar="N|rls-13bit-in-22", help="Encoder counts per turn.", rich_help_panel=_FILE),
    ] = None
    rate_hz: Annotated[
        float | None, typer.Option(help="Sampling rate in Hz of a file without times.", rich_help_panel=_FILE)
    ] = None
    skip_lines: Annotated[
        int, typer.Option(min=0, help="Lines to skip at the top of the file.", rich_help_panel=_FILE)
    ] = 0
    columns: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,NAME,...",
            help="Names or numbers of the columns: time and angle, or time, Fx, Fy, Fz, Tx, Ty and Tz; for a thrust "
            "stand NAME=COLUMN, such as thrust_n=3, or COLUMN=WORD to select the rows with that word.",
            rich_help_panel=_FILE,
        ),
    ] = None

    def reading(self) -> "Reading":
        """Return the options in the form that the readers take."""
        from cfid.records.tables import angle as recording

        if self.rate_hz is not None:
            positive(self.rate_hz, "--rate-hz")
        scale = self.counts_per_turn
        return recording.Reading(
            time_unit=self.time_unit,
            angle_unit=self.angle_unit,
            counts_per_turn=None if scale is None else recording.counts_per_turn(scale),
            rate_hz=self.rate_hz,
            skip_lines=self.skip_lines,
            columns=self.column_names,
        )

    def foreign(self, clock: Literal["true", "84/85"] | None = None) -> "Foreign":
        """Return how to read a log or a table of motors. Raises ConfigError for options that only an angle has."""
        from cfid.records.tables.schema import Foreign

        self.refuse_angles()
        return Foreign(
            time_unit=self.time_unit,
            rate_hz=self.rate_hz,
            skip_lines=self.skip_lines,
            columns=self.column_names,
            clock=clock,
        )

    def refuse_angles(self) -> None:
        """Raise ConfigError if an option was given that only an angle has."""
        from cfid.errors import ConfigError

        if self.angle_unit is not None or self.counts_per_turn is not None:
            raise ConfigError("`angle_unit` and `counts_per_turn` are for a file with an angle: none is read here.")

    @property
    def column_names(self) -> tuple[str, ...]:
        """The names of the columns, empty where they were not given."""
        return () if self.columns is None else tuple(name.strip() for name in self.columns.split(","))


@dataclass(frozen=True, kw_only=True)
class LoadCellOptions:
    """Units and scales of a file's forces and torques."""

    counts_per_n: Annotated[
        float | None,
        typer.Option(help="Counts per newton; default: the run's or the file's, else 1e6.", rich_help_panel=_FILE),
    ] = None
    counts_per_nm: Annotated[
        float | None,
        typer.Option(
            help="Counts per newton metre; default: the run's or the file's, else 1e6.", rich_help_panel=_FILE
        ),
    ] = None
    unit: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COLUMN=UNIT",
            help="Unit of a force or torque that its name does not state, as in Fz=N, Tx=Nm, Fz=counts; one of a kind "
            "is enough.",
            rich_help_panel=_FILE,
        ),
    ] = None

    def how(self, file: ReadingOptions, clock: Literal["true", "84/85"] | None) -> "How":
        """Return these options, with those of every file, in the form that the reader takes.

        Raises ConfigError for options that only an angle has.
        """
        from cfid.recordings.recording import How

        file.refuse_angles()
        units = dict(one.partition("=")[::2] for one in self.unit or ())
        return How(
            columns=file.column_names,
            units=units if file.time_unit is None else {"t": file.time_unit, **units},
            rate_hz=file.rate_hz,
            skip_lines=file.skip_lines,
            clock=clock,
            counts_per_n=self.counts_per_n,
            counts_per_nm=self.counts_per_nm,
        )


@dataclass(frozen=True, kw_only=True)
class RigOptions:
    """The campaign and the rig of a command."""

    campaign: Annotated[
        Path | None,
        typer.Option(
            help="Campaign folder; default: the current folder or its nearest parent with a rig.toml.",
            rich_help_panel=_RIG,
        ),
    ] = None
    geometry: Annotated[
        Path | None, typer.Option(help="A rig.toml to use instead of the campaign's.", rich_help_panel=_RIG)
    ] = None


@dataclass(frozen=True, kw_only=True)
class WindowOptions:
    """The part of a swing to use."""

    peaks: Annotated[
        str | None,
        typer.Option(metavar="N|AXIS=N,...", help="Number of peaks to use, counting the release as the first."),
    ] = None
    min_angle_deg: Annotated[
        float | None,
        typer.Option(min=1, max=90, help="Use peaks down to this angle, in degrees (the thesis' rule: 10)."),
    ] = None


@dataclass(frozen=True, kw_only=True)
class CutOptions:
    """A time window that the operator sets."""

    from_s: Annotated[
        float | None,
        typer.Option("--from", metavar="S", min=0, help="Start of the window, in seconds after the first sample."),
    ] = None
    to_s: Annotated[
        float | None,
        typer.Option("--to", metavar="S", min=0, help="End of the window, in seconds after the first sample."),
    ] = None


@dataclass(frozen=True, kw_only=True)
class Delivery:
    """How a result is printed, drawn and kept.

    `given` contains the options of the command that differ from their defaults; `flat` fills it in. `take`, if given,
    receives the result, which is then neither printed, drawn nor kept.
    """

    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.", rich_help_panel=_OUTPUT)] = False
    force: Annotated[
        bool,
        typer.Option(
            "--force",
            help="Report and store rejected quantities too, or a less certain fit in place of the stored one; "
            "overwrite files.",
            rich_help_panel=_OUTPUT,
        ),
    ] = False
    figures: Annotated[
        bool | None,
        typer.Option(
            "--figures/--no-figures",
            help="Draw figures (with --json, only if --out is given); default: yes, but outside a campaign only if "
            "--out is given.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the figures; default: figures in the campaign, or next to a swing's run; else the current "
            "folder.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None
    given: Mapping[str, Any] = field(default_factory=dict)
    take: Callable[[Any], None] | None = None


def positive(value: float, option: str, *, most: float = float("inf")) -> float:
    """Return a number after checking that it is finite, above zero, and at most `most`.

    Raises ConfigError otherwise.
    """
    from cfid.errors import ConfigError

    if not 0 < value < float("inf"):
        raise ConfigError(f"{option} {value:g}: has to be above zero.")
    if value > most:
        raise ConfigError(f"{option} {value:g}: has to be {most:g} at most.")
    return value


def finite(value: float, option: str) -> float:
    """Return a number after checking that it is finite.

    Raises ConfigError otherwise.
    """
    from cfid.errors import ConfigError

    if not abs(value) < float("inf"):
        raise ConfigError(f"{option} {value:g}: has to be a number.")
    return value


def pulses_us(text: str | None) -> tuple[float, float] | None:
    """Parse --esc-us. Raises ConfigError for anything but two ascending pulse widths above zero."""
    from cfid.console.lists import span

    if text is None:
        return None
    low, high = span(text, "--esc-us", unit="microseconds", example="1000,2000")
    return positive(low, "--esc-us"), high
