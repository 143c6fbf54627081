"""Options that several commands share: each group is a dataclass, whose fields `flat` adds to a command."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

_OUTPUT = "Output"
_RIG = "Vehicle and rig"


def panel(name: str) -> Callable[..., Any]:
    """Return a typer.Option whose options stand together in a panel of --help."""
    return partial(typer.Option, rich_help_panel=name)


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
Swings = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="AXIS=FILE|AXIS=NUMBER[:STD]|RUN ...",
        help="Swings, or known axis inertias; default: the campaign's complete, labelled swings.",
    ),
]


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
        Path | None,
        typer.Option(
            metavar="FILE|thesis",
            help="A rig.toml to use instead of the campaign's, or that of the thesis.",
            rich_help_panel=_RIG,
        ),
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
    verbose: Annotated[
        bool,
        typer.Option("--verbose", help="Print all warnings and notes, not two warnings.", rich_help_panel=_OUTPUT),
    ] = False
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
