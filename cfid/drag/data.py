"""What the words of `cfid fit drag` stand for: runs of `cfid log wind`, recordings of an index, forces of a table."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.inputs import Workplace, find_recording
from cfid.console.options import FlipFz, LoadCellOptions, Markers, Method, ReadingOptions, YawDeg, finite
from cfid.console.selection import chosen, labelled
from cfid.drag.wind.files import WindRow, read_reduced, read_wind_index
from cfid.drag.wind.plan import KIND, AzimuthRad, azimuth
from cfid.drag.wind.recordings import Recordings, Reduced, reduce_rows
from cfid.drag.wind.runs import reduce_run, sagged
from cfid.errors import ConfigError, DataError
from cfid.records.facts import LoadCellMount, RigFacts, Tachometer, WindStand

if TYPE_CHECKING:
    from cfid.drag.experiments import DragExperiments
    from cfid.records.parameters import Source

_INPUT = "What was measured"

Words = Annotated[
    list[str] | None,
    typer.Argument(metavar="RUN ...", help="Runs of cfid log wind; default: the campaign's complete ones."),
]


@dataclass(frozen=True, kw_only=True)
class WindInputs:
    """Where forces in wind are, and how vehicle and wind generator stood."""

    index: Annotated[
        Path | None,
        typer.Option(
            help="CSV file, a row a run: command, angle_deg, wind_min_mps, wind_max_mps, tach_rpm, loadcell; may have "
            "azimuth_deg, from_s, to_s. Paths are relative to it; wind 0 makes references.",
            rich_help_panel=_INPUT,
        ),
    ] = None
    table: Annotated[
        Path | None,
        typer.Option(
            help="CSV file of reduced forces: command, angle_deg, vx_mps, vy_mps, vz_mps, speed_sum_rad_s, fx_n, fy_n, "
            "fz_n.",
            rich_help_panel=_INPUT,
        ),
    ] = None
    azimuth_deg: Annotated[
        float | None,
        typer.Option(
            help="Of the wind generator, right of the nose, where a run does not state its own; default: rig.toml's.",
            rich_help_panel=_INPUT,
        ),
    ] = None
    azimuth_rad: AzimuthRad = None
    yaw_deg: YawDeg = None
    markers: Markers = None
    flip_fz: FlipFz = None

    @property
    def given(self) -> RigFacts:
        """The facts that options state. Raises ConfigError for what cannot be."""
        return RigFacts(
            loadcell=LoadCellMount(flip_fz=self.flip_fz),
            tachometer=Tachometer(markers=self.markers),
            wind=WindStand(
                azimuth_deg=azimuth(self.azimuth_deg, self.azimuth_rad),
                yaw_deg=None if self.yaw_deg is None else finite(self.yaw_deg, "--yaw-deg"),
            ),
        )


@dataclass(frozen=True, kw_only=True)
class WindEvidence:
    """Experiments, doubts about their files, and what is to be said."""

    experiments: "DragExperiments"
    doubts: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    sources: "tuple[Source, ...]" = ()
    paths: tuple[Path, ...] = ()


def read_wind_evidence(
    words: Sequence[str],
    inputs: WindInputs,
    reading: ReadingOptions,
    scale: LoadCellOptions,
    workplace: Workplace,
    *,
    method: Method,
) -> WindEvidence:
    """Read and reduce what is named, and subtract the forces without wind.

    Raises ConfigError when there is nothing to read, DataError and FitError that name file, line or run.
    """
    if inputs.table is not None:
        return _of_table(inputs.table, words, inputs.index)
    if inputs.index is None:
        words = _runs(words, workplace)
    how = Recordings(reading=scale.reading(reading), method=method, given=inputs.given, rig=workplace.facts)
    rows, sources, notes = ([], [], ()) if inputs.index is None else _rows(inputs.index)
    parts = reduce_rows(rows, how)
    paths = [find_recording(word, workplace) for word in words]
    parts += [reduce_run(path, how) for path in paths]
    _check_once(parts)
    sources += [source for part in parts for source in part.sources]
    found = _reduced(parts, sources=sources, paths=[inputs.index, *paths] if inputs.index else paths)
    return replace(found, warnings=(*notes, *found.warnings))


def _runs(words: Sequence[str], workplace: Workplace) -> list[str]:
    """Return the runs that are meant: without words all of the campaign."""
    if not words and workplace.campaign is None:
        raise ConfigError("nothing to fit: give RUNs of `cfid log wind`, --index FILE, or --table FILE.")
    return chosen(words, workplace.campaign, suits=labelled(KIND), wanted="runs in wind and without")


def _rows(index: Path) -> "tuple[list[WindRow], list[Source], tuple[str, ...]]":
    rows, source, notes = read_wind_index(index)
    return rows, [source], notes


def _of_table(table: Path, words: Sequence[str], index: Path | None) -> WindEvidence:
    if words or index is not None:
        raise ConfigError(f"--table {table} holds forces that are reduced already: give it alone.")
    experiments, source, notes = read_reduced(table)
    return WindEvidence(experiments=experiments, warnings=notes, sources=(source,), paths=(table,))


def _reduced(parts: Sequence[Reduced], *, sources: "Sequence[Source]", paths: Sequence[Path]) -> WindEvidence:
    from cfid.drag.wind.reduction import reduce_runs

    found = reduce_runs([run for part in parts for run in part.runs])
    return WindEvidence(
        experiments=found.experiments,
        doubts=found.doubts,
        warnings=(*_counted(parts), *sagged(parts), *found.notes),
        sources=tuple(sources),
        paths=tuple(paths),
    )


def _check_once(parts: Sequence[Reduced]) -> None:
    """Refuse a recording that is there twice, whatever its name: it would count as two."""
    seen: dict[str, str] = {}
    for recording in (part.sources[0] for part in parts):
        if (known := seen.get(recording.sha256)) is not None:
            raise DataError(f"{recording.path}: the same recording as {known}: name each once.")
        seen[recording.sha256] = recording.path


def _counted(parts: Sequence[Reduced]) -> list[str]:
    """Return what is said of recordings: what holds for several, once."""
    told = Counter(note for part in parts for note in part.notes)
    return [note if count == 1 else f"{count} recordings: {note}" for note, count in told.items()]
