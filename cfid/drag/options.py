"""Options that the commands of drag share."""

import math
from typing import Annotated

import typer

from cfid.console.options import finite
from cfid.errors import ConfigError

AzimuthRad = Annotated[float | None, typer.Option(hidden=True, help="The azimuth in radians, as version 0.1 had it.")]


def azimuth(in_deg: float | None, in_rad: float | None) -> float | None:
    """Return the azimuth in degrees that --azimuth-deg or --azimuth-rad states. Raises ConfigError for both."""
    if in_deg is not None and in_rad is not None:
        raise ConfigError("--azimuth-deg and --azimuth-rad are the same: give one of them.")
    if in_rad is not None:
        return math.degrees(finite(in_rad, "--azimuth-rad"))
    return None if in_deg is None else finite(in_deg, "--azimuth-deg")
