"""One campaign in short: what it knows, number by number, and whether its recordings are still those of its fits.

For many campaigns side by side; a summary can be made in another process, or on another computer that sees the folder.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from cfid.errors import CfidError, ConfigError, DataError
from cfid.findings import Finding, warning
from cfid.records.campaign import RIG_FILE, RUNS_FOLDER, find_campaign
from cfid.records.parameters import Section, Source, load_sections
from cfid.records.run import Run, list_runs


class Known(NamedTuple):
    """A number that a campaign knows, with one standard deviation where it has one, and when it was last recorded."""

    name: str
    value: float
    std: float | None
    unit: str
    recorded: datetime
    accepted: bool


@dataclass(frozen=True, kw_only=True)
class Summary:
    """A campaign. `findings` tell of recordings that are gone, or others than those that were fitted."""

    folder: Path
    vehicle: str
    complete_runs: int
    other_runs: int
    known: tuple[Known, ...]
    findings: tuple[Finding, ...]


def summarise(folder: Path) -> Summary | CfidError:
    """Return a campaign's summary, or the error that says why there is none: one must not hide the others."""
    try:
        campaign = find_campaign(folder, start=folder)
        if campaign is None:
            raise ConfigError(f"{folder}: is no campaign: it has no {RIG_FILE}.")
        sections = load_sections(campaign.parameters_file)
    except CfidError as error:
        return error
    runs = [run for run in list_runs(campaign.runs_folder) if not isinstance(run, DataError)]
    complete = sum(run.header.state == "complete" for run in runs)
    sources = {source for section in sections.values() for source in section.sources}
    return Summary(
        folder=folder,
        vehicle=campaign.rig.vehicle.name,
        complete_runs=complete,
        other_runs=len(runs) - complete,
        known=tuple(
            known for name, section in sections.items() for known in _numbers(name, section, _recorded(section, runs))
        ),
        findings=tuple(
            filter(None, (_source_finding(folder, source) for source in sorted(sources, key=lambda own: own.path)))
        ),
    )


def _recorded(section: Section, runs: Sequence[Run]) -> datetime:
    """Return when the last of a section's runs began; of foreign files it is known only when they were fitted."""
    started = {f"{RUNS_FOLDER}/{run.folder.name}": run.header.started for run in runs}
    found = [started[folder] for source in section.sources if (folder := str(Path(source.path).parent)) in started]
    return max(found, default=section.found)


def _numbers(section_name: str, section: Section, recorded: datetime) -> list[Known]:
    """Return a section's numbers; of a kind that has several sections, as `swing x`, each is named with its own."""
    which = section_name.partition(" ")[2]
    own = f" ({which})" if which else ""
    return [
        Known(one.name + own, float(one.value), _float(one.std), parameter.unit, recorded, key not in section.rejected)
        for key, parameter in section.parameters.items()
        for one in parameter.numbers(key)
        if one.value is not None
    ]


def _float(std: float | None) -> float | None:
    return None if std is None else float(std)


def _source_finding(folder: Path, source: Source) -> Finding | None:
    try:
        with (folder / source.path).open("rb") as file:
            same = hashlib.file_digest(file, "sha256").hexdigest() == source.sha256
    except OSError:
        return warning("source-missing", f"{source.path} is not there any more.")
    return None if same else warning("source-changed", f"{source.path} has changed since it was fitted.")
