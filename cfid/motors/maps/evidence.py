"""Steady points of one motor and where they come from, with the options that say what files cannot."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cfid.errors import ConfigError
from cfid.findings import Finding, note, warning

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
    markers: Annotated[
        int, typer.Option(min=1, help="Reflective markers on the propeller.", rich_help_panel=_INPUT)
    ] = 1
    window: Annotated[
        str | None,
        typer.Option(metavar="FROM:TO", help="Window of every file in seconds, by hand.", rich_help_panel=_INPUT),
    ] = None
    flip_fz: Annotated[
        bool, typer.Option("--flip-fz", help="Fz counts downwards: change its sign.", rich_help_panel=_INPUT)
    ] = False

    @property
    def window_s(self) -> tuple[float, float] | None:
        """The window by hand. Raises ConfigError for one that makes no sense."""
        if self.window is None:
            return None
        try:
            from_s, to_s = (float(word) for word in self.window.split(":"))
        except ValueError:
            raise ConfigError(f"--window {self.window}: should be FROM:TO in seconds, as 4:8.") from None
        if not 0 <= from_s < to_s < float("inf"):
            raise ConfigError(f"--window {self.window}: should begin at 0 or later and end after its begin.")
        return from_s, to_s


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
    findings: tuple[Finding, ...] = ()
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
            for name in ("lines", "findings", "sources", "reduced", "paths", "expected")
        },
    )


def line_of(point: Any, name: str) -> str:
    """Return where a step was averaged, or why it was not."""
    window = f"{point.begin_s:7.2f} to {point.end_s:7.2f} s"
    how = f"{point.effective_samples.min():.0f} effective samples" if point.settled else point.reason
    return f"{name}: command {point.command}: {window}, {how}"


def recording(notes: Iterable[str]) -> tuple[Finding, ...]:
    """Return what a reader noted of a recording."""
    return tuple(warning("recording", text) for text in notes)


def staircase_findings(found: "Staircase", name: str) -> tuple[Finding, ...]:
    """Return what is found about the means of a staircase, and how far the load cell drifted."""
    return tuple(replace(one, text=f"{name}: {one.text}") for one in (*found.findings, *_drift(found)))


def _drift(found: "Staircase") -> list[Finding]:
    if found.tare_after is None:
        return []
    moved = found.tare_after.mean[2] - found.tare_before.mean[2] if len(found.tare_before.mean) > 2 else 0.0
    text = f"Fz without load moved by {1e3 * moved:.3g} mN; the tare follows it."
    return [note("baseline-moved", text)] if abs(moved) > 1e-3 else []
