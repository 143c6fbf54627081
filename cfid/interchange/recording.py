"""Read a recording to convert it: the series of a run's devices, or of a file that another program wrote."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cfid.counted import counted
from cfid.records.files import RUN_FILE
from cfid.records.logs.any_kind import read_log
from cfid.records.logs.log import Series
from cfid.records.logs.run import log_of_run
from cfid.records.logs.spin import kept_texts
from cfid.records.run import Run, read_run
from cfid.records.tables.schema import Foreign, refuse_for_run


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Series of raw numbers in the units of whoever recorded them; `origin` has texts that converted files keep."""

    name: str
    series: tuple[Series, ...]
    origin: Mapping[str, str]
    understood: str
    notes: tuple[str, ...]


def recording_at(path: Path, reading: Foreign) -> Recording:
    """Read a run folder, or a file of any kind. Raises DataError or ConfigError as the reader of that kind."""
    if path.is_dir():
        refuse_for_run(path, reading)
        return _of_run(read_run(path))
    log = read_log(path, reading)
    facts = {"file": path.name, "sha256": log.source.sha256, "program": log.program, "clock": log.clock}
    assumed = f" Assumed: {', '.join(log.assumed)}." if log.assumed else ""
    return Recording(
        name=path.stem,
        series=log.series,
        origin=facts | kept_texts(log),
        understood=f"{log.understood}{assumed}",
        notes=log.notes,
    )


def _of_run(run: Run) -> Recording:
    log = log_of_run(run)
    rows = ", ".join(f"{one.name} {counted(one.rows, 'row')}" for one in log.series)
    return Recording(
        name=run.folder.resolve().name,
        series=log.series,
        origin={"run": run.folder.resolve().name, RUN_FILE: (run.folder / RUN_FILE).read_text(encoding="utf-8")}
        | kept_texts(log),
        understood=f"{run.folder.name}: a run of cfid, in the devices' own units: {rows}.",
        notes=log.notes,
    )
