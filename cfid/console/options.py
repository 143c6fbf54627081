"""Options that several commands share, as annotated types."""

from collections.abc import Callable
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
Geometry = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE|thesis",
        help="A rig.toml to use instead of the campaign's, or that of the thesis.",
        rich_help_panel=_RIG,
    ),
]
PropsOut = Annotated[
    bool,
    typer.Option(
        "--props-out", help="Rotors turn opposite to a Crazyflie's: the front right one clockwise, seen from above."
    ),
]
Peaks = Annotated[
    str | None,
    typer.Option(metavar="N|AXIS=N,...", help="Number of peaks to use, counting the release as the first."),
]
MinAngleDeg = Annotated[
    float | None,
    typer.Option(min=1, max=90, help="Use peaks down to this angle, in degrees (the thesis' rule: 10)."),
]
FromS = Annotated[
    float | None,
    typer.Option("--from", metavar="S", min=0, help="Start of the window, in seconds after the first sample."),
]
ToS = Annotated[
    float | None,
    typer.Option("--to", metavar="S", min=0, help="End of the window, in seconds after the first sample."),
]
Force = Annotated[
    bool,
    typer.Option(
        "--force",
        help="Report and store rejected quantities too, or a less certain fit in place of the stored one; "
        "overwrite files.",
        rich_help_panel=_OUTPUT,
    ),
]
Figures = Annotated[
    bool | None,
    typer.Option(
        "--figures/--no-figures",
        help="Draw figures (with --json, only if --out is given); default: yes, but outside a campaign only if "
        "--out is given.",
        rich_help_panel=_OUTPUT,
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        help="Folder for the figures; default: figures in the campaign, or next to a swing's run; else the current "
        "folder.",
        rich_help_panel=_OUTPUT,
    ),
]


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


def parse_peaks(text: str | None) -> int | dict[str, int] | None:
    """Return the number of peaks for all axes, or for each: one number, or `x=11,z=16`.

    Raises ConfigError when it is neither.
    """
    from cfid.errors import ConfigError

    if text is None:
        return None
    try:
        if "=" not in text:
            return int(text)
        pairs = (part.split("=") for part in text.split(","))
        return {axis.strip(): int(count) for axis, count in pairs}
    except ValueError:
        raise ConfigError(f"`peaks` {text}: expected a number, or AXIS=NUMBER,AXIS=NUMBER,...") from None
