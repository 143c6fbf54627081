"""Options that several commands share, as annotated types."""

from pathlib import Path
from typing import Annotated, Literal

import typer

Method = Annotated[
    Literal["default", "thesis"], typer.Option(show_default=False, help="Method: cfid's, or the thesis'.")
]


MassKg = Annotated[
    str | None,
    typer.Option(
        metavar="KG[:STD]",
        help="Swinging mass and its STD; default: rig.toml's.",
    ),
]
GravityMps2 = Annotated[
    str | None,
    typer.Option(
        metavar="MPS2[:STD]",
        help="Local gravity and its STD; default: rig.toml's.",
    ),
]
YawDeg = Annotated[
    float | None,
    typer.Option(
        metavar="DEG",
        help="Angle of the load cell's x axis, to the left of the nose; default: the run's, else rig.toml's.",
    ),
]
Markers = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=1,
        help="Reflective markers counted per turn; default: the run's, else rig.toml's.",
    ),
]
FlipFz = Annotated[
    bool | None,
    typer.Option(
        "--flip-fz/--no-flip-fz",
        help="Reverse the sign of Fz; default: the run's, else rig.toml's.",
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
        help="Another rig.toml, or that of the thesis.",
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
    typer.Option(metavar="N|AXIS=N,...", help="Peaks to use, counting the release."),
]
MinAngleDeg = Annotated[
    float | None,
    typer.Option(metavar="DEG", min=1, max=90, help="Smallest peak to use (thesis: 10)."),
]
FromS = Annotated[
    float | None,
    typer.Option("--from", metavar="S", min=0, help="Start of the window, after the first sample."),
]
ToS = Annotated[
    float | None,
    typer.Option("--to", metavar="S", min=0, help="End of the window, after the first sample."),
]
Force = Annotated[
    bool,
    typer.Option(
        "--force",
        help="Keep rejected numbers, and a fit less certain than the stored one; overwrite files.",
    ),
]
Figures = Annotated[
    bool | None,
    typer.Option(
        "--figures/--no-figures",
        help="Draw figures; default: yes, but outside a campaign or with --json only with --out.",
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        help="Folder for the figures; default: figures of the campaign, a swing's run, or here.",
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
