"""Options of `cfid fit thrust`, `speed` and `torque` for the facts that files do not contain."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.lists import span
from cfid.console.options import FlipFz, Markers

if TYPE_CHECKING:
    from cfid.motors.maps.evidence import Stand

_INPUT = "What was measured"


@dataclass(frozen=True, kw_only=True)
class StandOptions:
    """Facts that files do not contain."""

    table: Annotated[
        Path | None,
        typer.Option(help="A table: cmd, thrust_n, ...; a thrust stand's CSV file.", rich_help_panel=_INPUT),
    ] = None
    motors: Annotated[
        int | None,
        typer.Option(min=1, max=4, help="How many motors ran in files; runs state it.", rich_help_panel=_INPUT),
    ] = None
    markers: Markers = None
    window: Annotated[
        str | None,
        typer.Option(metavar="FROM:TO", help="Window of every file in seconds, by hand.", rich_help_panel=_INPUT),
    ] = None
    flip_fz: FlipFz = None

    def known(self) -> "Stand":
        """Return them as the fits take them. Raises ConfigError for an invalid window."""
        from cfid.motors.maps.evidence import Stand

        window_s = None if self.window is None else span(self.window, "--window", unit="seconds", example="4:8")
        return Stand(motors=self.motors, markers=self.markers, window_s=window_s, flip_fz=self.flip_fz)
