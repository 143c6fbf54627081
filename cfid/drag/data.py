"""Read drag experiments from runs in wind, recordings of an index, or a table of reduced forces."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cfid.drag.experiments import DragExperiments, experiments_from_table
from cfid.drag.wind.data import AS_THEY_ARE, ReducedRecording, WindReading, reduce_index, reduce_run
from cfid.drag.wind.index import read_wind_index
from cfid.drag.wind.reduction import reduce_forces
from cfid.errors import DataError, FitError
from cfid.findings import Finding, merged, warning
from cfid.motors.maps.checks import marker_findings
from cfid.recordings.resumed import resumed_by, steps_read_later
from cfid.recordings.table import read_table
from cfid.records.run import Run, run_at
from cfid.units import ROTORS

TABLE_COLUMNS = (
    "command", "angle_deg", "vx_mps", "vy_mps", "vz_mps", "speed_sum_rad_s", "fx_n", "fy_n", "fz_n",
)  # fmt: skip


def read_runs(
    runs: Sequence[Run | Path | str], *, index: Path | None = None, how: WindReading = AS_THEY_ARE
) -> DragExperiments:
    """Reduce runs of `cfid log wind`, and the recordings that an index lists, to experiments.

    Raises DataError and FitError that name file, line or run.
    """
    rows, source, notes = ([], None, ()) if index is None else read_wind_index(index)
    reduced, left_out = _reduced(runs, how)
    parts = [*reduce_index(rows, how), *reduced]
    _check_once(parts)
    experiments = reduce_forces([force for part in parts for force in part.forces])
    files = [file for part in parts for file in part.sources]
    return replace(
        experiments,
        findings=merged((*notes, *left_out, *(one for part in parts for one in part.findings), *experiments.findings)),
        sources=tuple(files if source is None else [source, *files]),
        rigs=tuple(dict.fromkeys(part.rig for part in parts)),
        tachometers=tuple(dict.fromkeys(part.rig for part in parts if part.by_tachometer)),
    )


def _reduced(runs: Sequence[Run | Path | str], how: WindReading) -> tuple[list[ReducedRecording], list[Finding]]:
    """Reduce runs; where one was interrupted before a reading, the reading comes from the run that completes it.

    A run that ended before a motor turned, and that another run completes, is left out with a warning.
    """
    paths = [run.folder if isinstance(run, Run) else Path(run) for run in runs]
    known = {path: run for path in paths if (run := run_at(path)) is not None}
    later = {path: steps_read_later(run, list(known.values())) for path, run in known.items()}
    completed = {resumed_by(run) for run in known.values()}
    reduced, left_out = list[ReducedRecording](), list[Finding]()
    for path in paths:
        try:
            reduced.append(reduce_run(path, how, read_later=later.get(path, frozenset())))
        except (DataError, FitError) as error:
            if path.resolve().name not in completed:
                raise
            left_out.append(warning("run-left-out", f"{error} It is left out.", "drag.*"))
    return reduced, left_out


def read_index(path: Path, *, how: WindReading = AS_THEY_ARE) -> DragExperiments:
    """Reduce the recordings that an index lists, a CSV file with one row per recording."""
    return read_runs((), index=path, how=how)


def read_forces(path: Path) -> DragExperiments:
    """Read a CSV file of reduced forces. Raises DataError with the file, and the line of an invalid number."""
    try:
        table = read_table(path)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file.", code="no-file") from None
    missing = [name for name in TABLE_COLUMNS if name not in table.heads]
    if missing:
        heads = ", ".join(table.heads)
        raise DataError(
            f"{path}: no column {', '.join(missing)} among {heads}: its header should be {','.join(TABLE_COLUMNS)}.",
            code="no-column",
        )
    columns = [next(one for one in table.columns if one.head == name) for name in TABLE_COLUMNS]
    values = np.column_stack([column.values for column in columns])
    rows, places = np.nonzero(~np.isfinite(values))
    if len(rows):
        where = f"{path}:{table.line_of_row(int(rows[0]))}"
        raise DataError(f"{where}: no number in column '{TABLE_COLUMNS[places[0]]}'.", code="no-number")
    try:
        experiments = experiments_from_table(
            command=values[:, 0],
            angle_deg=values[:, 1],
            velocity_mps=values[:, 2:5],
            speed_sum_rad_s=values[:, 5],
            force_n=values[:, 6:],
        )
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    speed = experiments.speed_sum_rad_s / ROTORS
    markers = marker_findings(experiments.command, speed, quantities=("drag.*",), single=False)
    findings = tuple(one.at(path.name) for one in (*experiments.findings, *markers))
    return replace(experiments, findings=findings, sources=(table.source,))


def _check_once(parts: Sequence[ReducedRecording]) -> None:
    """Refuse a recording that is given twice under any name: it would count as two."""
    seen: dict[str, str] = {}
    for recording in (part.sources[0] for part in parts):
        if (known := seen.get(recording.sha256)) is not None:
            raise DataError(f"{recording.path}: the same recording as {known}: name each once.")
        seen[recording.sha256] = recording.path
