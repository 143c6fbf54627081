"""A campaign folder: the rig, its runs, and what was found from them."""

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict

from cfid.errors import ConfigError, RejectedError
from cfid.experiments import EXPERIMENTS
from cfid.findings import joined, texts
from cfid.records.choose import choose_one
from cfid.records.files import (
    FITS_FOLDER,
    PARAMETERS_FILE,
    RIG_FILE,
    RUN_FILE,
    RUNS_FOLDER,
    locked_folder,
    read_small,
    sha256_of,
    write_whole,
)
from cfid.records.fits import BY_HAND, Fit, is_withdrawn, keep_fit, list_fits, path_of
from cfid.records.parameters import Parameter, Section, Source, plain, runs_of
from cfid.records.parameters_file import is_as_written, text_of
from cfid.records.plausibility import judged
from cfid.records.result import Result
from cfid.records.rig_file import Rig, load_rig, stated
from cfid.records.run import Run, list_runs, run_at, run_holding
from cfid.records.stale import stale_in
from cfid.records.values import Values
from cfid.version import __version__

if TYPE_CHECKING:
    from pandas import DataFrame


class Campaign(BaseModel):
    """A folder with a rig.toml, the runs recorded in it and the parameters estimated from them."""

    model_config = ConfigDict(frozen=True)

    folder: Path
    rig: Rig

    @property
    def runs_folder(self) -> Path:
        """The folder of the runs."""
        return self.folder / RUNS_FOLDER

    @property
    def parameters_file(self) -> Path:
        """The file of the estimated parameters."""
        return self.folder / PARAMETERS_FILE

    @property
    def fits_folder(self) -> Path:
        """The folder that keeps every fit."""
        return self.folder / FITS_FOLDER

    def runs(self, *, kind: str | None = None, complete: bool = True) -> list[Run]:
        """Return the readable runs, oldest first, by default only complete ones that are not excluded.

        `kind` is one that `cfid runs` lists, such as `swing`, `thrust` or `ping`; `sine` covers the sines of every l.
        """
        found = (run for run in list_runs(self.runs_folder) if isinstance(run, Run))
        return [
            run for run in found if kind in (None, run.header.kind, run.header.family) and (not complete or run.usable)
        ]

    def run(self, name: str) -> Run:
        """Return a run by its name, by a pattern that matches one name, or by `last` or `last KIND`.

        `last` is the newest usable run. Raises ConfigError when no run matches, or several do.
        """
        return choose_one(name, self.runs(complete=False)).runs[0]

    def fits(self) -> tuple[Fit, ...]:
        """Return the kept fits in their order, without those that were withdrawn and those that cannot be read."""
        fits = [fit for fit in list_fits(self.fits_folder) if isinstance(fit, Fit)]
        return tuple(fit for fit in fits if not is_withdrawn(self.fits_folder, fit))

    def values(self, runs: Sequence[Run] | None = None) -> Values:
        """Return the campaign's values: of all kept fits of a quantity the accepted, current and most certain one.

        `runs` are all readable runs of the campaign, if they have been read already.
        """
        runs = self.runs(complete=False) if runs is None else runs
        return Values(self.fits(), self.rig, stale_in(self.folder, runs, self.rig))

    def quantities(self) -> "DataFrame":
        """Return a row for every number of the campaign: quantity, value, std, unit, section, accepted, found, fit."""
        from pandas import DataFrame  # a command that opens a campaign must not wait for this import

        rows = [
            (
                number.name, number.value, number.std, quantity.parameter.unit, quantity.fit.name, quantity.accepted,
                quantity.section.found, quantity.fit.stem,
            )
            for quantity in self.values()
            for number in quantity.parameter.numbers(quantity.key)
        ]  # fmt: skip
        return DataFrame(rows, columns=["quantity", "value", "std", "unit", "section", "accepted", "found", "fit"])

    def keep(
        self,
        result: Result,
        *,
        figures: Sequence[Path] = (),
        force: bool = False,
        options: Mapping[str, Any] | None = None,
    ) -> Path:
        """Keep a result in fits/, and return the path of its file there; `values` decides whether it counts.

        Rejected quantities, and those that the rig's platform cannot have, are kept only with `force`, and are marked.
        `options` are the command's options that differ from their defaults; a fit made in Python has none. Raises
        RejectedError when a quantity that the analysis is for was rejected and `force` is not set: the fit is then kept
        without numbers. Raises ConfigError when a file cannot be written, DataError when run.toml of a run cannot be
        read.
        """
        result = judged(result, self.rig)
        if not (result.accepted or force):
            self._keep(replace(result, quantities={}, covariances=(), common={}), result, (), options)
            raise RejectedError(f"rejected: {joined(texts(result.findings, 'rejection'))} Its numbers are not kept.")
        fit = self._keep(result if force else result.without_rejected(), result, figures, options)
        self.write_parameters()
        return path_of(self.fits_folder, fit)

    def _keep(self, given: Result, result: Result, figures: Sequence[Path], options: Mapping[str, Any] | None) -> Fit:
        """Keep a result; `given` is the part of it whose numbers are kept."""
        kind = EXPERIMENTS.get(given.section_name.partition(" ")[0])
        fit = Fit(
            name=given.section_name,
            command=given.command,
            section=self._section_of(given, result),
            quality=plain(given.quality),
            options=options,
            findings=given.findings,
            lines=given.summary(),
            figures=tuple(self._path_in(str(path)) for path in figures),
            revision=1 if kind is None else kind.revision,
        )
        return keep_fit(self.fits_folder, fit)

    def keep_refused(self, section: str, command: str, reason: str) -> None:
        """Keep why a fit of all usable runs gave no result; the reason holds until one of these runs changes.

        Raises DataError or ConfigError when a run cannot be read or the file cannot be written.
        """
        files = [run.folder / RUN_FILE for run in self.runs()]
        refused = Section(
            method="default",
            found=datetime.now(UTC).replace(microsecond=0),
            cfid_version=__version__,
            accepted=False,
            sources=tuple(Source(self._path_in(str(file)), sha256_of(file)) for file in files),
            parameters={},
            rejected={section: reason},
        )
        keep_fit(self.fits_folder, Fit(name=section, command=command, section=refused, quality={}))

    def keep_by_hand(self, key: str, parameter: Parameter) -> Path:
        """Keep a value that was measured by hand, and return the path of its file. Raises ConfigError."""
        section = Section(
            method="by hand",
            found=datetime.now(UTC).replace(microsecond=0),
            cfid_version=__version__,
            accepted=True,
            sources=(),
            parameters={key: parameter},
        )
        fit = keep_fit(self.fits_folder, Fit(name=BY_HAND, command="set", section=section, quality={}))
        self.write_parameters()
        return path_of(self.fits_folder, fit)

    def write_parameters(self) -> str:
        """Write parameters.toml from the values where it differs; return what had happened to the file, "" for nothing.

        A file that is not as it was written is kept beside it. Raises ConfigError.
        """
        path = self.parameters_file
        try:
            with locked_folder(self.folder):
                own_name = self.folder.resolve().name
                values = self.values()
                text = text_of(values, name=own_name, version=__version__)
                before = read_small(path) if path.exists() else b""
                strange = before != b"" and not is_as_written(before.decode("utf-8", "replace"))
                was = ""
                if strange:  # it may hold what somebody wrote, as the values of earlier versions
                    kept = path.rename(path.with_suffix(f".{sha256_of(path)[:8]}.toml"))
                    was = f"was cut, edited or written by an earlier version, and is kept as {kept.name}"
                    was += _without_fit(before, values)
                if before != text.encode():
                    write_whole(path, text.encode())
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written: {error.strerror}.") from None
        return was

    def _section_of(self, given: Result, result: Result) -> Section:
        """Return the section that stores a result; `given` is the part of the result that is kept."""
        sources = tuple(Source(self._path_in(source.path), source.sha256) for source in given.sources)
        runs = (run_at(self.runs_folder / name) for name in runs_of(sources))
        return Section(
            method=given.method,
            found=datetime.now(UTC).replace(microsecond=0),
            cfid_version=__version__,
            accepted=result.accepted,
            sources=sources,
            parameters=given.quantities,
            covariance=given.covariances,
            common=given.common,
            rejected=result.rejected,
            rig=stated(self.rig, result.rests_on),
            facts=result.facts,
            suspects=result.suspects,
            runs={run.folder.name: run.header.stated_sha256 for run in runs if run is not None},
            simulated=are_simulated(given.sources),
        )

    def _path_in(self, path: str) -> str:
        """Return a path relative to the campaign's folder where it lies inside, else absolute; a URL stays as it is."""
        if "://" in path:
            return path
        there, folder = Path(path).resolve(), self.folder.resolve()
        return str(there.relative_to(folder) if there.is_relative_to(folder) else there)


def are_simulated(sources: Iterable[Source]) -> bool:
    """Return whether a recording among the sources of a result is of a simulated rig, wherever it lies."""
    files = [Path(source.path) for source in sources if "://" not in source.path]
    recordings = (run_holding(path) for path in {path.resolve().parent: path for path in files}.values())
    return any(run.header.simulated for run in recordings if run is not None)


def _without_fit(content: bytes, values: Values) -> str:
    """Return, as part of a sentence, what a parameters.toml of version 0.2 has and no kept fit gives."""
    try:
        sections = tomllib.loads(content.decode("utf-8", "replace"))
    except tomllib.TOMLDecodeError:
        return ""
    own = (section.get("parameters") for section in sections.values() if isinstance(section, dict))
    keys = [key for parameters in own if isinstance(parameters, dict) for key in parameters]
    lost = [key for key in dict.fromkeys(keys) if values.find(key) is None]
    return f" with {', '.join(lost)}, which no kept fit gives and `cfid set` can store" if lost else ""


def open_campaign(folder: str | Path | None = None) -> Campaign:
    """Open the campaign in a folder, else the nearest one at or above the current folder.

    Raises ConfigError when there is none.
    """
    found = find_campaign(None if folder is None else Path(folder))
    if found is None:
        raise ConfigError(f"no {RIG_FILE} here or above: `cfid new DIR` makes a campaign; `folder` names one.")
    return found


def find_campaign(folder: Path | None, *, start: Path | None = None) -> Campaign | None:
    """Open the campaign in `folder`, else the nearest one at or above `start` or the current folder, else None.

    Raises ConfigError when `folder` holds no rig.toml, or when the current folder no longer exists.
    """
    folder = find_folder(start) if folder is None else folder
    return None if folder is None else Campaign(folder=folder, rig=load_rig(folder / RIG_FILE))


def find_folder(start: Path | None = None) -> Path | None:
    """Return the nearest folder with a rig.toml at or above `start` or the current folder, else None.

    Raises ConfigError when the current folder no longer exists.
    """
    start = _current_folder() if start is None else start
    return next(filter(_has_rig, (start, *start.parents)), None)


def _current_folder() -> Path:
    try:
        return Path.cwd()
    except FileNotFoundError:
        raise ConfigError("the current folder was removed or moved: change to one that exists.") from None


def _has_rig(folder: Path) -> bool:
    try:
        return (folder / RIG_FILE).is_file()
    except OSError:  # this user may not list that parent folder
        return False
