"""A campaign folder: the rig, its runs, and what was found from them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict

from cfid.counted import counted
from cfid.errors import ConfigError, RejectedError
from cfid.findings import joined, texts
from cfid.records.choose import choose_one
from cfid.records.files import FITS_FOLDER, PARAMETERS_FILE, RIG_FILE, RUN_FILE, RUNS_FOLDER, sha256_of
from cfid.records.fits import Fit, keep_fit
from cfid.records.parameters import Section, Source, load_sections, plain, runs_of, store_section
from cfid.records.plausibility import judged
from cfid.records.result import Result
from cfid.records.rig_file import Rig, load_rig, stated
from cfid.records.run import Run, list_runs, run_at
from cfid.records.stale import stale_in
from cfid.records.values import lost_by
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

    def sections(self) -> dict[str, Section]:
        """Return the sections of parameters.toml by fit. Raises DataError when the file is invalid."""
        return load_sections(self.parameters_file)

    def quantities(self) -> "DataFrame":
        """Return a row for every estimated number: quantity, value, std, unit, section, accepted, found.

        Raises DataError when parameters.toml is invalid.
        """
        from pandas import DataFrame  # a command that opens a campaign must not wait for this import

        rows = [
            (one.name, one.value, one.std, parameter.unit, name, key not in section.rejected, section.found)
            for name, section in self.sections().items()
            for key, parameter in section.parameters.items()
            for one in parameter.numbers(key)
        ]
        return DataFrame(rows, columns=["quantity", "value", "std", "unit", "section", "accepted", "found"])

    def keep(
        self,
        result: Result,
        *,
        figures: Sequence[Path] = (),
        force: bool = False,
        options: Mapping[str, Any] | None = None,
    ) -> Path:
        """Keep a result in parameters.toml and fits/, and return the path of its file in fits/.

        Rejected quantities, and those that the rig's platform cannot have, are kept only with `force`, and are marked.
        `options` are the command's options that differ from their defaults; a fit made in Python has none. Raises
        RejectedError when a quantity that the analysis is for was rejected and `force` is not set; also where the
        result is kept in fits/ alone, since a stored fit that is accepted and current stays in force: beside a rejected
        result, and, without `force`, beside one that lacks some of its numbers or is clearly less certain. Raises
        ConfigError when a file cannot be written, DataError when run.toml of a run cannot be read.
        """
        result = judged(result, self.rig)
        if not (result.accepted or force):
            raise RejectedError(
                f"rejected: {joined(texts(result.findings, 'rejection'))} {self.parameters_file} is unchanged."
            )
        given = result if force else result.without_rejected()
        section = self._section_of(given, result)
        fit = Fit(
            name=given.section_name,
            command=given.command,
            section=section,
            quality=plain(given.quality),
            options=options,
            findings=given.findings,
            lines=given.summary(),
            figures=tuple(self._path_in(str(path)) for path in figures),
        )
        stored = self.sections().get(fit.name)
        lost = "" if stored is None or (force and section.accepted) else lost_by(section, stored)
        if stored is None or not lost or stale_in(self.folder, self.runs(complete=False), self.rig)(stored):
            store_section(self.parameters_file, fit.name, section)
            return keep_fit(self.fits_folder, fit)
        path = self._path_in(str(keep_fit(self.fits_folder, fit)))
        if not section.accepted:
            self.remember_rejected(result)
        instead = "`force` puts it in force" if section.accepted else "exclude a run of the stored one to replace it"
        raise RejectedError(
            f"{fit.name}: the stored fit ({stored.found:%Y-%m-%d %H:%M:%S} UTC, "
            f"{counted(len(stored.sources), 'file')}) stays in force, since this one {lost}. It is kept in {path}: "
            f"{instead}."
        )

    def remember_rejected(self, result: Result) -> None:
        """Keep why a fit was rejected as a whole, without its numbers, so that it is not suggested as the next step.

        Raises ConfigError when the file cannot be written.
        """
        section = self._section_of(replace(result, quantities={}, covariances=(), common={}), result)
        self._remember(result.section_name, section)

    def remember_refused(self, section: str, reason: str) -> None:
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
        self._remember(section, refused)

    def _remember(self, name: str, section: Section) -> None:
        try:
            self.fits_folder.mkdir(exist_ok=True)
        except OSError as error:
            raise ConfigError(f"{self.fits_folder}: cannot be made: {error.strerror}.") from None
        store_section(self._rejected_file, name, section)

    def rejected_sections(self) -> dict[str, Section]:
        """Return, by fit, the last section rejected as a whole, without numbers. Raises DataError if it is invalid."""
        return load_sections(self._rejected_file)

    @property
    def _rejected_file(self) -> Path:
        return self.fits_folder / "rejected.toml"

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
        )

    def _path_in(self, path: str) -> str:
        """Return a path relative to the campaign's folder where it lies inside, else absolute; a URL stays as it is."""
        if "://" in path:
            return path
        there, folder = Path(path).resolve(), self.folder.resolve()
        return str(there.relative_to(folder) if there.is_relative_to(folder) else there)


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
