"""Steady points of one motor and where they come from, with the options that say what files cannot."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cfid.console.facts import assumed
from cfid.console.lists import span
from cfid.console.options import FlipFz, Markers
from cfid.records.facts import LoadCellMount, RigFacts, Tachometer

if TYPE_CHECKING:
    from cfid.estimate.staircase import Staircase
    from cfid.motors.points import MotorPoints
    from cfid.records.parameters import Source

_INPUT = "What was measured"


@dataclass(frozen=True, kw_only=True)
class StandOptions:
    """What files cannot say of themselves."""

    table: Annotated[
        Path | None,
        typer.Option(help="A table: cmd, thrust_n, ...; a thrust stand's CSV file.", rich_help_panel=_INPUT),
    ] = None
    motors: Annotated[
        int | None,
        typer.Option(min=1, max=4, help="How many motors ran in files; a run knows it.", rich_help_panel=_INPUT),
    ] = None
    markers: Markers = None
    window: Annotated[
        str | None,
        typer.Option(metavar="FROM:TO", help="Window of every file in seconds, by hand.", rich_help_panel=_INPUT),
    ] = None
    flip_fz: FlipFz = None

    @property
    def window_s(self) -> tuple[float, float] | None:
        """The window by hand. Raises ConfigError for one that makes no sense."""
        if self.window is None:
            return None
        return span(self.window, "--window", unit="seconds", example="4:8")

    def where(self, facts: RigFacts) -> "StandOptions":
        """Return these options with the facts of a rig that they do not state."""
        given = RigFacts(loadcell=LoadCellMount(flip_fz=self.flip_fz), tachometer=Tachometer(markers=self.markers))
        known = given.over(facts)
        return replace(self, markers=known.tachometer.markers, flip_fz=known.loadcell.flip_fz)

    def divided(self, shown: Any) -> tuple[Any, tuple[str, ...]]:
        """Return speeds (n,) of those that a tachometer shows, with a note where nobody stated its markers."""
        notes = (assumed("1 marker of the tachometer is", "--markers"),) if self.markers is None else ()
        return shown / (self.markers or 1), notes


@dataclass(frozen=True, kw_only=True)
class Reduced:
    """A record of the load cell that was reduced, for its figure; `thrust` is the place of that channel."""

    name: str
    time_s: Any
    thrust_n: Any
    staircase: "Staircase"
    thrust: int = 2


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Steady points of one motor, their battery voltages where known, and where they come from."""

    points: "MotorPoints"
    vbat_v: Any = None
    lines: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    sources: "tuple[Source, ...]" = ()
    reduced: tuple[Reduced, ...] = ()
    paths: tuple[Path, ...] = ()
    expected: tuple[int, ...] = ()


def together(parts: Sequence[Evidence]) -> Evidence:
    """Put the points of several files and runs one after another."""
    import numpy as np

    from cfid.motors.points import joined

    volts = None
    if any(part.vbat_v is not None for part in parts):
        blank = [np.full(len(part.points.command), np.nan) for part in parts]
        volts = np.concatenate([b if p.vbat_v is None else p.vbat_v for p, b in zip(parts, blank, strict=True)])
    return Evidence(
        points=parts[0].points if len(parts) == 1 else joined(*(part.points for part in parts)),
        vbat_v=volts,
        **{
            name: tuple(item for part in parts for item in getattr(part, name))
            for name in ("lines", "warnings", "sources", "reduced", "paths", "expected")
        },
    )


def line_of(point: Any, name: str) -> str:
    """Say where a step was averaged, or why it was not."""
    window = f"{point.begin_s:7.2f} to {point.end_s:7.2f} s"
    said = f"{point.effective_samples.min():.0f} effective samples" if point.settled else point.reason
    return f"{name}: command {point.command}: {window}, {said}"


def drift_of(found: "Staircase", name: str) -> list[str]:
    """Say how far the load cell moved between the rests."""
    if found.tare_after is None:
        return []
    moved = found.tare_after.mean[2] - found.tare_before.mean[2] if len(found.tare_before.mean) > 2 else 0.0
    return [f"{name}: Fz at rest moved by {1e3 * moved:.3g} mN; the tare follows it."] if abs(moved) > 1e-3 else []
