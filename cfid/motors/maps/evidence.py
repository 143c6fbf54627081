"""Steady points of one motor and their sources, with the facts that files do not contain."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.estimate.common_causes import Cause
from cfid.estimate.staircase import Point, Staircase
from cfid.findings import Finding, note
from cfid.motors.points import MotorPoints, joined
from cfid.records.parameters import Source
from cfid.records.rig_file import NONE_STATED, LoadCellMount, RigFacts, Tachometer

Array = npt.NDArray[np.float64]

_GATHERED = ("lines", "findings", "sources", "reduced", "paths", "expected", "loadcells", "drifts", "tachometers")
_ASSUMED = (
    "1 marker of the tachometer is assumed, as in version 0.1: no rig.toml stated it when this was recorded, and it "
    "was not given."
)


@dataclass(frozen=True, kw_only=True)
class Stand:
    """Facts that files do not contain: motors that ran, markers of a tachometer, a window set by hand, Fz downwards.

    `facts` are those of the rig with which the files were recorded.
    """

    motors: int | None = None
    markers: int | None = None
    window_s: tuple[float, float] | None = None
    flip_fz: bool | None = None
    facts: RigFacts = NONE_STATED

    def where(self, facts: RigFacts) -> "Stand":
        """Return these facts, completed from those of a rig."""
        given = RigFacts(loadcell=LoadCellMount(flip_fz=self.flip_fz), tachometer=Tachometer(markers=self.markers))
        known = given.over(facts)
        return replace(self, markers=known.tachometer.markers, flip_fz=known.loadcell.flip_fz, facts=facts)

    def divided(self, shown: Array, name: str) -> tuple[Array, tuple[Finding, ...]]:
        """Return speeds (n,) in rad/s from a tachometer's readings, and a finding where its markers are not stated."""
        findings = (note("fact-assumed", _ASSUMED, "motor.speed_poly").at(name),)
        return shown / (self.markers or 1), findings if self.markers is None else ()


@dataclass(frozen=True, kw_only=True)
class Reduced:
    """A record of the load cell that was reduced, for its figure; `thrust` is the index of the thrust's channel."""

    name: str
    time_s: Array
    thrust_n: Array
    staircase: Staircase
    thrust: int = 2


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Steady points of one motor, their battery voltages where known, how many motors ran, and where they come from.

    `loadcells` and `tachometers` are the facts of the rigs whose load cell or tachometer measured them; `drifts` are
    the drifts of load cells within a recording.
    """

    points: MotorPoints
    vbat_v: Array | None = None
    motors: Array | None = None
    lines: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    sources: tuple[Source, ...] = ()
    reduced: tuple[Reduced, ...] = ()
    paths: tuple[Path, ...] = ()
    expected: tuple[int, ...] = ()
    loadcells: tuple[RigFacts, ...] = ()
    drifts: tuple[Cause, ...] = ()
    tachometers: tuple[RigFacts, ...] = ()


def together(parts: Sequence[Evidence]) -> Evidence:
    """Concatenate the points of several files and runs."""
    return Evidence(
        points=parts[0].points if len(parts) == 1 else joined(*(part.points for part in parts)),
        vbat_v=_column(parts, "vbat_v"),
        motors=_column(parts, "motors"),
        **{name: tuple(item for part in parts for item in getattr(part, name)) for name in _GATHERED},
    )


def _column(parts: Sequence[Evidence], name: str) -> Array | None:
    """Return a column of all points, nan where a part has none, None where no part has one."""
    columns = [getattr(part, name) for part in parts]
    if all(column is None for column in columns):
        return None
    blank = [np.full(len(part.points.command), np.nan) for part in parts]
    return np.concatenate([b if column is None else column for column, b in zip(columns, blank, strict=True)])


def line_of(point: Point, name: str) -> str:
    """Return a line on where a step was averaged, or why it was not."""
    window = f"{point.begin_s:7.2f} to {point.end_s:7.2f} s"
    how = f"{point.effective_samples.min():.0f} effective samples" if point.settled else point.reason
    step = "a step of unknown command" if point.command is None else f"command {point.command}"
    return f"{name}: {step}: {window}, {how}"


def staircase_findings(found: Staircase, name: str) -> tuple[Finding, ...]:
    """Return findings about the means of a staircase, and how far the load cell drifted."""
    return tuple(one.at(name) for one in (*found.findings, *_drift(found)))


def speed_findings(found: Staircase, name: str) -> tuple[Finding, ...]:
    """Return findings about the means of a staircase of speeds, which needs no baseline."""
    return tuple(one.at(name) for one in found.findings if one.code != "no-baseline-after")


def _drift(found: Staircase) -> list[Finding]:
    if found.tare_after is None:
        return []
    moved = found.tare_after.mean[2] - found.tare_before.mean[2] if len(found.tare_before.mean) > 2 else 0.0
    text = f"Fz without load moved by {1e3 * moved:.3g} mN; the tare follows it."
    return [note("baseline-moved", text)] if abs(moved) > 1e-3 else []
